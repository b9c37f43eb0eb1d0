"""Every mode against every event and every command."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.control.machine import ARM_LIMIT_NS, Answer, Machine
from rigctl.control.modes import TRANSITIONS, TRIED_IN, Event, Mode, Refusal, Situation, Verb, decide, next_mode
from rigctl.control.safety import Fault, Trip
from rigctl.devices.drive import Power

READY = Situation(unloaded=True, target_min_n=50.0, target_max_n=350.0)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("event", Event)
def test_an_event_moves_the_mode_only_where_the_table_says(mode: Mode, event: Event) -> None:
    assert next_mode(mode, event) is TRANSITIONS.get((mode, event), mode)


@pytest.mark.parametrize("mode", Mode)
def test_a_trip_latches_from_anywhere_and_only_a_reset_leaves(mode: Mode) -> None:
    assert next_mode(mode, Event.TRIP) is Mode.FAULT
    leaving = {event for event in Event if next_mode(Mode.FAULT, event) is not Mode.FAULT}
    assert leaving == {Event.RESET_HELD, Event.RESET_OFF}


def test_the_closed_loop_is_reached_only_through_tensioning() -> None:
    into = {mode for (mode, event), after in TRANSITIONS.items() if after is Mode.COMPENSATING}
    assert into == {Mode.TENSIONING}


ACCEPTED = {
    Mode.DISARMED: {Verb.ARM, Verb.TARGET, Verb.TARE, Verb.CALIBRATE},
    Mode.HOLD: {Verb.TENSION, Verb.RELEASE, Verb.HOLD, Verb.DISARM, Verb.TARGET, *TRIED_IN},
    Mode.TENSIONING: {Verb.RELEASE, Verb.HOLD, Verb.TARGET},
    Mode.COMPENSATING: {Verb.RELEASE, Verb.HOLD, Verb.TARGET},
    Mode.RELEASING: {Verb.TENSION, Verb.HOLD, Verb.TARGET},
    Mode.FAULT: {Verb.RESET, Verb.DISARM, Verb.TARGET},
}


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("verb", Verb)
def test_each_command_is_accepted_in_these_modes_only(mode: Mode, verb: Verb) -> None:
    decision = decide(mode, verb, 300.0, READY)
    assert (decision.refusal is Refusal.NONE) == (verb in ACCEPTED[mode])


@pytest.mark.parametrize("value", [49.9, 350.1, -300.0, math.nan, math.inf])
def test_a_target_outside_its_limits_is_refused(value: float) -> None:
    assert decide(Mode.HOLD, Verb.TARGET, value, READY).refusal is Refusal.OUT_OF_RANGE


def test_guards() -> None:
    assert decide(Mode.DISARMED, Verb.ARM, 0, Situation(failed_checks=1)).refusal is Refusal.PREFLIGHT
    assert decide(Mode.FAULT, Verb.RESET, 0, Situation(cause_present=True)).refusal is Refusal.CAUSE_PRESENT
    assert decide(Mode.FAULT, Verb.RESET, 0, Situation(drive_enabled=True)).event is Event.RESET_HELD
    assert decide(Mode.FAULT, Verb.RESET, 0, Situation()).event is Event.RESET_OFF
    assert decide(Mode.DISARMED, Verb.RESET, 0, Situation(drive_faulted=True)).refusal is Refusal.NONE
    unseen = Situation(drive_faulted=True, cause_present=True)
    assert decide(Mode.DISARMED, Verb.RESET, 0, unseen).refusal is Refusal.CAUSE_PRESENT
    assert decide(Mode.HOLD, Verb.RELEASE, 0, Situation(slack=True)).refusal is Refusal.ALREADY
    assert decide(Mode.HOLD, Verb.TARE, 0, Situation()).refusal is Refusal.LOADED
    assert decide(Mode.HOLD, Verb.IDENTIFY, 1.0, Situation(slack=True)).refusal is Refusal.SLACK


def armed() -> Machine:
    machine = Machine()
    machine.command(1, Verb.ARM, 0.0, READY, 0)
    machine.follow_drive(True, 1)
    machine.changes.clear()
    machine.answers.clear()
    return machine


def test_arming_ends_when_the_drive_is_enabled_or_gives_up() -> None:
    machine = Machine()
    machine.command(7, Verb.ARM, 0.0, READY, 0)
    assert machine.arming
    assert machine.mode == Mode.DISARMED
    assert machine.power(0, drive_enabled=False, drive_faulted=False) is Power.ON
    machine.follow_drive(False, ARM_LIMIT_NS)
    assert machine.answers[-1].refusal is Refusal.DRIVE_TIMEOUT
    assert machine.power(ARM_LIMIT_NS, drive_enabled=False, drive_faulted=False) is Power.OFF
    machine.command(8, Verb.ARM, 0.0, READY, 0)
    machine.follow_drive(True, 1)
    assert machine.mode is Mode.HOLD
    assert (machine.answers[-1].id, machine.answers[-1].refusal) == (8, Refusal.NONE)


def test_a_drive_that_dropped_out_is_not_switched_on_again_by_itself() -> None:
    machine = armed()
    assert machine.power(5, drive_enabled=True, drive_faulted=False) is Power.ON
    assert machine.power(5, drive_enabled=False, drive_faulted=False) is Power.OFF
    machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0))
    assert machine.power(5, drive_enabled=True, drive_faulted=False) is Power.ON
    assert machine.power(5, drive_enabled=False, drive_faulted=False) is Power.OFF


@pytest.mark.parametrize("verb", TRIED_IN)
@pytest.mark.parametrize("what", ["command", "trip", "stop"])
def test_a_trial_is_answered_when_it_is_over_or_when_anything_comes_in_between(verb: Verb, what: str) -> None:
    machine = armed()
    machine.command(2, verb, 0.0, replace(READY, drive_enabled=True), 5)
    assert (machine.trial, machine.answers) == (verb, [])
    if what == "command":
        machine.command(3, Verb.HOLD, 0.0, READY, 6)
    elif what == "trip":
        machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0))
    else:
        machine.stop()
    assert machine.trial is None
    assert machine.answers[0] == Answer(2, verb, Refusal.ABORTED)


def test_the_first_fault_stays_named_until_reset() -> None:
    machine = armed()
    machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0))
    machine.trip(Trip(Fault.DRIVE_FAULT, 1.0, 0.0))
    assert machine.fault is Fault.CELL_STALE
    machine.command(2, Verb.RESET, 0.0, Situation(drive_enabled=True), 10)
    assert (machine.mode, machine.fault) == (Mode.HOLD, Fault.NONE)


def test_stopping_holds_and_takes_no_more_commands() -> None:
    machine = armed()
    machine.command(2, Verb.TENSION, 0.0, READY, 5)
    machine.stop()
    assert machine.mode is Mode.HOLD
    machine.command(3, Verb.RELEASE, 0.0, READY, 6)
    assert machine.answers[-1].refusal is Refusal.STOPPING
    assert machine.mode is Mode.HOLD


@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("verb"), st.sampled_from(Verb), st.booleans()),
            st.tuples(st.just("event"), st.sampled_from([Event.TENSIONED, Event.SLACK]), st.booleans()),
            st.tuples(st.just("trip"), st.sampled_from(list(Fault)[1:]), st.booleans()),
            st.tuples(st.just("drive"), st.booleans(), st.booleans()),
        ),
        max_size=40,
    )
)
def test_whatever_happens_a_fault_stays_until_a_reset_and_every_command_is_answered(steps: list) -> None:  # type: ignore[type-arg]
    machine, asked = Machine(), 0
    for t, (kind, what, flag) in enumerate(steps):
        before = machine.mode
        if kind == "verb":
            asked += 1
            machine.command(asked, what, 300.0, Situation(drive_enabled=flag, target_max_n=400.0), t)
        elif kind == "event":
            machine.on(what)
        elif kind == "trip":
            machine.trip(Trip(what, 1.0, 0.0))
            assert machine.mode is Mode.FAULT
        else:
            machine.follow_drive(what, t)
        if before is Mode.FAULT and machine.mode is not Mode.FAULT:
            assert what is Verb.RESET
        assert (machine.fault is not Fault.NONE) == (machine.mode is Mode.FAULT)
        assert machine.mode is not Mode.DISARMED or not machine.drive_wanted
    machine.follow_drive(False, ARM_LIMIT_NS * 2)
    machine.end_trial(Refusal.NONE)
    assert sorted(answer.id for answer in machine.answers) == list(range(1, asked + 1))
