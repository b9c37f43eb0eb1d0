"""HOLD and FAULT end on the brake, and what moves the stroke takes the load back: judged by the plant's truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from hil.faults import on_bus, stand
from hil.faults.in_controller import trip
from hil.faults.in_device import SPEED, STROKE, both, brake_slips, creeps, reads, stuck
from hil.faults.in_plant import payload_moves
from hil.faults.stand import Injector, Stand
from hil.lockstep import Lockstep, lockstep
from hil.nodes.cylinder_drive import ServiceTool
from rigctl.config.settings import RigSettings
from rigctl.control.commands import command_checks
from rigctl.control.excitation.trials import Average
from rigctl.control.law.tension import Gains
from rigctl.control.load.load_at_rest import REST_NS
from rigctl.control.power.stage import ARM_LIMIT_NS
from rigctl.devices import objects
from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, Mode
from rigctl.model.verbs import Refusal, Setting, Verb
from tests.builders.branches import Started
from tests.builders.loop_changes import end_time_of_trial

REST_S = REST_NS * 1e-9
HELD_MM, HELD_SHARE = 1.0, 0.03  # the promise to whoever relies on a held load
TAKEN_S = 0.2  # the drive's states and its brake, beside the tick that finds them


@pytest.fixture(scope="module")
def held_once(settings: RigSettings, gains: Gains) -> Iterator[Started]:
    with lockstep(settings, gains) as rig:
        stand.start(rig, Mode.HOLD, None)
        stand.enter(rig, Mode.HOLD)
        yield Started.now(rig)


@pytest.fixture
def held(request: pytest.FixtureRequest, held_once: Started) -> Lockstep:
    """A rig in HOLD that has just been armed, 300 N on the rope."""
    return held_once.go_on(request)


@pytest.fixture(scope="module")
def parked_once(settings: RigSettings, gains: Gains) -> Iterator[Started]:
    with lockstep(settings, gains) as rig:
        stand.start(rig, Mode.HOLD, None)
        stand.enter(rig, Mode.HOLD)
        rig.run(settings.hold.park_s + 0.5)
        assert rig.rig.drive.control.stage.braked
        yield Started.now(rig)


@pytest.fixture
def parked(request: pytest.FixtureRequest, parked_once: Started) -> Lockstep:
    return parked_once.go_on(request)


def held_by(rig: Lockstep) -> HeldBy:
    return HeldBy(int(rig.run(0.01)["held_by"][-1]))


def put_in(rig: Lockstep, fault: Injector) -> Callable[[float], None] | None:
    return fault(Stand(rig, "parking"))


def stays(rig: Lockstep, seconds: float) -> bool:
    """The true load stays within 1 mm and 3 % for so long."""
    n, mm = rig.rig.truth.tension_n, rig.rig.truth.stroke_mm
    strays = [0.0, 0.0]

    def look() -> None:
        strays[0] = max(strays[0], abs(rig.rig.truth.tension_n - n) / n)
        strays[1] = max(strays[1], abs(rig.rig.truth.stroke_mm - mm))

    rig.on_advance = look
    rig.run(seconds)
    rig.on_advance = None
    return strays[0] <= HELD_SHARE and strays[1] <= HELD_MM


# -- the brake takes the load ---------------------------------------------------------------------------------------
def test_a_hold_at_standstill_ends_on_the_brake_with_the_drive_off(held: Lockstep) -> None:
    assert held_by(held) is HeldBy.MOTOR
    records = held.run(held.settings.hold.park_s + 0.5)
    assert set(records["mode"]) == {Mode.HOLD}
    states = [int(state) for i, state in enumerate(records["held_by"]) if not i or state != records["held_by"][i - 1]]
    assert states == [HeldBy.MOTOR, HeldBy.CLOSING, HeldBy.BRAKE]
    assert held.rig.drive.control.stage.braked
    assert not held.rig.drive.control.enabled
    assert stays(held, 5.0)


def test_the_rig_file_says_how_long_the_motor_holds(settings: RigSettings, gains: Gains) -> None:
    for park_s in (0.5, 4.0):
        hold = settings.hold.model_copy(update={"park_s": park_s})
        with lockstep(settings.model_copy(update={"hold": hold}), gains) as rig:
            stand.start(rig, Mode.HOLD, None)
            assert rig.command(Verb.ARM) is Refusal.NONE
            records = rig.run(park_s + 1.0)
            motor_s = np.count_nonzero(records["held_by"] == HeldBy.MOTOR) / settings.loop.rate_hz
            assert motor_s == pytest.approx(park_s, abs=0.05)


@pytest.mark.gate("0.4")
@pytest.mark.parametrize("creep", [0.4, -0.4])
def test_a_creep_that_no_encoder_sees_ends_on_the_brake(held: Lockstep, creep: float) -> None:
    """300 N fell to 61 N, or rose to 406 N, in 100 s of a HOLD under power."""
    put_in(held, both(creeps(creep), both(stuck(STROKE), reads(SPEED, times=0.0))))
    assert stays(held, 8.0)


@pytest.mark.parametrize("drift", [0.3, pytest.param(-0.3, marks=pytest.mark.long)])
def test_an_encoder_that_drifts_does_not_take_the_load_along(held: Lockstep, drift: float) -> None:
    put_in(held, reads(STROKE, drift_s=drift))
    assert stays(held, 10.0)


@pytest.mark.study
@pytest.mark.parametrize("drift", [0.3, pytest.param(-0.3, marks=pytest.mark.long)])
def test_a_fault_is_held_by_the_brake_whatever_the_encoder_shows(held: Lockstep, drift: float) -> None:
    """FAULT by a silent cell: HOLD's own correction took 300 N to 193 N in 60 s."""
    put_in(held, on_bus.silent(on_bus.cell))
    put_in(held, reads(STROKE, drift_s=drift))
    assert stays(held, 15.0)
    assert (held.loop.machine.mode, held.loop.machine.fault) == (Mode.FAULT, Fault.CELL_STALE)
    assert held.rig.drive.control.stage.braked


def test_a_parked_load_that_is_lost_at_once_is_a_fault_until_it_is_reset(parked: Lockstep) -> None:
    """300 N went to 0 in 2 s of a parked HOLD without a line."""
    put_in(parked, payload_moves(80.0, 40.0))
    parked.run(2.5)
    assert (parked.loop.machine.mode, parked.loop.machine.fault) == (Mode.FAULT, Fault.TENSION_LOW)
    assert parked.rig.drive.control.stage.braked
    assert parked.command(Verb.RESET) is Refusal.NONE
    parked.run(1.0)
    assert (parked.loop.machine.mode, parked.loop.machine.fault) == (Mode.HOLD, Fault.NONE)


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_fault_parks_as_soon_as_the_stroke_stands_still(rig: Lockstep) -> None:
    trip(rig, Action.HOLD)
    for _ in range(round(0.6 * rig.settings.loop.rate_hz)):  # 0.2 s at standstill and the brake's 0.1 s
        if rig.rig.drive.control.stage.braked:
            break
        rig.tick()
    assert rig.rig.drive.control.stage.braked
    assert held_by(rig) is HeldBy.CLOSING, "the load has not been seen at rest for so long yet"
    records = rig.run(REST_S + 0.5)
    assert set(records["held_by"]) == {HeldBy.CLOSING, HeldBy.BRAKE}
    assert records["held_by"][-1] == HeldBy.BRAKE
    assert rig.loop.machine.mode is Mode.FAULT


def test_a_load_that_moves_on_the_closed_brake_is_not_held_by_it(parked: Lockstep) -> None:
    """Behind an encoder that has stuck: the drive is off, and the tension falls."""
    assert held_by(parked) is HeldBy.BRAKE
    put_in(parked, both(brake_slips(0.1), both(stuck(STROKE), reads(SPEED, times=0.0))))
    parked.run(2.5)
    assert held_by(parked) is HeldBy.UNKNOWN
    assert not parked.rig.drive.control.enabled
    parked.rig.drive.brake.slip_mm_s = 0.0
    parked.run(REST_S + 0.5)
    assert held_by(parked) is HeldBy.BRAKE


def test_no_command_of_no_consequence_keeps_the_motor_on(held: Lockstep) -> None:
    for _ in range(8):
        assert held.command(Verb.TARGET, 290.0) is Refusal.NONE
        assert held.command(Verb.HOLD) is Refusal.NONE
        held.run(0.5)
    assert held.rig.drive.control.stage.braked


def test_a_stop_of_the_process_leaves_a_parked_load_on_the_brake(parked: Lockstep) -> None:
    parked.loop.stop_requested = True
    parked.run(1.0)
    assert parked.loop.finished
    assert parked.rig.drive.control.stage.braked


# -- the motor takes it back ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("verb", "mode"), [(Verb.TENSION, Mode.TENSIONING), (Verb.RELEASE, Mode.RELEASING)])
def test_a_parked_hold_is_left_by_taking_the_load_back(parked: Lockstep, verb: Verb, mode: Mode) -> None:
    before, since = parked.rig.truth.tension_n, parked.clock.now()
    assert parked.command(verb) is Refusal.NONE
    assert parked.loop.machine.mode is mode, "it is answered when the motion begins"
    assert 0.0 < float(parked.reply["taken_s"]) <= TAKEN_S, "the answer names it"
    assert parked.clock.now() - since <= TAKEN_S * 1e9
    assert parked.rig.truth.tension_n == pytest.approx(before, rel=HELD_SHARE)
    assert not parked.rig.drive.control.stage.braked
    assert parked.run(0.5)["held_by"][-1] == HeldBy.NOTHING


def test_a_whole_cycle_from_a_parked_hold_and_back(parked: Lockstep) -> None:
    assert parked.command(Verb.TENSION) is Refusal.NONE
    parked.run_until(Mode.COMPENSATING, 10.0)
    assert parked.command(Verb.HOLD) is Refusal.NONE
    assert np.isnan(parked.reply["taken_s"])
    assert held_by(parked) is HeldBy.MOTOR
    parked.run(3.0)
    assert held_by(parked) is HeldBy.BRAKE
    assert parked.command(Verb.RELEASE) is Refusal.NONE
    parked.run_until(Mode.HOLD, 20.0)
    parked.run(3.0)
    assert held_by(parked) is HeldBy.BRAKE
    assert parked.rig.truth.tension_n < parked.settings.tension.slack_n


def test_a_hold_while_the_motor_takes_the_load_closes_the_brake_again(parked: Lockstep) -> None:
    first = parked.give(Verb.TENSION)
    parked.run(0.03)
    assert parked.view.pending is Verb.TENSION
    assert parked.command(Verb.HOLD) is Refusal.NONE
    parked.run(0.5)
    assert first
    assert parked.loop.machine.mode is Mode.HOLD
    assert parked.rig.drive.control.stage.braked


def test_a_drive_that_does_not_come_on_is_refused_in_time_and_the_brake_stays_closed(
    parked: Lockstep, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parked.rig.drive.control, "_enable", lambda _t_ns: None)
    since = parked.clock.now()
    assert parked.command(Verb.TENSION) is Refusal.DRIVE_TIMEOUT
    assert parked.clock.now() - since <= ARM_LIMIT_NS + TAKEN_S * 1e9
    assert parked.loop.machine.mode is Mode.HOLD
    assert parked.rig.drive.control.stage.braked
    assert stays(parked, 2.0)


@pytest.mark.parametrize("verb", [Verb.ARM, Verb.TENSION])
def test_a_sync_lost_while_the_brake_opens_is_a_fault(settings: RigSettings, gains: Gains, verb: Verb) -> None:
    """The daemon stayed DISARMED without a fault, the drive in OPERATION_ENABLED with its brake open."""
    with lockstep(settings, gains) as rig:
        stand.start(rig, Mode.HOLD, None)
        if verb is Verb.TENSION:
            stand.enter(rig, Mode.HOLD)
            rig.run(3.0)
        rig.give(verb)
        for _ in range(10_000):
            rig.loop.tick()
            if rig.view.taking:
                break
        rig.run(0.02)
        put_in(rig, on_bus.sync_lost())
        assert stays(rig, 5.0)
        assert rig.loop.machine.mode is Mode.FAULT


# -- which checks repeat --------------------------------------------------------------------------------------------
def read_backs(rig: Lockstep) -> int:
    return sum(int(event["kind"]) == Kind.READ_BACK for event in rig.events.read())


def test_a_load_parked_for_long_is_taken_back_after_a_read_back_of_every_object(
    parked: Lockstep, monkeypatch: pytest.MonkeyPatch
) -> None:
    read_backs(parked)
    assert parked.command(Verb.TENSION) is Refusal.NONE
    assert not read_backs(parked), "a short park needs none"
    assert parked.command(Verb.HOLD) is Refusal.NONE
    parked.run(3.0)
    monkeypatch.setattr(command_checks, "RECHECK_NS", 0)
    assert parked.command(Verb.TENSION) is Refusal.NONE
    assert read_backs(parked) == 1


@pytest.mark.study
def test_a_setting_lost_while_parked_bars_taking_the_load_back(parked: Lockstep) -> None:
    parked.rig.drive.device.set_data(objects.ABORT_CONNECTION_OPTION, 0, b"\0\0")
    parked.run(20.0)  # the read-back goes on, one object after the other
    assert parked.loop.machine.fault is Fault.SUPERVISION_LOST
    assert parked.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert parked.command(Verb.TENSION) is Refusal.WRONG_MODE
    assert parked.rig.drive.control.stage.braked


def test_no_brake_test_of_two_seconds_is_made_again(parked: Lockstep) -> None:
    parked.events.read()
    assert parked.command(Verb.TENSION) is Refusal.NONE
    assert not any(int(event["kind"]) == Kind.BRAKE_TEST for event in parked.events.read())


# -- trials ----------------------------------------------------------------------------------------------------------
@pytest.mark.study
def test_a_trial_has_the_motor_hold_by_name_and_for_a_stated_time(parked: Lockstep) -> None:
    parked.events.read()
    assert parked.command(Verb.IDENTIFY, 1.0, limit_s=20.0) is Refusal.NONE
    assert 0.0 < float(parked.reply["taken_s"]) <= TAKEN_S, "without the trial's own time"
    told = [event for event in parked.events.read() if int(event["kind"]) == Kind.HELD]
    powered = [event for event in told if int(event["b"]) == HeldBy.MOTOR]
    assert [bytes(event["text"]).rstrip(b"\0") for event in powered] == [b"IDENTIFY"]
    assert 5.0 < float(powered[0]["value"]) < 15.0
    parked.run(3.0)
    assert held_by(parked) is HeldBy.BRAKE


def test_a_trial_beyond_its_time_is_ended_and_the_load_parked(parked: Lockstep) -> None:
    id_ = parked.give(Verb.IDENTIFY, 1.0)
    parked.run(0.5)
    assert parked.view.trial is Verb.IDENTIFY
    end_time_of_trial(parked)
    parked.run(4.0)
    assert id_
    assert parked.view.trial is None
    assert parked.rig.drive.control.stage.braked


@pytest.mark.gate("8-1.9", "9-0.0", "9-3.0")
@pytest.mark.parametrize("held_s", [0.0, 1.9, 3.0])
@pytest.mark.parametrize("verb", [Verb.TARE, Verb.CALIBRATE])
def test_a_measurement_at_rest_waits_for_the_brake_to_have_the_load(rig: Lockstep, verb: Verb, held_s: float) -> None:
    assert rig.command(Verb.ARM) is Refusal.NONE
    rig.run(held_s)
    id_ = rig.give(verb, *([0.0, float("nan")] if verb is Verb.CALIBRATE else []))
    rig.tick()
    measured = rig.view.measurement
    assert isinstance(measured, Average)
    for _ in range(3000):
        assert rig.rig.drive.control.stage.braked or not measured.samples
        if rig.view.measurement is None:
            break
        rig.tick()
    assert rig.answer(id_) is Refusal.NONE
    assert held_by(rig) is HeldBy.BRAKE


# -- reset -----------------------------------------------------------------------------------------------------------
def test_a_reset_leads_to_a_parked_hold_and_from_there_on(parked: Lockstep) -> None:
    trip(parked, Action.HOLD)
    parked.run(2.0)
    assert parked.command(Verb.RESET) is Refusal.NONE
    assert parked.loop.machine.mode is Mode.HOLD
    assert held_by(parked) is HeldBy.BRAKE
    read_backs(parked)
    assert parked.command(Verb.TENSION) is Refusal.NONE
    assert read_backs(parked) == 1, "after a fault every object is read back"


@pytest.mark.parametrize("action", [Action.QUICK_STOP, Action.POWER_OFF])
def test_a_fault_that_took_the_power_off_is_reset_to_disarmed(held: Lockstep, action: Action) -> None:
    trip(held, action)
    held.run(2.0)
    assert held.command(Verb.RESET) is Refusal.NONE
    assert held.loop.machine.mode is Mode.DISARMED


@pytest.mark.parametrize("in_hold_for_s", [0.5, pytest.param(4.0, marks=pytest.mark.study)])
def test_an_emergency_stop_is_reset_to_disarmed(held: Lockstep, in_hold_for_s: float) -> None:
    held.run(in_hold_for_s)
    held.rig.drive.press_e_stop(True)
    held.run(1.0)
    held.rig.drive.press_e_stop(False)
    held.run(2.0)
    assert held.loop.machine.mode is Mode.FAULT
    assert held.command(Verb.RESET) is Refusal.NONE
    assert held.loop.machine.mode is Mode.DISARMED


def test_a_drive_that_went_off_by_itself_is_reset_to_disarmed(held: Lockstep) -> None:
    held.rig.drive.enable_by_wire(False)
    held.run(1.0)
    held.rig.drive.enable_by_wire(True)
    held.run(2.0)
    assert held.loop.machine.fault is Fault.DRIVE_NOT_FOLLOWING
    assert held.command(Verb.RESET) is Refusal.NONE
    assert held.loop.machine.mode is Mode.DISARMED


def test_disarming_a_parked_hold_is_answered_at_once(parked: Lockstep) -> None:
    since = parked.clock.now()
    assert parked.command(Verb.DISARM) is Refusal.NONE
    assert parked.clock.now() - since <= 5_000_000  # ticks
    assert parked.loop.machine.mode is Mode.DISARMED


def test_a_drive_that_is_switched_on_while_parked_is_a_fault(parked: Lockstep) -> None:
    """The checks of DISARMED hold: powered unasked."""
    parked.rig.drive.take_over(ServiceTool(0.0))
    parked.run(1.0)
    assert parked.loop.machine.fault in (Fault.DRIVE_UNASKED, Fault.DRIVE_REFUSES)


def test_gains_and_targets_of_a_parked_load_move_nothing(parked: Lockstep) -> None:
    assert parked.command(Verb.TARGET, 250.0) is Refusal.NONE
    assert parked.command(Setting.LAW_GAINS, 0.5, 0.1, 0.2) is Refusal.NONE
    assert stays(parked, 2.0)
    assert held_by(parked) is HeldBy.BRAKE
    assert parked.loop.law.target_n == 250.0


def test_a_fault_that_was_disarmed_is_reset_to_disarmed(parked: Lockstep) -> None:
    trip(parked, Action.HOLD)
    assert parked.command(Verb.DISARM) is Refusal.NONE
    assert parked.loop.machine.mode is Mode.FAULT
    assert parked.command(Verb.RESET) is Refusal.NONE
    assert parked.loop.machine.mode is Mode.DISARMED


def test_a_drives_own_fault_is_reset_to_disarmed(parked: Lockstep) -> None:
    parked.rig.drive.trip(0x7300)
    parked.run(2.0)
    assert parked.loop.machine.fault in (Fault.DRIVE_FAULT, Fault.DRIVE_EMERGENCY)
    assert parked.command(Verb.RESET) is Refusal.NONE
    assert parked.loop.machine.mode is Mode.DISARMED
    assert not parked.view.failed_checks & Check.DRIVE_FAULT or parked.run(1.0).size


# -- a rig without a brake ---------------------------------------------------------------------------------------------
@pytest.mark.study
def test_a_rig_that_needs_no_brake_is_held_by_the_motor(settings: RigSettings, gains: Gains) -> None:
    words = {"brake_waiver": "a study: the screw is self-locking", "brake_test": False}
    cylinder = settings.cylinder.model_copy(update=words)
    with lockstep(settings.model_copy(update={"cylinder": cylinder}), gains) as rig:
        stand.start(rig, Mode.HOLD, None)
        stand.enter(rig, Mode.HOLD)
        rig.run(10.0)
        assert held_by(rig) is HeldBy.MOTOR
        trip(rig, Action.HOLD)
        rig.run(5.0)
        assert held_by(rig) is HeldBy.MOTOR
