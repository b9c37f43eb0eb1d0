"""The zero follows the cell's temperature, from the amplifier or from the drive, and stays where it is without one."""

from __future__ import annotations

import math
from typing import Literal

import pytest

from hil.lockstep import Lockstep, lockstep
from rigctl.config.compensation_section import CompensationSettings
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.devices import objects as od
from rigctl.ipc.ledger import Standing
from rigctl.model.events import Kind
from rigctl.model.requests import Request
from rigctl.model.verbs import Refusal, Setting, Verb
from rigctl.operations import calibration_findings as findings
from rigctl.operations.calibration_findings import Measured
from tests.builders.rig_bench import changed

N_K = 0.02
CELL = {
    "temperature_c": 20.0,
    "warming_c_h": 3600.0,
    "zero_n_k": N_K,
    "creep_pct": 0.0,
    "drift_n_h": 0.0,
}  # 1 K a second
NOISE_N = 3 * 0.03 / math.sqrt(1000)


def fitted(settings: RigSettings, source: Literal["cell", "drive"], warming_c_h: float = 3600.0) -> RigSettings:
    made = changed(settings, simulation={"cell": CELL | {"warming_c_h": warming_c_h}})
    section = CompensationSettings(temperature=source, zero_n_k=N_K, zero_u_n_k=0.1 * N_K)
    return made.model_copy(update={"compensation": section})


def tared(rig: Lockstep) -> Standing:
    """Tare as the gateway does."""
    assert rig.command(Verb.TARE) is Refusal.NONE
    found = findings.tare(rig.settings, Request(Verb.TARE, "kim"), Standing(zero_n_k=N_K), Measured.of(rig.reply, 0))
    assert found.order is not None
    assert rig.command(found.order.setting, *found.order.values) is Refusal.NONE
    return Standing(**found.entry.after)  # type: ignore[arg-type]


def test_start_up_asks_the_amplifier_for_its_second_channel(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings, "cell", 0.0), gains) as rig:
        records = rig.run(1.0)
        assert records["cell_temperature_c"][-1] == pytest.approx(20.0, abs=0.01)
        assert rig.loop.inbox.frames_missing() == 0
        watched = {(item.index, item.sub): item.wanted for item in rig.report.watched}
        assert watched[od.AI_PHYSICAL_UNIT, 2] == od.SI_UNIT_CELSIUS
    with lockstep(settings, gains) as rig:
        assert math.isnan(rig.run(0.5)["cell_temperature_c"][-1])


@pytest.mark.study
def test_the_zero_follows_the_cells_temperature(settings: RigSettings, gains: Gains) -> None:
    """By 1 K a second; the low-pass of the temperature trails by its 10 s, so the cell stops warming at first."""
    with lockstep(fitted(settings, "cell"), gains) as rig:
        rig.run(0.5)
        standing = tared(rig)
        assert standing.zero_c == pytest.approx(20.6, abs=1.2)
        measurement = rig.rig.cell._measurement
        rig.run(8.0)
        measurement._warming_c_ns, measurement._start_c = 0.0, measurement.temperature_c
        measurement.bias_n = N_K * (measurement._start_c - 20.0)
        rig.run(25.0)
        last = rig.run(1.0)
        assert float(last["reading_n"].mean()) == pytest.approx(N_K * (measurement._start_c - 20.0), abs=NOISE_N)
        trails_n = N_K * 9.0 * math.exp(-2.5)
        assert abs(float(last["tension_n"].mean())) < trails_n + NOISE_N
        assert float(last["zero_drift_n"][-1]) > 0.1


def test_a_temperature_that_no_longer_comes_leaves_the_zero_and_says_so(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings, "cell", 0.0), gains) as rig:
        rig.run(0.5)
        tared(rig)
        assert rig.command(Verb.ARM) is Refusal.NONE
        identifier = od.CELL_TPDO2.cob_base + settings.tension_cell.node
        del rig.loop.inbox._channels[identifier]
        rig.loop.inbox.cell_temperature.t_ns -= 59_500_000_000
        rig.events.read()
        records = rig.run(1.0)
        told = rig.events.read()
        (event,) = told[told["kind"] == Kind.LIMIT]
        assert bytes(event["text"]).startswith(b"cell_temperature_age_ms")
        assert records["cell_temperature_c"][-1] == pytest.approx(20.0, abs=0.01)


def test_the_drives_temperature_will_do(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings, "drive", 0.0), gains) as rig:
        assert rig.run(1.0)["cell_temperature_c"][-1] == pytest.approx(25.0, abs=0.2)


def test_a_zero_without_a_temperature_does_not_drift(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings, "cell"), gains) as rig:
        rig.run(0.5)
        assert rig.command(Setting.ZERO, 0.01) is Refusal.NONE
        assert rig.run(2.0)["zero_drift_n"][-1] == 0.0
