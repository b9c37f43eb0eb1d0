"""Every mode against every event and every command."""

from __future__ import annotations

import itertools
import math
from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.control.commands.situation import Situation
from rigctl.control.modes import FILED, TRANSITIONS, Decision, command_slot, decide, next_mode
from rigctl.control.power.machine import Answer, Machine
from rigctl.control.power.stage import ARM_LIMIT_NS, CUT_AFTER_NS, DRIVE_RESET_NS, Sequence
from rigctl.control.watch.safety import Trip
from rigctl.devices.drive import Power
from rigctl.ipc.record import COMMAND
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Event, Mode
from rigctl.model.verbs import OFF_LIMIT_NS, TRIED_IN, Refusal, Setting, Verb
from tests.builders.outcomes import MachineLog

READY = Situation(
    unloaded=True,
    wanted_n=300.0,
    measured_mm=300.0,
    stroke_mm=300.0,
    target_min_n=50.0,
    target_max_n=350.0,
    moves=2,
    carry_s=60.0,
    at_rest=True,
)


ARMED = {Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING}
BY_ITSELF = {
    Event.ENABLED: ({Mode.DISARMED}, Mode.HOLD),
    Event.TENSIONED: ({Mode.TENSIONING}, Mode.COMPENSATING),  # the closed loop is reached through tensioning only
    Event.SLACK: ({Mode.RELEASING}, Mode.HOLD),
    Event.RAMP_DOWN: (ARMED - {Mode.RELEASING}, Mode.RELEASING),
    Event.STOP: (ARMED, Mode.HOLD),
    Event.RAMP_ENDS: ({Mode.RELEASING}, Mode.FAULT),
    Event.TRIP: (set(Mode), Mode.FAULT),
}
"""Events that no operator gives: the modes in which they mean something, and where they lead."""


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("event", BY_ITSELF)
def test_what_happens_by_itself_moves_the_rig_only_where_it_means_something(mode: Mode, event: Event) -> None:
    where, after = BY_ITSELF[event]
    assert next_mode(mode, event) is (after if mode in where else mode)


def test_only_a_reset_and_the_lowering_of_the_load_leave_a_fault() -> None:
    leaving = {event for event in Event if next_mode(Mode.FAULT, event) is not Mode.FAULT}
    assert leaving == {Event.RESET_HELD, Event.RESET_OFF, Event.LOWER, Event.RELEASE}


def test_a_release_in_fault_needs_the_motor_to_carry_a_tight_rope() -> None:
    assert decide(Mode.FAULT, Verb.RELEASE, READY).refusal is Refusal.WRONG_MODE
    assert decide(Mode.FAULT, Verb.RELEASE, replace(READY, carried_s=1.0)).event is Event.RELEASE
    assert decide(Mode.FAULT, Verb.RELEASE, replace(READY, carried_s=1.0, slack=True)).refusal is Refusal.ALREADY


def test_no_carry_while_the_emergency_stop_is_pressed() -> None:
    may = replace(READY, carry_s=10.0)
    assert decide(Mode.FAULT, Verb.CARRY, may).refusal is Refusal.NONE
    assert decide(Mode.FAULT, Verb.CARRY, replace(may, e_stop=True)).refusal is Refusal.CAUSE_PRESENT


@pytest.mark.parametrize("action", Action)
def test_what_took_the_power_off_is_armed_anew(action: Action) -> None:
    machine = Machine()
    machine.mode, machine.sequence = Mode.HOLD, Sequence(armed=True)
    machine.trip(Trip(Fault.LIMIT, 1.0, 0.0, action), 0)
    assert machine.sequence.armed is (action < Action.QUICK_STOP)


ACCEPTED = {
    Mode.DISARMED: {Verb.ARM, Verb.GAINS, Verb.TARGET, Verb.TARE, Verb.CALIBRATE, Verb.CONFIRM_STROKE},
    Mode.HOLD: {
        Verb.TENSION,
        Verb.RELEASE,
        Verb.HOLD,
        Verb.DISARM,
        Verb.GAINS,
        Verb.TARGET,
        Verb.BRAKE_TEST,
        *TRIED_IN,
    },
    Mode.TENSIONING: {Verb.RELEASE, Verb.HOLD, Verb.GAINS, Verb.TARGET},
    Mode.COMPENSATING: {Verb.RELEASE, Verb.HOLD, Verb.GAINS, Verb.TARGET, Verb.RESPONSE, Verb.MOVE},
    Mode.RELEASING: {Verb.TENSION, Verb.HOLD, Verb.GAINS, Verb.TARGET},
    Mode.FAULT: {Verb.RESET, Verb.DISARM, Verb.GAINS, Verb.TARGET, Verb.CONFIRM_STROKE, Verb.CARRY, Verb.LOWER},
}


LEADS_TO = {
    Verb.TENSION: Mode.TENSIONING,
    Verb.RELEASE: Mode.RELEASING,
    Verb.HOLD: Mode.HOLD,
    Verb.DISARM: Mode.DISARMED,
    Verb.RESET: Mode.DISARMED,
    Verb.LOWER: Mode.RELEASING,
}
"""The mode each command is for; the others change none."""
SO_ALREADY = {
    (Mode.DISARMED, Verb.DISARM), (Mode.TENSIONING, Verb.TENSION), (Mode.COMPENSATING, Verb.TENSION),
    (Mode.RELEASING, Verb.RELEASE), *((mode, Verb.ARM) for mode in ARMED),
}  # fmt: skip


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("verb", Verb)
def test_each_command_is_accepted_in_these_modes_only_and_leads_to_its_own(mode: Mode, verb: Verb) -> None:
    decision = decide(mode, verb, READY)
    if verb not in ACCEPTED[mode]:
        assert decision == Decision(Refusal.ALREADY if (mode, verb) in SO_ALREADY else Refusal.WRONG_MODE)
    elif verb in LEADS_TO and (mode, verb) != (Mode.FAULT, Verb.DISARM):
        assert decision.refusal is Refusal.NONE
        assert decision.event is not None
        assert next_mode(mode, decision.event) is LEADS_TO[verb]
    else:
        assert decision == Decision()  # a fault that is disarmed stays latched


def test_a_reset_of_an_armed_rig_leads_to_hold_unless_its_drive_is_at_fault() -> None:
    decision = decide(Mode.FAULT, Verb.RESET, Situation(armed=True))
    assert decision == Decision(event=Event.RESET_HELD)
    assert next_mode(Mode.FAULT, Event.RESET_HELD) is Mode.HOLD
    faulted = Situation(armed=True, drive_faulted=True)
    assert decide(Mode.FAULT, Verb.RESET, faulted) == Decision(event=Event.RESET_OFF)


def test_what_a_trial_finds_is_put_on_record_and_so_are_gains() -> None:
    assert {*TRIED_IN, Verb.GAINS} == FILED
    for verb in TRIED_IN:
        assert {mode for mode in Mode if verb in ACCEPTED[mode]} == set(verb.row.modes)


@pytest.mark.parametrize("value", [49.9, 350.1, -300.0, math.nan, math.inf])
def test_a_target_outside_its_limits_is_refused(value: float) -> None:
    assert decide(Mode.HOLD, Verb.TARGET, replace(READY, wanted_n=value)).refusal is Refusal.OUT_OF_RANGE


@pytest.mark.parametrize(
    ("measured_mm", "agrees"),
    [(50.5, True), (49.5, True), (50.0, True), (50.6, False), (49.4, False), (math.nan, False)],
)
def test_a_stroke_is_confirmed_within_half_a_millimetre(measured_mm: float, agrees: bool) -> None:
    situation = Situation(measured_mm=measured_mm, stroke_mm=50.0)
    refusal = Refusal.NONE if agrees else Refusal.STROKE_DIFFERS
    assert decide(Mode.DISARMED, Verb.CONFIRM_STROKE, situation).refusal is refusal
    assert decide(Mode.FAULT, Verb.CONFIRM_STROKE, Situation(measured_mm=measured_mm)).refusal is not Refusal.NONE


def test_guards() -> None:
    assert decide(Mode.DISARMED, Verb.ARM, Situation(failed_checks=1)).refusal is Refusal.PREFLIGHT
    assert decide(Mode.DISARMED, Verb.ARM, Situation(sunk_mm=1.0)).refusal is Refusal.SUNK
    assert decide(Mode.DISARMED, Verb.ARM, Situation(sunk_mm=math.nan)).refusal is Refusal.NONE
    assert decide(Mode.FAULT, Verb.RESET, Situation(causes=1)).refusal is Refusal.CAUSE_PRESENT
    assert decide(Mode.FAULT, Verb.RESET, Situation(stop_running=True)).refusal is Refusal.STOP_RUNNING
    assert decide(Mode.FAULT, Verb.RESET, Situation(armed=True)).event is Event.RESET_HELD
    assert decide(Mode.FAULT, Verb.RESET, Situation()).event is Event.RESET_OFF
    assert decide(Mode.DISARMED, Verb.RESET, Situation(drive_faulted=True)).refusal is Refusal.NONE
    unseen = Situation(drive_faulted=True, causes=1)
    assert decide(Mode.DISARMED, Verb.RESET, unseen).refusal is Refusal.CAUSE_PRESENT
    assert decide(Mode.FAULT, Verb.RESET, Situation(carried_s=1.0)).refusal is Refusal.CARRIED
    assert decide(Mode.FAULT, Verb.CARRY, Situation(carry_s=60.0, slack=True)).refusal is Refusal.SLACK
    assert decide(Mode.FAULT, Verb.CARRY, Situation(carry_s=60.0, apart_mm=0.1)).refusal is Refusal.DISAGREE
    assert decide(Mode.FAULT, Verb.LOWER, Situation(slack=True)).refusal is Refusal.ALREADY
    assert decide(Mode.FAULT, Verb.LOWER, Situation(apart_mm=0.1)) == Decision(event=Event.LOWER)
    assert decide(Mode.FAULT, Verb.LOWER, Situation(by=3.0)).refusal is Refusal.OUT_OF_RANGE
    assert decide(Mode.FAULT, Verb.LOWER, Situation(apart_mm=0.1, strays=True)).refusal is Refusal.DISAGREE
    assert decide(Mode.FAULT, Verb.LOWER, Situation(apart_mm=0.1, strays=True, by=2.0)) == Decision(event=Event.LOWER)
    assert decide(Mode.HOLD, Verb.RELEASE, Situation(slack=True)).refusal is Refusal.ALREADY
    assert decide(Mode.HOLD, Verb.TARE, Situation()).refusal is Refusal.LOADED
    assert decide(Mode.HOLD, Verb.IDENTIFY, Situation(slack=True, needs_tight=True)).refusal is Refusal.SLACK
    assert decide(Mode.HOLD, Verb.RESPONSE, Situation(slack=True)).refusal is Refusal.SLACK
    assert decide(Mode.HOLD, Verb.RESPONSE, Situation(regulated=1.0)).refusal is Refusal.WRONG_MODE
    assert decide(Mode.COMPENSATING, Verb.RESPONSE, Situation(regulated=0.0)).refusal is Refusal.WRONG_MODE


@pytest.mark.parametrize(("seconds", "fits"), [(1.0, True), (3600.0, True), (0.9, False), (3601.0, False),
                                               (math.nan, False)])  # fmt: skip
def test_a_carry_has_a_time_in_bounds(seconds: float, fits: bool) -> None:
    refusal = decide(Mode.FAULT, Verb.CARRY, Situation(carry_s=seconds)).refusal
    assert refusal is (Refusal.NONE if fits else Refusal.OUT_OF_RANGE)


@pytest.mark.parametrize("value", [50.0, 350.0])
def test_a_target_at_its_bound_is_inside(value: float) -> None:
    situation = Situation(wanted_n=value, target_min_n=50.0, target_max_n=350.0)
    assert decide(Mode.HOLD, Verb.TARGET, situation) == Decision()


@pytest.mark.parametrize("latched", [False, True])
@pytest.mark.parametrize("mode", Mode)
def test_a_hold_ends_a_ramp_down_alone_in_fault(mode: Mode, latched: bool) -> None:
    event = decide(mode, Verb.HOLD, Situation(fault=int(latched))).event
    assert (event is Event.RAMP_ENDS) == (latched and mode is Mode.RELEASING)


def test_guards_refuse_for_their_own_reason_only() -> None:
    assert decide(Mode.HOLD, Verb.IDENTIFY, Situation(slack=True)) == Decision()
    assert decide(Mode.HOLD, Verb.IDENTIFY, Situation(needs_tight=True)) == Decision()
    assert decide(Mode.HOLD, Verb.RESPONSE, Situation(regulated=0.0)) == Decision()
    assert decide(Mode.COMPENSATING, Verb.RESPONSE, Situation(regulated=1.0)) == Decision()
    assert decide(Mode.DISARMED, Verb.RESET, Situation()).refusal is Refusal.WRONG_MODE
    assert decide(Mode.FAULT, Verb.DISARM, Situation(causes=1, fault=Fault.LIMIT)) == Decision()


@pytest.mark.parametrize("value", [Situation(), Decision(), TRANSITIONS[Mode.HOLD, Event.TENSION]],
                         ids=lambda value: type(value).__name__)  # fmt: skip
def test_what_was_decided_is_not_changed_afterwards(value: object) -> None:
    with pytest.raises(FrozenInstanceError):
        value.refusal = None  # type: ignore[attr-defined]


def test_a_situation_of_which_nothing_is_known_has_no_reason_and_no_permission() -> None:
    nothing = Situation()
    assert not any((nothing.failed_checks, nothing.causes, nothing.stop_running, nothing.fault))
    assert not any((nothing.armed, nothing.drive_faulted, nothing.slack, nothing.unloaded, nothing.needs_tight))
    assert (nothing.wanted_n, nothing.measured_mm, nothing.target_min_n, nothing.target_max_n) == (0.0, 0.0, 0.0, 0.0)


GIVEN = {
    Verb.ARM: "near_end", Verb.TARGET: "target_n", Verb.CALIBRATE: "weight_n creep_s", Verb.IDENTIFY: "tight",
    Verb.CONFIRM_STROKE: "stroke_mm", Verb.RESPONSE: "regulated", Verb.MOVE: "move",
    Verb.CARRY: "carry_s by", Verb.LOWER: "by", Verb.RELEASE: "length_mm",
    Setting.ZERO: "zero_n zero_c zero_n_k second_zero_n",
    Setting.SCALE: "scale overdue second_scale", Setting.CREEP: "creep_1 creep_1_s creep_2 creep_2_s creep_held_s",
    Setting.OVERDUE: "overdue", Setting.HOST_CHECKS: "host_checks",
    Setting.LAW_GAINS: "k_tension k_speed k_integral", Setting.MARGINS: "sensitivity_peak sensitivity_peak_error",
    Setting.DIFFERS: "sensitivity_peak sensitivity_peak_error",
}  # fmt: skip


@pytest.mark.parametrize("code", [*Verb, *Setting])
def test_a_command_has_its_own_values_only(code: Verb | Setting) -> None:
    fields = [field.name for field in COMMAND.fields]
    slot = dict(zip(fields, command_slot(5, 7, code, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0), strict=True))
    assert (slot["t_ns"], slot["id"], slot["verb"]) == (5, 7, code)
    own = GIVEN.get(code, "").split()
    assert [slot[name] for name in own] == [1.0, 2.0, 3.0, 4.0, 5.0][: len(own)]
    assert all(math.isnan(slot[name]) for name in fields[3:] if name not in own)


def armed() -> MachineLog:
    machine = MachineLog()
    machine.command(1, Verb.ARM, READY, 0)
    machine.follow_drive(True, 1)
    machine.changes.clear()
    machine.answers.clear()
    return machine


def test_arming_ends_when_the_drive_is_enabled_or_gives_up() -> None:
    machine = MachineLog()
    machine.command(7, Verb.ARM, READY, 0)
    assert machine.sequence.pending is Verb.ARM
    assert machine.mode == Mode.DISARMED
    assert machine.power(0, drive_enabled=False, drive_faulted=False) is Power.OFF
    machine.prepared(0)
    assert machine.power(0, drive_enabled=False, drive_faulted=False) is Power.ON
    machine.follow_drive(False, ARM_LIMIT_NS)
    assert machine.answers[-1].refusal is Refusal.DRIVE_TIMEOUT
    assert machine.power(ARM_LIMIT_NS, drive_enabled=False, drive_faulted=False) is Power.OFF
    machine.command(8, Verb.ARM, READY, 0)
    machine.follow_drive(True, 1)
    assert machine.mode is Mode.HOLD
    assert (machine.answers[-1].id, machine.answers[-1].refusal) == (8, Refusal.NONE)


def test_a_drive_that_dropped_out_is_not_switched_on_again_by_itself() -> None:
    machine = armed()
    assert machine.power(5, drive_enabled=True, drive_faulted=False) is Power.ON
    assert machine.power(5, drive_enabled=False, drive_faulted=False) is Power.OFF
    machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0), 6)
    assert machine.power(5, drive_enabled=True, drive_faulted=False) is Power.ON
    assert machine.power(5, drive_enabled=False, drive_faulted=False) is Power.OFF


@pytest.mark.parametrize("verb", TRIED_IN)
@pytest.mark.parametrize("what", ["command", "trip", "stop"])
def test_a_trial_is_answered_when_it_is_over_or_when_anything_comes_in_between(verb: Verb, what: str) -> None:
    machine = armed()
    machine.command(2, verb, replace(READY, armed=True), 5)
    assert (machine.sequence.trial, machine.answers) == (verb, [])
    if what == "command":
        machine.command(3, Verb.HOLD, READY, 6)
    elif what == "trip":
        machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0), 6)
    else:
        machine.stop()
    assert machine.sequence.trial is None
    assert machine.answers[0] == Answer(2, verb, Refusal.ABORTED)


def test_the_first_fault_stays_named_until_reset() -> None:
    machine = armed()
    machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0), 6)
    machine.trip(Trip(Fault.DRIVE_FAULT, 1.0, 0.0), 7)
    assert machine.fault is Fault.CELL_STALE
    machine.command(2, Verb.RESET, Situation(armed=True), 10)
    assert (machine.mode, machine.fault) == (Mode.HOLD, Fault.NONE)


def compensating() -> MachineLog:
    machine = armed()
    machine.command(2, Verb.TENSION, READY, 5)
    machine.on(Event.TENSIONED)
    assert machine.mode is Mode.COMPENSATING
    return machine


WARM = Trip(Fault.LIMIT, 71.0, 70.0, Action.RAMP_DOWN, "drive_temperature_c above")


def test_a_limit_may_have_the_tension_ramped_down_and_the_fault_stays_latched_to_its_end() -> None:
    machine = compensating()
    assert machine.trip(WARM, 10, slack=False)
    assert (machine.mode, machine.fault) == (Mode.RELEASING, Fault.LIMIT)
    assert not machine.trip(WARM, 11, slack=False), "it is under way"
    latched = replace(READY, fault=Fault.LIMIT, armed=True)
    machine.command(3, Verb.TENSION, latched, 12)
    assert machine.answers[-1].refusal is Refusal.FAULT_LATCHED
    machine.on(Event.SLACK)
    assert (machine.mode, machine.fault) == (Mode.FAULT, Fault.LIMIT)
    machine.command(4, Verb.RESET, latched, 13)
    assert (machine.mode, machine.fault, machine.sequence.action) == (Mode.HOLD, Fault.NONE, Action.HOLD)


@pytest.mark.parametrize("how", ["hold", "trip", "stop"])
def test_a_ramp_down_is_ended_by_a_hold_a_stronger_trip_or_a_stop_and_holds_at_fault(how: str) -> None:
    machine = compensating()
    machine.trip(WARM, 10, slack=False)
    if how == "hold":
        machine.command(3, Verb.HOLD, replace(READY, fault=Fault.LIMIT), 12)
        assert machine.answers[-1].refusal is Refusal.NONE
    elif how == "trip":
        assert machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0), 12, slack=False)
    else:
        machine.stop()
    assert (machine.mode, machine.fault) == (Mode.FAULT, Fault.LIMIT)
    assert machine.power(13, drive_enabled=True, drive_faulted=False) is Power.ON


@pytest.mark.parametrize("slack", [True, False])
def test_a_ramp_down_is_a_hold_where_there_is_nothing_to_ramp(slack: bool) -> None:
    machine = compensating() if slack else MachineLog()
    assert machine.trip(WARM, 10, slack=slack)
    assert (machine.mode, machine.sequence.action) == (Mode.FAULT, Action.HOLD)


def test_a_power_off_at_once_does_not_wait_for_a_stop_even_of_one_under_way() -> None:
    enabled = {"drive_enabled": True, "drive_faulted": False}
    at_once = Trip(Fault.DRIVE_NOT_FOLLOWING, 9.0, 2.5, Action.POWER_OFF, at_once=True)
    for before in (None, Action.QUICK_STOP, Action.POWER_OFF):
        machine = compensating()
        if before is not None:
            machine.trip(Trip(Fault.LIMIT, 9.0, 8.0, before), 10)
            assert machine.power(20, **enabled) is Power.QUICK_STOP
        machine.trip(at_once, 20)
        assert machine.power(20, **enabled) is Power.CUT


def test_an_action_grows_stronger_but_never_weaker_while_the_fault_stands() -> None:
    machine = compensating()
    enabled = {"drive_enabled": True, "drive_faulted": False}
    assert machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0), 10)
    assert machine.power(11, **enabled) is Power.ON
    assert machine.trip(Trip(Fault.LIMIT, 9.0, 8.0, Action.QUICK_STOP), 20)
    assert machine.power(21, **enabled) is Power.QUICK_STOP
    assert machine.power(20 + CUT_AFTER_NS, **enabled) is Power.QUICK_STOP
    assert machine.trip(Trip(Fault.DRIVE_NOT_FOLLOWING, 9.0, 2.5, Action.POWER_OFF), 30)
    assert machine.power(19 + CUT_AFTER_NS, **enabled) is Power.QUICK_STOP
    assert machine.power(20 + CUT_AFTER_NS, **enabled) is Power.CUT  # the time of the quick stop is over
    assert not machine.trip(Trip(Fault.LIMIT, 9.0, 8.0, Action.QUICK_STOP), 40)
    assert machine.fault is Fault.CELL_STALE
    machine.command(3, Verb.RESET, Situation(), 50)
    assert (machine.mode, machine.power(51, **enabled)) == (Mode.DISARMED, Power.OFF)


def parked() -> MachineLog:
    machine = armed()
    machine.park()
    assert machine.power(2, drive_enabled=True, drive_faulted=False) is Power.OFF
    return machine


@pytest.mark.parametrize(("verb", "mode"), [(Verb.TENSION, Mode.TENSIONING), (Verb.RELEASE, Mode.RELEASING)])
def test_a_parked_hold_is_left_once_the_motor_has_the_load(verb: Verb, mode: Mode) -> None:
    machine = parked()
    machine.command(2, verb, READY, 10)
    assert (machine.mode, machine.sequence.pending, machine.answers) == (Mode.HOLD, verb, [])
    machine.prepared(11)
    assert machine.power(12, drive_enabled=False, drive_faulted=False) is Power.ON
    machine.follow_drive(True, 12)
    assert (machine.mode, machine.answers) == (mode, [Answer(2, verb, Refusal.NONE)])
    assert machine.power(13, drive_enabled=True, drive_faulted=False) is Power.ON


@pytest.mark.parametrize("verb", [Verb.IDENTIFY, Verb.RESPONSE])
def test_a_trial_that_moves_begins_once_the_motor_has_the_load(verb: Verb) -> None:
    machine = parked()
    machine.command(2, verb, READY, 10)
    assert machine.sequence.trial is None
    machine.follow_drive(True, 12)
    assert (machine.sequence.trial, machine.answers) == (verb, [])
    machine.park()
    assert machine.answers == [Answer(2, verb, Refusal.ABORTED)]


@pytest.mark.parametrize("verb", [Verb.TARE, Verb.CALIBRATE])
def test_a_measurement_at_rest_needs_no_power(verb: Verb) -> None:
    machine = parked()
    machine.command(2, verb, READY, 10)
    assert (machine.sequence.trial, machine.sequence.motor) == (verb, False)


@pytest.mark.parametrize("verb", [Verb.HOLD, Verb.DISARM, Verb.RELEASE, Verb.TARGET])
def test_a_command_meanwhile_leaves_the_load_on_the_brake(verb: Verb) -> None:
    machine = parked()
    machine.command(2, Verb.TENSION, READY, 10)
    machine.command(3, verb, READY, 11)
    machine.command(4, Verb.TENSION, READY, 12) if verb is Verb.TARGET else None
    found = [(answer.id, answer.refusal) for answer in machine.answers]
    if verb is Verb.TARGET:
        assert found == [(3, Refusal.NONE), (4, Refusal.ALREADY)]
    else:
        assert (2, Refusal.ABORTED) in found
        assert machine.mode is (Mode.DISARMED if verb is Verb.DISARM else Mode.HOLD)


def test_a_ramp_down_of_a_parked_load_is_a_hold() -> None:
    machine = parked()
    assert machine.trip(WARM, 10, slack=False)
    assert (machine.mode, machine.sequence.action) == (Mode.FAULT, Action.HOLD)
    machine.command(3, Verb.RESET, replace(READY, armed=machine.sequence.armed), 11)
    assert (machine.mode, machine.sequence.motor) == (Mode.HOLD, False)


SLIPS = Trip(Fault.STROKE_MOVES, 0.3, 0.2, Action.POWER_OFF)


def test_the_motor_carries_for_a_stated_time_though_the_slip_goes_on() -> None:
    machine = parked()
    machine.trip(SLIPS, 10)
    machine.command(3, Verb.CARRY, READY, 20)
    machine.prepared(21)
    assert not machine.trip(SLIPS, 22), "that is why the motor takes the load"
    assert machine.power(22, drive_enabled=False, drive_faulted=False) is Power.ON
    machine.follow_drive(True, 30)
    assert (machine.mode, machine.fault, machine.sequence.carry_until_ns) == (
        Mode.FAULT,
        Fault.STROKE_MOVES,
        30 + 60 * 10**9,
    )
    machine.lower(machine.sequence.carry_until_ns)
    assert (machine.mode, machine.sequence.action) == (Mode.RELEASING, Action.RAMP_DOWN)
    machine.on(Event.SLACK)
    assert (machine.mode, machine.fault, machine.sequence.carry_until_ns) == (Mode.FAULT, Fault.STROKE_MOVES, 0)


def test_any_other_trip_ends_a_carry() -> None:
    machine = parked()
    machine.trip(SLIPS, 10)
    machine.command(3, Verb.CARRY, READY, 20)
    machine.prepared(21)
    machine.follow_drive(True, 30)
    assert machine.trip(Trip(Fault.DRIVE_NOT_FOLLOWING, 1.0, 0.5, Action.POWER_OFF), 40)
    assert (machine.sequence.carry_until_ns, machine.sequence.motor) == (0, False)


def test_a_carry_whose_drive_does_not_come_on_has_the_brake_closed() -> None:
    machine = parked()
    machine.trip(SLIPS, 10)
    machine.command(3, Verb.CARRY, READY, 20)
    machine.prepared(21)
    machine.follow_drive(False, 21 + ARM_LIMIT_NS)
    assert machine.answers[-1].refusal is Refusal.DRIVE_TIMEOUT
    assert machine.power(22 + ARM_LIMIT_NS + CUT_AFTER_NS, drive_enabled=True, drive_faulted=False) is Power.CUT
    assert not machine.sequence.armed, "a reset leads to DISARMED, as after any power off"


FAULTED = Situation(armed=True, drive_faulted=True)


def reset_of_a_drive_at_fault() -> MachineLog:
    machine = MachineLog()
    machine.trip(Trip(Fault.CELL_STALE, 1.0, 0.5), 0)
    assert machine.command(1, Verb.RESET, FAULTED, 100) is None
    return machine


def test_a_reset_of_a_drive_at_fault_is_answered_when_the_drive_has_left_it() -> None:
    machine = reset_of_a_drive_at_fault()
    for t_ns in range(100, DRIVE_RESET_NS, DRIVE_RESET_NS // 100):
        machine.follow_drive(False, t_ns, drive_faulted=True)
        assert (machine.mode, machine.fault) == (Mode.FAULT, Fault.CELL_STALE)
    assert not machine.sequence.taking, "the motor is not commanded on"
    assert machine.answers == []
    machine.follow_drive(False, DRIVE_RESET_NS, drive_faulted=False)
    assert (machine.mode, machine.fault) == (Mode.DISARMED, Fault.NONE)
    assert machine.answers == [Answer(1, Verb.RESET, Refusal.NONE)]


def test_a_reset_that_the_drive_does_not_follow_leaves_fault_with_the_drive_as_its_cause() -> None:
    machine = reset_of_a_drive_at_fault()
    machine.follow_drive(False, 100 + DRIVE_RESET_NS, drive_faulted=True)
    assert (machine.mode, machine.fault) == (Mode.FAULT, Fault.DRIVE_FAULT)
    assert machine.answers == [Answer(1, Verb.RESET, Refusal.DRIVE_STATE)]
    power = machine.power(200 + DRIVE_RESET_NS, drive_enabled=False, drive_faulted=True)
    assert power not in (Power.RESET, Power.RESET_LOW)


@pytest.mark.parametrize(("off", "refusal"), [(True, Refusal.NONE), (False, Refusal.OFF_UNSEEN)])
def test_a_disarm_is_answered_when_the_drive_is_off_or_has_not_been_in_its_time(off: bool, refusal: Refusal) -> None:
    machine = armed()
    assert machine.command(2, Verb.DISARM, READY, 100) is None
    assert machine.mode is Mode.DISARMED, "the command is sent at once"
    for t_ns in (101, 99 + OFF_LIMIT_NS):
        machine.follow_off(t_ns, off=False)
        assert machine.answers == []
    machine.follow_off(100 + OFF_LIMIT_NS, off=off)
    assert machine.answers == [Answer(2, Verb.DISARM, refusal)]
    assert not machine.sequence.disarming


@pytest.mark.parametrize("verb", [Verb.HOLD, Verb.TENSION, Verb.RELEASE, Verb.MOVE])
def test_a_command_that_the_mode_refuses_leaves_a_disarm_as_it_is(verb: Verb) -> None:
    """HOLD had the DISARM answered with "nothing was changed", and the drive went off all the same."""
    machine = armed()
    machine.command(2, Verb.DISARM, READY, 100)
    assert machine.command(3, verb, READY, 101) is Refusal.WRONG_MODE
    assert machine.sequence.disarming
    machine.follow_off(102, off=True)
    assert machine.answers == [Answer(3, verb, Refusal.WRONG_MODE), Answer(2, Verb.DISARM, Refusal.NONE)]


def test_a_command_that_the_mode_refuses_leaves_a_waiting_one_and_a_trial_as_they_are() -> None:
    machine = MachineLog()
    machine.command(1, Verb.TARE, READY, 0)
    assert machine.command(2, Verb.TENSION, READY, 1) is Refusal.WRONG_MODE
    assert machine.sequence.trial is Verb.TARE
    assert machine.command(3, Verb.ARM, READY, 2) is None, "an accepted one ends the trial"
    assert machine.command(4, Verb.RELEASE, READY, 3) is Refusal.WRONG_MODE
    assert machine.sequence.pending is Verb.ARM
    assert machine.command(5, Verb.HOLD, READY, 4) is Refusal.NONE, "HOLD ends it, in any mode"
    assert [(answer.id, answer.refusal) for answer in machine.answers] == [
        (2, Refusal.WRONG_MODE), (1, Refusal.ABORTED), (4, Refusal.WRONG_MODE), (3, Refusal.ABORTED), (5, Refusal.NONE)
    ]  # fmt: skip


def test_a_stop_answers_the_disarm_under_way() -> None:
    machine = armed()
    machine.command(2, Verb.DISARM, READY, 100)
    machine.stop()
    machine.follow_off(101, off=True)
    assert machine.answers == [Answer(2, Verb.DISARM, Refusal.STOPPING)]


@pytest.mark.parametrize("verb", [Verb.HOLD, Verb.DISARM])
def test_hold_and_disarm_abort_a_reset(verb: Verb) -> None:
    machine = reset_of_a_drive_at_fault()
    machine.command(2, verb, FAULTED, 200)
    machine.follow_off(201, off=True)
    assert machine.answers == [Answer(1, Verb.RESET, Refusal.ABORTED), Answer(2, verb, Refusal.NONE)]
    machine.follow_drive(False, 300, drive_faulted=False)
    assert (machine.mode, machine.fault) == (Mode.FAULT, Fault.CELL_STALE)


def test_both_words_of_a_reset_stay_for_longer_than_a_drive_takes_to_read_them_again() -> None:
    machine, step_ns = reset_of_a_drive_at_fault(), 1_000_000
    powers = [machine.power(t, drive_enabled=False, drive_faulted=True) for t in range(100, DRIVE_RESET_NS, step_ns)]
    assert set(powers) == {Power.RESET, Power.RESET_LOW}
    runs = [len(list(run)) for _, run in itertools.groupby(powers)]
    assert all(20 <= length <= 30 for length in runs[1:-1])


def test_an_arming_drive_is_watched_as_in_hold() -> None:
    machine = MachineLog()
    assert machine.watched_mode is Mode.DISARMED
    machine.command(1, Verb.ARM, READY, 0)
    machine.prepared(1)
    assert (machine.mode, machine.watched_mode) == (Mode.DISARMED, Mode.HOLD)


def test_stopping_holds_and_takes_no_more_commands() -> None:
    machine = armed()
    machine.command(2, Verb.TENSION, READY, 5)
    machine.stop()
    assert machine.mode is Mode.HOLD
    machine.command(3, Verb.RELEASE, READY, 6)
    assert machine.answers[-1].refusal is Refusal.STOPPING
    assert machine.mode is Mode.HOLD


@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("verb"), st.sampled_from(Verb), st.booleans()),
            st.tuples(st.just("event"), st.sampled_from([Event.TENSIONED, Event.SLACK]), st.booleans()),
            st.tuples(st.just("trip"), st.sampled_from(list(Action)[1:]), st.booleans()),
            st.tuples(st.just("drive"), st.booleans(), st.booleans()),
        ),
        max_size=40,
    )
)
def test_whatever_happens_a_fault_stays_until_a_reset_and_every_command_is_answered(steps: list) -> None:  # type: ignore[type-arg]
    machine, asked = MachineLog(), 0
    for t, (kind, what, flag) in enumerate(steps):
        before = machine.mode
        if kind == "verb":
            asked += 1
            latched = machine.fault is not Fault.NONE
            situation = Situation(fault=int(latched), armed=flag, wanted_n=300.0, target_max_n=400.0)
            machine.command(asked, what, situation, t)
        elif kind == "event":
            machine.on(what)
        elif kind == "trip":
            machine.trip(Trip(Fault.LIMIT, 1.0, 0.0, what), t, slack=flag)
            assert machine.fault is not Fault.NONE
        else:
            machine.follow_drive(what, t)
        if before is Mode.FAULT and machine.mode is not Mode.FAULT:
            assert what is Verb.RESET or (machine.mode is Mode.RELEASING and machine.sequence.carry_until_ns)
        latched = machine.fault is not Fault.NONE
        assert machine.mode is not Mode.FAULT or latched
        assert not latched or machine.mode in (Mode.FAULT, Mode.RELEASING)
        assert not latched or machine.mode is Mode.FAULT or machine.sequence.action is Action.RAMP_DOWN
        assert machine.mode is not Mode.DISARMED or not machine.sequence.motor
    machine.follow_drive(False, ARM_LIMIT_NS)
    machine.follow_drive(False, ARM_LIMIT_NS * 2)
    machine.follow_off(OFF_LIMIT_NS * 2, off=False)
    machine.end_trial(Refusal.NONE)
    assert sorted(answer.id for answer in machine.answers) == list(range(1, asked + 1))
