"""A brake that is known not to hold is tested before the rig compensates: by `arm`, or by `brake-test` in HOLD."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from hil.faults import stand
from hil.faults.in_controller import trip
from hil.faults.in_device import brake_slips, creeps
from hil.faults.stand import Stand
from hil.lockstep import Lockstep, lockstep
from rigctl.config.changed_settings import changed
from rigctl.config.limits_section import LimitSettings
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.power.arming import BRAKE_TEST_MM, LONG_TEST_NS
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Flag, HeldBy, Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.branches import Started
from tests.builders.loop_changes import doubt_stroke, end_time_of_carrying
from tests.builders.loop_frames import worded_events

LIMIT_S = 25.0
TEST_S = LONG_TEST_NS * 1e-9
SINKS_MM = 0.2


def slips(rig: Lockstep, mm_s: float) -> None:
    brake_slips(mm_s)(Stand(rig, "brake test"))


def test_brake(rig: Lockstep) -> Refusal:
    return rig.command(Verb.BRAKE_TEST, limit_s=LIMIT_S)


test_brake.__test__ = False  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def held_once(settings: RigSettings, gains: Gains) -> Iterator[Started]:
    with lockstep(settings, gains) as subject:
        stand.start(subject, Mode.HOLD, 300.0)
        stand.enter(subject, Mode.HOLD)
        subject.run(1.0)
        yield Started.now(subject)


@pytest.fixture
def held(request: pytest.FixtureRequest, held_once: Started) -> Lockstep:
    """HOLD with 300 N on the motor."""
    return held_once.go_on(request)


@pytest.mark.parametrize("parked", [False, True], ids=["on the motor", "on the brake"])
def test_a_test_that_the_brake_passes_clears_the_flag_and_ends_on_the_motor(held: Lockstep, parked: bool) -> None:
    if parked:
        held.run(held.settings.hold.park_s + 1.0)
        assert held.view.braked
    held.loop.brake.set("a test of the test")
    held.loop.brake.slipped_n = held.rig.truth.tension_n
    began_ns = held.clock.now()
    assert test_brake(held) is Refusal.NONE
    assert held.clock.now() - began_ns > LONG_TEST_NS
    assert held.reply["tension_n"] == pytest.approx(held.rig.truth.tension_n, abs=1.0)
    assert not held.loop.brake.fails
    assert (held.loop.machine.mode, held.loop.machine.fault) == (Mode.HOLD, Fault.NONE)
    assert held.run(0.1)["held_by"][-1] == HeldBy.MOTOR


@pytest.mark.gate("0.02", "0.5")
@pytest.mark.parametrize("slip_mm_s", [0.01, 0.02, 0.1, 0.5, 1.5])
def test_a_test_that_the_brake_fails_gives_the_load_back_to_the_motor(held: Lockstep, slip_mm_s: float) -> None:
    slips(held, slip_mm_s)
    before_mm = held.rig.truth.stroke_mm
    assert test_brake(held) is Refusal.BRAKE_SLIPPED
    assert abs(held.reply["moved_mm"]) == pytest.approx(BRAKE_TEST_MM, abs=0.02)
    held.run(2.0)
    assert held.loop.machine.fault is Fault.BRAKE_SLIPS
    assert held.loop.brake.fails
    assert held.record["held_by"] == HeldBy.MOTOR
    assert abs(held.rig.truth.stroke_mm - before_mm) < SINKS_MM + 0.15 * slip_mm_s, "a drive takes 0.15 s to have it"


def test_too_little_load_shows_nothing_and_the_refusal_has_what_it_needs(held: Lockstep) -> None:
    assert test_brake(held) is Refusal.NONE, "any load is enough for a brake that nothing is known of"
    held.loop.brake.set("a test of the test")
    held.loop.brake.slipped_n = 1000.0
    assert test_brake(held) is Refusal.LITTLE_LOAD
    assert held.reply["needed_n"] == pytest.approx(800.0)
    assert held.loop.machine.mode is Mode.HOLD
    assert held.run(0.1)["held_by"][-1] == HeldBy.MOTOR, "a refusal touches nothing"


def test_hold_ends_a_test_on_the_brake(held: Lockstep) -> None:
    given = held.give(Verb.BRAKE_TEST)
    held.run(3.0)
    held.give(Verb.HOLD)
    assert held.answer(given) is Refusal.ABORTED
    held.run(1.0)
    assert (held.loop.machine.mode, held.view.braked) == (Mode.HOLD, True)


@pytest.mark.parametrize("mode", [Mode.DISARMED, Mode.COMPENSATING])
def test_it_is_for_hold_alone(rig: Lockstep, enter: Callable[[Mode], None], mode: Mode) -> None:
    enter(mode)
    assert test_brake(rig) is Refusal.WRONG_MODE
    assert rig.loop.machine.mode is mode


def test_a_rig_without_a_brake_keeps_its_load_on_the_motor(settings: RigSettings, gains: Gains) -> None:
    """There is nothing to test: with the drive off nothing would hold the load."""
    waived = changed(settings, {"cylinder.brake_waiver": "a study: self-locking screw", "cylinder.brake_test": False})
    with lockstep(waived, gains) as rig:
        stand.start(rig, Mode.HOLD, 300.0)
        stand.enter(rig, Mode.HOLD)
        rig.run(1.0)
        assert test_brake(rig) is Refusal.NO_BRAKE
        assert rig.run(0.5)["held_by"][-1] == HeldBy.MOTOR
        rig.loop.brake.set("a test of the test")
        assert rig.command(Verb.TENSION) is Refusal.NONE, "no test could clear it"
        rig.run_until(Mode.COMPENSATING, LIMIT_S)


def test_a_tension_on_a_brake_that_fails_ends_in_hold_for_the_test_and_never_compensates(held: Lockstep) -> None:
    """From a slack rope, with which ARM is allowed and tests nothing."""
    assert held.command(Verb.RELEASE) is Refusal.NONE
    held.run_until(Mode.HOLD, LIMIT_S)
    held.loop.brake.set("a test of the test")
    assert test_brake(held) is Refusal.SLACK
    assert held.command(Verb.TENSION) is Refusal.NONE
    modes = [held.loop.machine.mode]
    while held.loop.machine.mode is Mode.TENSIONING:
        modes.append(held.run(0.01)["mode"][-1])
    assert Mode.COMPENSATING not in modes
    assert held.loop.machine.mode is Mode.HOLD
    assert held.rig.truth.tension_n == pytest.approx(300.0, abs=3.0)
    assert held.run(0.3)["held_by"][-1] == HeldBy.MOTOR
    assert any("rigctl brake-test comes first" in event.text for _, event in worded_events(held))
    assert test_brake(held) is Refusal.NONE
    assert not held.loop.brake.fails
    assert held.command(Verb.TENSION) is Refusal.NONE
    held.run_until(Mode.COMPENSATING, LIMIT_S)


@pytest.mark.gate
@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.FAULT])
def test_a_load_is_not_given_to_a_brake_that_is_known_not_to_hold(held: Lockstep, mode: Mode) -> None:
    """The motor keeps it, and lowers it in the end; what was the brake's in `hold.park_s` is slack by then."""
    slips(held, 0.5)
    held.loop.brake.set("a test of the test")
    if mode is Mode.FAULT:
        trip(held, Action.HOLD)
    before_mm = held.rig.truth.stroke_mm
    held.run(held.settings.hold.park_s + 2.0)
    assert abs(held.rig.truth.stroke_mm - before_mm) < SINKS_MM
    assert (held.loop.machine.mode, held.record["held_by"]) == (mode, HeldBy.MOTOR)
    assert held.record["flags"] & Flag.CARRIES
    texts = [event.text for number, event in worded_events(held) if number == Kind.HELD]
    assert f"{mode.name}: load held by the motor, for at most 600 s" in texts
    end_time_of_carrying(held)
    held.run_until(Mode.RELEASING, 1.0)
    held.run_until(mode, LIMIT_S)
    assert held.view.slack
    held.run(held.settings.hold.park_s + 2.0)
    assert (held.loop.machine.mode, held.view.braked) == (mode, True), "a slack rope is left to any brake"


def test_a_cause_that_takes_the_power_off_leaves_a_load_kept_in_hold_to_the_motor(held: Lockstep) -> None:
    """POSITION_DRIFTS does not concern moving the load: it is latched, and the motor goes on, as while it carries."""
    slips(held, 0.5)
    held.loop.brake.set("a test of the test")
    held.run(held.settings.hold.park_s + 2.0)
    before_mm = held.rig.truth.stroke_mm
    creeps(0.3)(Stand(held, "brake test"))
    held.run_until(Mode.FAULT, 20.0)
    creeps(0.0)(Stand(held, "brake test"))
    held.run(3.0)
    assert held.loop.machine.fault is Fault.POSITION_DRIFTS
    assert held.record["held_by"] == HeldBy.MOTOR
    assert held.record["flags"] & Flag.CARRIES
    assert abs(held.rig.truth.stroke_mm - before_mm) < SINKS_MM
    trip(held, Action.QUICK_STOP, Fault.E_STOP)
    held.run(1.0)
    assert not held.view.carries, "what concerns moving the load stops the motor"


def test_a_limit_that_ramps_down_has_the_motor_lower_a_load_kept_in_hold(settings: RigSettings, gains: Gains) -> None:
    """The reaction of the rig file is the weaker one, and ends with a slack rope; the motor's 10 min are not waited."""
    limit = LimitSettings(signal="command_age_s", high=10.0, action="ramp_down")
    with lockstep(settings.model_copy(update={"limits": (*settings.limits, limit)}), gains) as rig:
        stand.start(rig, Mode.HOLD, 300.0)
        stand.enter(rig, Mode.HOLD)
        rig.loop.brake.set("a test of the test")
        rig.run_until(Mode.RELEASING, 12.0)
        assert rig.loop.machine.fault is Fault.LIMIT
        rig.run_until(Mode.FAULT, LIMIT_S)
        assert rig.view.slack


def test_a_fault_while_an_end_waits_for_the_load_does_not_give_it_to_that_brake(held: Lockstep) -> None:
    """The motor has the load in FAULT too: the end goes on waiting, and lowers it."""
    slips(held, 0.5)
    held.loop.brake.set("a test of the test")
    before_mm = held.rig.truth.stroke_mm
    held.loop.stop_requested = True
    held.run(3.0)
    trip(held, Action.HOLD)
    held.run(3.0)
    assert (held.loop.machine.mode, held.loop.finished) == (Mode.FAULT, False)
    assert held.record["held_by"] == HeldBy.MOTOR
    assert abs(held.rig.truth.stroke_mm - before_mm) < SINKS_MM
    held.run_until(Mode.RELEASING, 10.0)


def test_a_motor_that_does_not_hold_keeps_no_load(held: Lockstep) -> None:
    """A drive that creeps in FAULT, uncorrected, moves the load: its own stop and brake end that."""
    held.loop.brake.set("a test of the test")
    trip(held, Action.HOLD)
    doubt_stroke(held)
    creeps(0.3)(Stand(held, "brake test"))
    held.run(3.0)
    assert held.loop.machine.mode is Mode.FAULT
    assert not held.view.carries
