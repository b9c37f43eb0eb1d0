"""A held load: encoder and cell check each other, and no slow motion is hidden by the one that has stopped measuring.

The plant's truth is the judge: the load moves at most 1 mm, or its tension by 3 %.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from hil.faults import on_bus, stand
from hil.faults.in_device import CELL, SPEED, STROKE, both, brake_slips, creeps, reads, stuck
from hil.faults.stand import Injector, Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, LoadAtRest, Mode
from rigctl.model.verbs import Refusal, Verb

Floats = npt.NDArray[np.float64]
MOVED_MM, SHARE = 1.0, 0.03
STIFF_N_MM = 35.2  # 34 with the rope
ENCODER_STUCK = both(stuck(STROKE), reads(SPEED, times=0.0))
CELL_FROZEN = reads(CELL, freezes=True, noise=0.03)
AFTER_S = 0.5


def of_spring(settings: RigSettings, n_mm: float) -> RigSettings:
    if n_mm == settings.plant.spring_n_mm:
        return settings
    return changed(settings, {"plant.spring_n_mm": n_mm, "safety.waiver": "a study of a stiff spring, no load on it"})


def bring(rig: Lockstep, mode: Mode, tension_n: float = 300.0) -> None:
    stand.start(rig, mode, tension_n)
    stand.enter(rig, mode)
    rig.events.read()


def silence_cell(rig: Lockstep) -> None:
    on_bus.silent(on_bus.cell)(Stand(rig, "silent"))


class Truth:
    """True tension and stroke, once a tick, from the fault on."""

    def __init__(self, rig: Lockstep) -> None:
        self._rig, truth = rig, rig.rig.truth
        self._from_mm, self._from_n = truth.stroke_mm, truth.tension_n
        self.moved_mm = self.changed = 0.0  # largest
        self.at_fault_mm = self.at_fault = np.inf  # the same when the fault was latched

    def __call__(self) -> None:
        truth = self._rig.rig.truth
        self.moved_mm = max(self.moved_mm, abs(truth.stroke_mm - self._from_mm))
        self.changed = max(self.changed, abs(truth.tension_n / self._from_n - 1.0))
        if self._rig.loop.machine.fault is not Fault.NONE and np.isinf(self.at_fault):
            self.at_fault_mm, self.at_fault = self.moved_mm, self.changed

    @property
    def kept(self) -> bool:
        return self.moved_mm <= MOVED_MM or self.changed <= SHARE


def play(rig: Lockstep, fault: Injector, seconds: float) -> Truth:
    """The fault, for ``seconds`` or until `AFTER_S` after its trip."""
    truth = rig.on_advance = Truth(rig)
    step = fault(Stand(rig, "held load"))
    period_s = 1.0 / rig.settings.loop.rate_hz
    tick, last = 0, round(seconds / period_s)
    while tick < last:
        if step is not None:
            step(tick * period_s)
        before = rig.loop.machine.fault
        rig.loop.tick()
        if rig.loop.machine.fault is not before:
            last = min(last, tick + round(AFTER_S / period_s))
        tick += 1
    rig.on_advance = None
    return truth


@pytest.fixture(params=[6.0, STIFF_N_MM], ids=["6 N/mm", "34 N/mm"])
def held_by(request: pytest.FixtureRequest, settings: RigSettings) -> RigSettings:
    """The rig file with one of two springs."""
    return of_spring(settings, request.param)


@pytest.mark.gate("6 N/mm--0.4-300.0", "34 N/mm-0.4-350.0")
@pytest.mark.parametrize(("speed", "tension_n"), [(0.05, 300.0), (-0.1, 350.0), (0.4, 350.0), (-0.4, 300.0)])
def test_a_creep_that_a_stuck_encoder_hides_is_parked(
    held_by: RigSettings, gains: Gains, speed: float, tension_n: float
) -> None:
    with lockstep(changed(held_by, {"hold.park_s": 30.0}), gains) as rig:  # the motor holds until they disagree
        bring(rig, Mode.HOLD, tension_n)
        truth = play(rig, both(creeps(speed), ENCODER_STUCK), 2.0 / abs(speed))
        assert truth.kept, (truth.moved_mm, truth.changed)
        assert rig.rig.drive.control.stage.braked
        assert (rig.loop.machine.fault, rig.view.action) == (Fault.STRETCH_UNEXPLAINED, Action.POWER_OFF)


@pytest.mark.gate("6 N/mm--0.3-frozen", "34 N/mm--0.3-silent")
@pytest.mark.parametrize("cell", ["true", "frozen", "silent"])
@pytest.mark.parametrize("speed", [pytest.param(0.1, marks=pytest.mark.long), -0.3])
def test_an_encoder_that_drifts_takes_the_load_nowhere_whatever_the_cell_says(
    held_by: RigSettings, gains: Gains, speed: float, cell: str
) -> None:
    """The correction follows the encoder. A cell that has frozen or is silent does not say that nothing moved."""
    drifts = both(reads(STROKE, drift_s=speed), reads(SPEED, plus=speed))
    with lockstep(held_by, gains) as rig:
        bring(rig, Mode.HOLD)
        if cell == "silent":
            silence_cell(rig)
            rig.run(0.1)
            assert rig.loop.machine.fault is Fault.CELL_STALE
        truth = play(rig, both(drifts, CELL_FROZEN) if cell == "frozen" else drifts, 2.0 / abs(speed))
        assert truth.kept, (truth.moved_mm, truth.changed)
        assert rig.rig.drive.control.stage.braked
        assert rig.view.action is Action.POWER_OFF


@pytest.mark.gate("6 N/mm-0.5", "34 N/mm-0.2")
@pytest.mark.parametrize("speed", [0.05, 0.2, 0.5])
def test_a_brake_that_slips_unseen_by_the_encoder_is_a_fault_while_disarmed(
    held_by: RigSettings, gains: Gains, speed: float
) -> None:
    with lockstep(held_by, gains) as rig:
        bring(rig, Mode.DISARMED)
        rig.run(1.0)
        truth = play(rig, both(brake_slips(speed), ENCODER_STUCK), 2.0 / speed)
        assert rig.loop.machine.fault is Fault.LOAD_SINKS
        assert truth.at_fault_mm <= MOVED_MM or truth.at_fault <= SHARE


@pytest.mark.gate("6.0-0.01")
@pytest.mark.parametrize("speed", [0.005, 0.01, 0.012])
@pytest.mark.parametrize("spring_n_mm", [4.0, 6.0])
def test_the_slowest_slip_is_a_load_that_is_not_at_rest_and_a_fault_that_no_reset_ends(
    settings: RigSettings, gains: Gains, spring_n_mm: float, speed: float
) -> None:
    """It was "at rest" for 8 s of each 10 s, and 1.4 mm until LOAD_SINKS; on 4 N/mm 1.6 mm without a fault."""
    with lockstep(of_spring(settings, spring_n_mm), gains) as rig:
        bring(rig, Mode.DISARMED)
        rig.run(1.0)
        truth = play(rig, both(brake_slips(speed), ENCODER_STUCK), 1.0 / speed)
        assert rig.loop.machine.fault is Fault.LOAD_SINKS
        assert truth.at_fault_mm <= 0.5
        assert not LoadAtRest(int(rig.record["load_at_rest"])).rests
        for _ in range(3):
            assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
            assert HeldBy.BRAKE not in rig.run(10.0)["held_by"]
        rig.rig.drive.brake.slip_mm_s = 0.0
        rig.run(20.0)
        assert LoadAtRest(int(rig.record["load_at_rest"])).rests
        assert rig.command(Verb.RESET) is Refusal.NONE


def test_a_load_at_rest_after_a_reset_is_not_judged_by_what_was_before(settings: RigSettings, gains: Gains) -> None:
    """STROKE_MOVES by "0.03 mm/s" came from the 5 s before the reset."""
    with lockstep(settings, gains) as rig:
        bring(rig, Mode.DISARMED)
        rig.run(3.0)
        brake_slips(0.4)(Stand(rig, "slip"))
        rig.run(0.6)
        assert rig.loop.machine.fault is Fault.STROKE_MOVES
        rig.rig.drive.brake.slip_mm_s = 0.0
        until_ns = rig.clock.now() + 10_000_000_000
        while rig.command(Verb.RESET) is not Refusal.NONE:
            assert rig.clock.now() < until_ns
        rig.run(6.0)
        assert rig.loop.machine.fault is Fault.NONE


def test_a_payload_that_was_lifted_off_the_brake_is_no_loss_of_the_motor_that_holds_next(
    settings: RigSettings, gains: Gains
) -> None:
    """ARM tripped TENSION_LOW: the tension that the brake had held was still that of the rope."""
    with lockstep(settings, gains) as rig:
        bring(rig, Mode.DISARMED)
        rig.run(3.0)
        rig.rig.plant.parameters["free_length"] += 100.0
        rig.run(1.0)
        assert rig.loop.machine.fault is Fault.NONE
        assert rig.command(Verb.ARM, limit_s=10.0) is Refusal.NONE
        rig.run(3.0)
        assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.HOLD, Fault.NONE)


def test_a_slip_unseen_by_the_encoder_is_not_reset_while_it_goes_on(settings: RigSettings, gains: Gains) -> None:
    with lockstep(settings, gains) as rig:
        bring(rig, Mode.DISARMED)
        rig.run(1.0)
        both(brake_slips(0.3), ENCODER_STUCK)(Stand(rig, "slip"))
        rig.run(4.0)
        assert rig.loop.machine.fault is Fault.LOAD_SINKS
        assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
        assert rig.command(Verb.CARRY, 10.0) is Refusal.DISAGREE
        rig.rig.drive.brake.slip_mm_s = 0.0
        rig.run(2.0)
        assert rig.command(Verb.RESET) is Refusal.NONE


def test_a_carry_corrects_nothing_once_encoder_and_tension_disagree(settings: RigSettings, gains: Gains) -> None:
    """They agreed when it began; then the encoder drifts, and its correction would take the load along."""
    with lockstep(settings, gains) as rig:
        bring(rig, Mode.HOLD)
        rig.run(3.0)
        brake_slips(0.3)(Stand(rig, "slip"))
        rig.run(1.5)
        assert rig.loop.machine.fault is Fault.STROKE_MOVES
        assert rig.command(Verb.CARRY, 60.0) is Refusal.NONE
        rig.run(1.0)
        truth = Truth(rig)
        play(rig, both(reads(STROKE, drift_s=0.3), reads(SPEED, plus=0.3)), 20.0)
        truth()
        assert rig.rig.drive.control.enabled
        assert truth.kept, (truth.moved_mm, truth.changed)
