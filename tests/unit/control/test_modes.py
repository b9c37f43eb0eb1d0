"""Every mode against every event and every command."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.control.faults import Fault
from rigctl.control.machine import ARM_LIMIT_NS, CUT_AFTER_NS, Answer
from rigctl.control.modes import TRANSITIONS, TRIED_IN, Event, Mode, Refusal, Situation, Verb, decide, next_mode
from rigctl.control.safety import Action, Trip
from rigctl.devices.drive import Power
from tests.builders.outcomes import MachineLog

READY = Situation(
    unloaded=True, wanted_n=300.0, measured_mm=300.0, stroke_mm=300.0, target_min_n=50.0, target_max_n=350.0
)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("event", Event)
def test_an_event_moves_the_mode_only_where_the_table_says(mode: Mode, event: Event) -> None:
    transition = TRANSITIONS.get((mode, event))
    assert next_mode(mode, event) is (mode if transition is None else transition.after)


@pytest.mark.parametrize("mode", Mode)
def test_a_trip_latches_from_anywhere_and_only_a_reset_leaves(mode: Mode) -> None:
    assert next_mode(mode, Event.TRIP) is Mode.FAULT
    leaving = {event for event in Event if next_mode(Mode.FAULT, event) is not Mode.FAULT}
    assert leaving == {Event.RESET_HELD, Event.RESET_OFF}


def test_the_closed_loop_is_reached_only_through_tensioning() -> None:
    into = {mode for (mode, _), transition in TRANSITIONS.items() if transition.after is Mode.COMPENSATING}
    assert into == {Mode.TENSIONING}


ACCEPTED = {
    Mode.DISARMED: {Verb.ARM, Verb.GAINS, Verb.TARGET, Verb.TARE, Verb.CALIBRATE, Verb.CONFIRM_STROKE},
    Mode.HOLD: {Verb.TENSION, Verb.RELEASE, Verb.HOLD, Verb.DISARM, Verb.GAINS, Verb.TARGET, *TRIED_IN},
    Mode.TENSIONING: {Verb.RELEASE, Verb.HOLD, Verb.GAINS, Verb.TARGET},
    Mode.COMPENSATING: {Verb.RELEASE, Verb.HOLD, Verb.GAINS, Verb.TARGET},
    Mode.RELEASING: {Verb.TENSION, Verb.HOLD, Verb.GAINS, Verb.TARGET},
    Mode.FAULT: {Verb.RESET, Verb.DISARM, Verb.GAINS, Verb.TARGET, Verb.CONFIRM_STROKE},
}


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("verb", Verb)
def test_each_command_is_accepted_in_these_modes_only(mode: Mode, verb: Verb) -> None:
    decision = decide(mode, verb, READY)
    assert (decision.refusal is Refusal.NONE) == (verb in ACCEPTED[mode])


@pytest.mark.parametrize("value", [49.9, 350.1, -300.0, math.nan, math.inf])
def test_a_target_outside_its_limits_is_refused(value: float) -> None:
    assert decide(Mode.HOLD, Verb.TARGET, replace(READY, wanted_n=value)).refusal is Refusal.OUT_OF_RANGE


def test_guards() -> None:
    assert decide(Mode.DISARMED, Verb.ARM, Situation(failed_checks=1)).refusal is Refusal.PREFLIGHT
    assert decide(Mode.FAULT, Verb.RESET, Situation(cause_present=True)).refusal is Refusal.CAUSE_PRESENT
    assert decide(Mode.FAULT, Verb.RESET, Situation(drive_enabled=True)).event is Event.RESET_HELD
    assert decide(Mode.FAULT, Verb.RESET, Situation()).event is Event.RESET_OFF
    assert decide(Mode.DISARMED, Verb.RESET, Situation(drive_faulted=True)).refusal is Refusal.NONE
    unseen = Situation(drive_faulted=True, cause_present=True)
    assert decide(Mode.DISARMED, Verb.RESET, unseen).refusal is Refusal.CAUSE_PRESENT
    assert decide(Mode.HOLD, Verb.RELEASE, Situation(slack=True)).refusal is Refusal.ALREADY
    assert decide(Mode.HOLD, Verb.TARE, Situation()).refusal is Refusal.LOADED
    assert decide(Mode.HOLD, Verb.IDENTIFY, Situation(slack=True, needs_tight=True)).refusal is Refusal.SLACK


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
    assert machine.arming
    assert machine.mode == Mode.DISARMED
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
    machine.command(2, verb, replace(READY, drive_enabled=True), 5)
    assert (machine.trial, machine.answers) == (verb, [])
    if what == "command":
        machine.command(3, Verb.HOLD, READY, 6)
    elif what == "trip":
        machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0), 6)
    else:
        machine.stop()
    assert machine.trial is None
    assert machine.answers[0] == Answer(2, verb, Refusal.ABORTED)


def test_the_first_fault_stays_named_until_reset() -> None:
    machine = armed()
    machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0), 6)
    machine.trip(Trip(Fault.DRIVE_FAULT, 1.0, 0.0), 7)
    assert machine.fault is Fault.CELL_STALE
    machine.command(2, Verb.RESET, Situation(drive_enabled=True), 10)
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
    latched = replace(READY, fault_latched=True, drive_enabled=True)
    machine.command(3, Verb.TENSION, latched, 12)
    assert machine.answers[-1].refusal is Refusal.FAULT_LATCHED
    machine.on(Event.SLACK)
    assert (machine.mode, machine.fault) == (Mode.FAULT, Fault.LIMIT)
    machine.command(4, Verb.RESET, latched, 13)
    assert (machine.mode, machine.fault, machine.action) == (Mode.HOLD, Fault.NONE, Action.HOLD)


@pytest.mark.parametrize("how", ["hold", "trip", "stop"])
def test_a_ramp_down_is_ended_by_a_hold_a_stronger_trip_or_a_stop_and_holds_at_fault(how: str) -> None:
    machine = compensating()
    machine.trip(WARM, 10, slack=False)
    if how == "hold":
        machine.command(3, Verb.HOLD, replace(READY, fault_latched=True), 12)
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
    assert (machine.mode, machine.action) == (Mode.FAULT, Action.HOLD)


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
            situation = Situation(fault_latched=latched, drive_enabled=flag, wanted_n=300.0, target_max_n=400.0)
            machine.command(asked, what, situation, t)
        elif kind == "event":
            machine.on(what)
        elif kind == "trip":
            machine.trip(Trip(Fault.LIMIT, 1.0, 0.0, what), t, slack=flag)
            assert machine.fault is not Fault.NONE
        else:
            machine.follow_drive(what, t)
        if before is Mode.FAULT and machine.mode is not Mode.FAULT:
            assert what is Verb.RESET
        latched = machine.fault is not Fault.NONE
        assert machine.mode is not Mode.FAULT or latched
        assert not latched or machine.mode in (Mode.FAULT, Mode.RELEASING)
        assert not latched or machine.mode is Mode.FAULT or machine.action is Action.RAMP_DOWN
        assert machine.mode is not Mode.DISARMED or not machine.drive_wanted
    machine.follow_drive(False, ARM_LIMIT_NS * 2)
    machine.end_trial(Refusal.NONE)
    assert sorted(answer.id for answer in machine.answers) == list(range(1, asked + 1))
