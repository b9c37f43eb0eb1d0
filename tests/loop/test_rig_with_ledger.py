"""Tare, calibration, identification and response in lockstep, from the command to the ledger and into the loop."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import arm_and_tension
from hil.rig_with_ledger import RigWithLedger
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.requests import Request
from rigctl.model.verbs import Verb
from tests.builders.rig_bench import changed

WEIGHT_N = 294.2
SCALE, ZERO_N = 0.985, 1.5
NOISE_N = 0.02


@pytest.fixture
def rig(settings: RigSettings, gains: Gains) -> Iterator[Lockstep]:
    """A rig whose cell reads 1.5 % too little and 1.5 N beside zero."""
    cell = {"gain_pct": 100.0 * (SCALE - 1.0), "bias_n": ZERO_N, "creep_pct": 0.0, "drift_n_h": 0.0}
    with lockstep(changed(settings, simulation={"cell": cell}), gains) as found:
        found.run(0.2)
        yield found


def test_a_commissioned_cell_reads_the_truth_and_the_ledger_says_why(rig: Lockstep, gains: Gains) -> None:
    twin = RigWithLedger(rig, gains)
    assert twin.standing.overdue
    assert twin.carry_out(Request(Verb.TARE, "kim")).standing is not None
    rig.rig.hang(WEIGHT_N)
    rig.run(1.0)
    filed = twin.carry_out(Request(Verb.CALIBRATE, "kim", WEIGHT_N, adopt=True))
    assert filed.finding is not None
    assert twin.standing.scale == pytest.approx(1.0 / SCALE, rel=1e-3)
    assert rig.run(1.0)["tension_n"].mean() == pytest.approx(WEIGHT_N + rig.rig.truth.tension_n, abs=5 * NOISE_N)
    rig.rig.hang(0.0)
    arm_and_tension(rig, settle_s=2.0)
    assert rig.run(1.0)["tension_n"].mean() == pytest.approx(rig.rig.truth.tension_n, abs=0.1)
    rig.hold()
    rig.run(1.0)
    for verb in (Verb.IDENTIFY, Verb.RESPONSE):
        filed = twin.carry_out(Request(verb, "kim"))
        assert filed.finding is not None, filed.text
    written = twin.entries()
    assert [entry.what for entry in written] == ["tare", "calibrate", "identify", "response"]
    assert not twin.standing.overdue
    found_n_mm = next(row["found"] for row in written[2].figures["rows"] if "n_mm" in row["key"])
    assert found_n_mm == pytest.approx(rig.settings.plant.stiffness_n_mm, rel=0.03)


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        (Request(Verb.IDENTIFY, "kim"), "wrong_mode"),  # DISARMED
        (Request(Verb.CALIBRATE, "kim", WEIGHT_N), "out_of_bounds"),  # nothing hangs
        (Request(Verb.CALIBRATE, "kim", shunt=True), "not_possible"),  # no shunt in the rig file
        (Request(Verb.GAINS, "kim", gain_file="no gains", name="gains.json"), "not_admitted"),
    ],
)
def test_what_finds_nothing_has_a_reason_and_no_entry(
    rig: Lockstep, gains: Gains, request_: Request, reason: str
) -> None:
    twin = RigWithLedger(rig, gains)
    filed = twin.carry_out(request_)
    assert (filed.finding, filed.reason) == (None, reason)
    assert filed.text
    assert twin.entries() == []
