"""The cell's creep on the rig: recorded under a hanging weight, fitted, put in force, and gone from the tension."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from hil.lockstep import Lockstep, lockstep
from rigctl.commission.load_record import bins_of
from rigctl.config.compensation_section import CompensationSettings
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import CREEP_BINS
from rigctl.control.law.tension import Gains
from rigctl.ipc.correction import Correction, CreepTerm
from rigctl.ipc.ledger import Standing
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.requests import Request
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Setting, Verb
from rigctl.operations.calibration_findings import CalibrationFinding, FindingError, Measured
from rigctl.operations.creep_finding import creep
from tests.builders.rig_bench import changed

WEIGHT_N = 294.2
NOISE_N = 3 * 0.03 / math.sqrt(200)  # of a mean over a second
CREEP = {"creep_pct": 0.03, "creep_s": 6.0, "creep2_pct": 0.02, "creep2_s": 25.0, "drift_n_h": 0.0}
TERMS = (CreepTerm(3e-4, 6.0), CreepTerm(2e-4, 25.0))
RECORD_S = 60.0
NEW = Standing()
RATE_HZ, STEP_US = 200, 1000  # nothing here depends on the loop's rate or the plant's step, and the record is long


def fitted(settings: RigSettings, **cell: float) -> RigSettings:
    """The rig with a cell that creeps within seconds, and a loop that takes creep out."""
    made = changed(settings, loop={"rate_hz": RATE_HZ}, simulation={"cell": CREEP | cell, "step_us": STEP_US})
    return made.model_copy(update={"compensation": CompensationSettings()})


@pytest.fixture
def weighed(settings: RigSettings, gains: Gains) -> Iterator[Lockstep]:
    with lockstep(fitted(settings), gains) as subject:
        subject.run(0.2)
        yield subject


def record(rig: Lockstep) -> Measured:
    """Give the command, hang the weight 4.5 s later, wait for the answer."""
    given = rig.give(Verb.CALIBRATE, WEIGHT_N, RECORD_S)
    rig.run(4.5)
    rig.rig.cell.hang(WEIGHT_N)
    rig.run(RECORD_S + 1.0)
    (reply,) = [reply for reply in rig._replies.read() if reply["id"] == given]
    assert reply["reason"] == Refusal.NONE
    return Measured.of(reply, 0)


def found(rig: Lockstep, measured: Measured, now: Standing = NEW, *, adopt: bool = False) -> CalibrationFinding:
    request = Request(Verb.CALIBRATE, "kim", WEIGHT_N, creep_s=RECORD_S, adopt=adopt)
    bins = bins_of(rig.runtime.events.reader(from_start=True).read())
    return creep(rig.settings, request, now, measured, bins)


def off_n(rig: Lockstep, seconds: float) -> float:
    """Mean of the tension over a time, less the weight and the rope's own tension."""
    return float(rig.run(seconds)["tension_n"].mean()) - WEIGHT_N - rig.rig.truth.tension_n


def test_a_creep_is_recorded_adopted_and_gone(weighed: Lockstep) -> None:
    rig = weighed
    given = found(rig, record(rig), adopt=True)
    assert given.good
    assert "of the cell alone" in given.text
    parts = bins_of(rig.runtime.events.reader(from_start=True).read())
    assert parts[0].after_s < 0.0 < parts[1].after_s
    assert parts[0].mean_n == pytest.approx(0.0, abs=NOISE_N)
    assert CREEP_BINS - 3 <= len(parts) <= CREEP_BINS + 1
    assert parts[-1].after_s > 0.9 * RECORD_S
    assert all(math.isnan(part.cell_c) for part in parts)  # no temperature in the rig file
    assert given.entry.what == "creep"
    assert given.order is not None
    before_n = off_n(rig, 2.0)
    assert before_n == pytest.approx(WEIGHT_N * 5e-4, rel=0.1)  # it has crept nearly to its end
    known_n = WEIGHT_N * (given.entry.after["creep_u"] or math.nan)
    assert known_n < 0.3 * before_n
    assert rig.command(given.order.setting, *given.order.values) is Refusal.NONE
    events = rig.events.read()
    assert Kind.CREEP in events["kind"]
    assert abs(off_n(rig, 2.0)) < known_n + NOISE_N
    rig.rig.cell.hang(0.0)  # the creep stays on the unloaded cell, and is taken out there too
    rig.run(0.1)
    unloaded = rig.run(1.0)
    assert abs(float(unloaded["reading_n"].mean())) > 0.05
    assert abs(float(unloaded["tension_n"].mean())) < known_n + NOISE_N
    assert rig.loop.machine.fault is Fault.NONE


@pytest.mark.parametrize("recorded", [True, False])
def test_a_weight_taken_off_slowly_is_a_load_that_sinks_unless_it_is_recorded(
    weighed: Lockstep, recorded: bool
) -> None:
    rig = weighed
    if recorded:
        rig.give(Verb.CALIBRATE, WEIGHT_N, RECORD_S)
        rig.run(4.5)
    rig.rig.cell.hang(WEIGHT_N)
    rig.run(2.0)
    for tenth in range(60):
        rig.rig.cell.hang(WEIGHT_N - 0.2 * tenth)
        rig.run(0.1)
    assert rig.loop.machine.mode is (Mode.DISARMED if recorded else Mode.FAULT)
    assert rig.loop.machine.fault is (Fault.NONE if recorded else Fault.LOAD_SINKS)


@pytest.mark.study
def test_a_held_rope_is_recorded_but_says_nothing_of_the_cell_alone(settings: RigSettings, gains: Gains) -> None:
    with lockstep(fitted(settings).model_copy(update={"loop": settings.loop}), gains) as rig:
        rig.run(0.2)
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Verb.CALIBRATE, WEIGHT_N, 20.0) is Refusal.SLACK
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run_until(Mode.COMPENSATING, 15.0)
        assert rig.command(Verb.HOLD) is Refusal.NONE
        rig.run(0.3)
        assert rig.command(Verb.CALIBRATE, WEIGHT_N, 20.0, limit_s=21.0) is Refusal.NONE
        given = found(rig, Measured.of(rig.reply, 0))
        assert not given.good
        assert "cell, rope, spring and mechanism together" in given.text
        with pytest.raises(FindingError, match="nothing was changed"):
            found(rig, Measured.of(rig.reply, 0), adopt=True)


def test_no_creep_beyond_its_bounds_is_taken_and_none_while_the_rope_is_regulated(
    settings: RigSettings, gains: Gains
) -> None:
    with lockstep(fitted(settings).model_copy(update={"loop": settings.loop}), gains) as rig:
        rig.run(0.2)
        assert rig.command(Setting.CREEP, 9e-4, 30.0, 2e-4, 600.0, math.nan) is Refusal.OUT_OF_RANGE
        assert rig.command(Setting.CREEP, 2e-4, 0.1, 2e-4, 600.0, math.nan) is Refusal.OUT_OF_RANGE
        assert rig.loop.inbox.cell_correction.correction == Correction()
        assert rig.command(Setting.CREEP, 2e-4, 30.0, 2e-4, 600.0, math.nan) is Refusal.NONE
        assert rig.command(Verb.ARM) is Refusal.NONE
        assert rig.command(Verb.TENSION) is Refusal.NONE
        rig.run(1.0)
        assert rig.command(Setting.CREEP, 1e-4, 30.0, 0.0, 600.0, math.nan) is Refusal.WRONG_MODE


def test_a_loop_that_starts_under_load_says_that_it_does_not_know_the_history(
    settings: RigSettings, gains: Gains
) -> None:
    with lockstep(fitted(settings), gains, correction=Correction(creep=TERMS)) as rig:
        told = rig.events.read()
        (event,) = told[told["kind"] == Kind.CREEP]
        assert event["a"] == 0
        rig.run(0.1)
        assert rig.loop.inbox.cell_correction.doubt_n == pytest.approx(350.0 * 5e-4, rel=0.05)
