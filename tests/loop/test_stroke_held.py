"""HOLD, FAULT and DISARMED keep the stroke: a creeping drive is corrected or loses its power, within 1 mm."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt
import pytest

from hil.faults import in_device, stand
from hil.faults.in_controller import trip
from hil.faults.in_device import SPEED, STROKE, both, creeps, reads
from hil.faults.stand import Injector, Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.load.stroke_hold import AUTHORITY_MM_S, SHOWN_MM
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.branches import Started
from tests.builders.loop_changes import doubt_stroke

Floats = npt.NDArray[np.float64]
HELD_MM = 1.0
STEADY_MM = 0.15  # a corrected creep: 0.45 mm/s until the integral action corrects it, and the dead zone
WAYS = [1.0, pytest.param(-1.0, marks=pytest.mark.long)]
SLOW = {0.02: 12.0, 0.1: 6.0, 0.45: 1.6}  # mm/s, and s of observation: 0.24 mm and more without a correction
FAST = {0.55: 3.5, 2.0: 1.0, 8.0: 0.6}


@pytest.fixture(scope="module")
def held_once(settings: RigSettings, gains: Gains) -> Iterator[Started]:
    longest = settings.model_copy(update={"hold": settings.hold.model_copy(update={"park_s": 30.0})})
    with lockstep(longest, gains) as rig:
        bring(rig, Mode.HOLD)
        yield Started.now(rig)


@pytest.fixture
def held(request: pytest.FixtureRequest, held_once: Started) -> Lockstep:
    """A rig in HOLD, 300 N on the rope, held by the motor for as long as a rig file allows."""
    return held_once.go_on(request)


def bring(rig: Lockstep, mode: Mode) -> None:
    stand.start(rig, mode, None)
    stand.enter(rig, mode)
    rig.events.read()


def put_in(rig: Lockstep, fault: Injector) -> Callable[[float], None] | None:
    return fault(Stand(rig, "held"))


def moved_mm(rig: Lockstep, fault: Injector, seconds: float) -> Floats:
    """True stroke from its start, once a millisecond, from the fault's beginning on."""
    before, way = rig.rig.truth.stroke_mm, list[float]()
    step = put_in(rig, fault)
    rig.on_advance = lambda: way.append(rig.rig.truth.stroke_mm - before)
    for tick in range(round(seconds * rig.settings.loop.rate_hz)):
        if step is not None:
            step(tick * 1e-3)
        rig.loop.tick()
    rig.on_advance = None
    return np.array(way)


def told(rig: Lockstep, kind: Kind) -> list[str]:
    return [
        worded(int(e["kind"]), int(e["a"]), int(e["b"]), float(e["value"]), float(e["limit"]), "").text
        for e in rig.events.read()
        if e["kind"] == kind
    ]


# -- creep ------------------------------------------------------------------------------------------------------
@pytest.mark.gate("0.1-1.0-1")
@pytest.mark.parametrize("mode", [Mode.HOLD, pytest.param(Mode.FAULT, marks=pytest.mark.long)])
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("speed", SLOW)
def test_a_drive_that_creeps_slowly_is_corrected_until_the_brake_has_the_load(
    settings: RigSettings, gains: Gains, speed: float, way: float, mode: Mode
) -> None:
    with lockstep(settings, gains) as rig:
        bring(rig, mode)
        moved = moved_mm(rig, creeps(way * speed), max(SLOW[speed], 4.0))
        assert np.abs(moved).max() < HELD_MM
        assert np.ptp(moved[-200:]) == 0.0
        assert rig.rig.drive.control.stage.braked


@pytest.mark.gate("0.45-1.0")
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("speed", SLOW)
def test_a_drive_that_creeps_slowly_is_corrected(held: Lockstep, speed: float, way: float) -> None:
    moved = moved_mm(held, creeps(way * speed), SLOW[speed])
    assert np.abs(moved).max() < STEADY_MM
    assert (held.loop.machine.mode, held.loop.machine.fault) == (Mode.HOLD, Fault.NONE)
    assert held.rig.drive.control.enabled


@pytest.mark.gate("0.55-1.0-1", "2.0--1.0-5")
@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.FAULT])
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("speed", FAST)
def test_a_drive_that_creeps_fast_is_taken_off_power_within_a_millimetre(
    settings: RigSettings, gains: Gains, speed: float, way: float, mode: Mode
) -> None:
    with lockstep(settings, gains) as rig:
        bring(rig, mode)
        moved = moved_mm(rig, creeps(way * speed), FAST[speed])
        assert np.abs(moved).max() < HELD_MM
        assert rig.view.action is Action.POWER_OFF
        assert rig.rig.drive.control.stage.braked
        assert np.ptp(moved[-200:]) == 0.0


def test_a_creep_that_is_corrected_is_told_with_its_speed_once(held: Lockstep) -> None:
    moved_mm(held, creeps(0.15), 4.8)
    (text,) = told(held, Kind.DRIVE_CREEPS)
    assert text.startswith("the drive creeps at +0.1")
    assert "0x60B1" in text


@pytest.mark.study
def test_a_stroke_that_leaves_its_latch_is_told_once_and_again_once_it_was_back(held: Lockstep) -> None:
    """A position that contradicts its speed switches the correction off; what creeps then is only watched."""
    doubt_stroke(held)
    moved_mm(held, creeps(-0.1), 2.6)
    (text,) = told(held, Kind.STROKE_LEFT)
    assert "HOLD: the stroke is -0.20 mm from where it was latched" in text
    doubt_stroke(held, doubted=False)
    held.run(2.5)
    doubt_stroke(held)
    held.run(2.6)
    assert len(told(held, Kind.STROKE_LEFT)) == 1


def test_a_stroke_that_nothing_corrects_is_taken_off_power_as_a_fault_of_its_own(held: Lockstep) -> None:
    doubt_stroke(held)
    moved = moved_mm(held, creeps(0.3), 5.0)
    assert (held.loop.machine.fault, held.view.action) == (Fault.STROKE_NOT_HELD, Action.POWER_OFF)
    assert SHOWN_MM < np.abs(moved).max() < HELD_MM
    assert held.rig.drive.control.stage.braked


@pytest.mark.gate("-0.45")
@pytest.mark.parametrize("creep", [0.2, -0.45])
def test_a_creep_that_is_corrected_for_long_is_held_by_the_brake(held: Lockstep, creep: float) -> None:
    """A drift of the encoder with a cell that has frozen looks the same: the sum of the correction is bounded."""
    moved = moved_mm(held, creeps(creep), 1.2 / abs(creep))
    assert np.abs(moved).max() < STEADY_MM
    assert (held.loop.machine.fault, held.view.action) == (Fault.POSITION_DRIFTS, Action.POWER_OFF)
    assert held.rig.drive.control.stage.braked


def test_the_issues_creep_no_longer_ends_at_733_newtons(settings: RigSettings, gains: Gains) -> None:
    """+0.45 mm/s, from HOLD and from a TENSION_HIGH whose reaction is hold."""
    with lockstep(settings, gains) as rig:
        bring(rig, Mode.HOLD)
        trip(rig, Action.HOLD, Fault.TENSION_HIGH)
        moved_mm(rig, creeps(0.45), 10.0)
        assert rig.rig.truth.tension_n < 303.0  # 1 %: 0.3 s without correction while the brake closes


# -- the latch --------------------------------------------------------------------------------------------------
@pytest.mark.gate("True")
@pytest.mark.parametrize("speed_up", [True, False])
def test_hold_at_speed_is_bumpless_and_is_not_pulled_back(rig: Lockstep, enter: Callable[[Mode], None],
                                                          speed_up: bool) -> None:  # fmt: skip
    enter(Mode.TENSIONING if speed_up else Mode.RELEASING)
    assert abs(rig.loop.inbox.drive.speed_mm_s) > 5.0
    direction = np.sign(rig.loop.inbox.drive.speed_mm_s)
    assert rig.command(Verb.HOLD) is Refusal.NONE
    records = rig.run(2.0)
    commands, strokes = records["command_mm_s"] * direction, records["stroke_mm"] * direction
    steps = np.abs(np.diff(commands))
    assert steps.max() <= rig.settings.tension.acceleration_max_mm_s2 * 1e-3 * (1 + 1e-9)
    assert commands.min() == 0.0, "no command against the way it went"
    assert np.diff(strokes).min() > -0.01
    assert commands[500:].max() == 0.0


@pytest.mark.study
def test_a_trial_moves_the_stroke_and_it_is_latched_where_it_ends(held: Lockstep) -> None:
    latched = held.view.latched_mm
    assert held.command(Verb.IDENTIFY, 1.0, limit_s=20.0) is Refusal.NONE
    assert Fault.NONE is held.loop.machine.fault
    held.run(1.0)
    assert held.view.latched_mm == pytest.approx(latched, abs=0.05)
    assert held.run(0.5)["command_mm_s"].any() is np.False_


def test_a_healthy_drive_in_hold_gets_commands_of_no_speed(held: Lockstep) -> None:
    assert not held.run(3.0)["command_mm_s"].any()
    assert held.command(Verb.DISARM) is Refusal.NONE
    held.run(0.3)
    assert held.rig.drive.control.stage.braked


@pytest.mark.gate("0.3")
@pytest.mark.parametrize("creep", [0.3, -0.3])
def test_a_drive_that_creeps_is_off_within_a_millimetre_once_it_is_disarmed(held: Lockstep, creep: float) -> None:
    """The drive never stands still, so it does not close its brake by itself: its power is cut."""
    before = held.rig.truth.stroke_mm
    moved_mm(held, creeps(creep), 2.0)
    assert held.command(Verb.DISARM) is Refusal.NONE
    held.run(1.5)
    assert held.rig.drive.control.stage.braked
    assert abs(held.rig.truth.stroke_mm - before) < HELD_MM
    assert held.loop.machine.fault in (Fault.STROKE_MOVES, Fault.DRIVE_UNASKED, Fault.STROKE_NOT_HELD)
    assert held.view.action is Action.POWER_OFF


@pytest.mark.study
def test_a_stroke_that_slips_slowly_while_disarmed_is_a_fault(settings: RigSettings, gains: Gains) -> None:
    """0.15 mm/s: too slow for the reported speed, which 0.2 mm/s trip."""
    with lockstep(settings, gains) as rig:
        bring(rig, Mode.DISARMED)
        rig.rig.plant.parameters["dead_band"] = 0.0
        rig.rig.drive.defect = lambda _speed, _braked: (-0.15, False)
        rig.run(7.0)
        assert rig.loop.machine.fault is Fault.STROKE_MOVES
        (text,) = told(rig, Kind.ESCALATION)
        assert "the brake does not hold" in text
        assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
        rig.rig.drive.defect = None
        rig.run(6.0)
        assert rig.command(Verb.RESET) is Refusal.NONE
        rig.run(1.0)
        assert rig.command(Verb.ARM) is Refusal.NONE


# -- a wrong encoder ----------------------------------------------------------------------------------------------
@pytest.mark.gate("its speed is true-1.2", "its speed drifts with it-0.55")
@pytest.mark.parametrize("speed", [0.2, -0.45, 0.55, 1.2])
@pytest.mark.parametrize("too", [False, True], ids=["its speed is true", "its speed drifts with it"])
def test_a_position_that_drifts_does_not_take_the_load_along(
    settings: RigSettings, gains: Gains, speed: float, too: bool
) -> None:
    drifts = reads(STROKE, drift_s=speed)
    with lockstep(settings, gains) as rig:
        bring(rig, Mode.HOLD)
        moved = moved_mm(rig, both(drifts, reads(SPEED, plus=speed)) if too else drifts, 1.0 / abs(speed) + 1.0)
        assert np.abs(moved).max() < HELD_MM
        assert rig.view.action is Action.POWER_OFF
        assert rig.rig.drive.control.stage.braked


def test_a_correction_is_bounded_by_what_a_drive_that_follows_may_need(held: Lockstep) -> None:
    put_in(held, reads(STROKE, plus=0.45))  # below the jump that trips DRIVE_NOT_FOLLOWING
    assert np.abs(held.run(1.0)["command_mm_s"]).max() <= AUTHORITY_MM_S
    assert abs(held.rig.truth.stroke_mm - held.view.latched_mm) < HELD_MM


# -- a reaction that does not help ----------------------------------------------------------------------------------
def test_a_quick_stop_that_does_not_stop_ends_with_the_power_off(held: Lockstep) -> None:
    put_in(held, creeps(0.3))
    held.run(0.1)
    trip(held, Action.QUICK_STOP)
    before = held.rig.truth.stroke_mm
    held.run(1.0)
    (text,) = told(held, Kind.ESCALATION)
    assert "LIMIT, reaction did not help: the stroke still moves at 0.30 mm/s after the quick stop" in text
    assert held.rig.drive.control.stage.braked
    assert abs(held.rig.truth.stroke_mm - before) < 0.2


def test_a_tension_that_goes_on_rising_is_not_only_held(settings: RigSettings, gains: Gains) -> None:
    """The position is wrong too: the stroke does not seem to move."""
    with lockstep(settings, gains) as rig:
        stand.start(rig, Mode.HOLD, 399.0)
        stand.enter(rig, Mode.HOLD)
        rig.events.read()
        put_in(rig, both(creeps(0.45), in_device.stuck(STROKE), reads(SPEED, times=0.0)))
        for _ in range(6000):
            rig.tick()
            if rig.loop.machine.fault is not Fault.NONE:
                break
        rig.run(0.6)
        assert (rig.loop.machine.fault, rig.view.action) == (Fault.TENSION_HIGH, Action.HOLD)
        assert rig.rig.drive.control.stage.braked, "FAULT ends on the brake at once, whatever the encoder shows"
        assert rig.rig.truth.tension_n < 402.0  # 394 N, and 1 mm on the way to the brake
