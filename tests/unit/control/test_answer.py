"""The answer to a command: what is under way, the mode, and the checks of a motor that takes the load."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.control.commands.situation import Situation
from rigctl.control.modes import NEEDS_MOTOR, Decision, answer, decide
from rigctl.control.power.machine import SUPERVISED_NS, Machine
from rigctl.control.watch.safety import Trip
from rigctl.model.checks import Check
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode, Witness
from rigctl.model.verbs import TRIED_IN, Refusal, Verb

READY = Situation(
    unloaded=True, wanted_n=300.0, measured_mm=300.0, stroke_mm=300.0, target_min_n=50.0, target_max_n=350.0, moves=2,
    carry_s=60.0, at_rest=True, brake_fails=True,
)  # fmt: skip
CELL, DRIVE, HOST = int(Check.CELL_STALE), int(Check.DRIVE_STALE), int(Check.HOST)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("verb", Verb)
def test_where_nothing_is_under_way_the_mode_answers(mode: Mode, verb: Verb) -> None:
    assert answer(mode, verb, READY) == decide(mode, verb, READY)


@pytest.mark.parametrize("verb", Verb)
def test_while_the_process_ends_every_command_is_refused(verb: Verb) -> None:
    assert answer(Mode.HOLD, verb, replace(READY, ends=True)).refusal is Refusal.STOPPING


def test_a_silence_ends_by_a_reset_once_the_drive_was_left_alone() -> None:
    silent = replace(READY, silent=True)
    assert answer(Mode.FAULT, Verb.RESET, silent).refusal is Refusal.STOP_RUNNING
    assert answer(Mode.FAULT, Verb.RESET, replace(silent, left_alone=True)).refusal is Refusal.NONE
    assert {answer(Mode.FAULT, verb, silent).refusal for verb in NEEDS_MOTOR} == {Refusal.WRONG_MODE}


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("pending", sorted({Verb.ARM, Verb.RESET, *NEEDS_MOTOR}))
def test_a_command_that_waits_for_the_drive_is_not_given_twice_and_ends_by_hold(mode: Mode, pending: Verb) -> None:
    waits = replace(READY, pending=pending)
    assert answer(mode, pending, waits).refusal is Refusal.ALREADY
    assert answer(mode, Verb.HOLD, waits) == Decision(ends=True)
    assert answer(mode, Verb.DISARM, waits).ends is (mode is Mode.DISARMED)


def test_nothing_is_measured_while_the_rig_is_armed() -> None:
    assert {answer(Mode.DISARMED, verb, replace(READY, pending=Verb.ARM)).refusal for verb in TRIED_IN} == {
        Refusal.WRONG_MODE
    }


@pytest.mark.parametrize("verb", [Verb.TARE, Verb.CALIBRATE])
def test_nothing_is_measured_while_a_command_waits_for_the_drive(verb: Verb) -> None:
    """IDENTIFY would end with the measurement's figures, and the measurement without an answer."""
    assert answer(Mode.HOLD, verb, replace(READY, pending=Verb.IDENTIFY)).refusal is Refusal.WRONG_MODE
    assert answer(Mode.HOLD, Verb.IDENTIFY, replace(READY, pending=Verb.TENSION)).refusal is Refusal.NONE


def test_a_trial_of_a_disarmed_rig_ends_by_hold_or_disarm() -> None:
    tries = replace(READY, tries=True)
    assert answer(Mode.DISARMED, Verb.HOLD, tries) == answer(Mode.DISARMED, Verb.DISARM, tries) == Decision(ends=True)
    assert answer(Mode.HOLD, Verb.HOLD, tries) == decide(Mode.HOLD, Verb.HOLD, READY)


def test_a_disarming_is_not_given_twice() -> None:
    assert answer(Mode.HOLD, Verb.DISARM, replace(READY, disarming=True)).refusal is Refusal.ALREADY


@pytest.mark.parametrize("verb", sorted(NEEDS_MOTOR - {Verb.CARRY, Verb.LOWER}))
def test_a_check_bars_what_takes_the_load_from_the_brake_and_a_check_of_arming_does_not(verb: Verb) -> None:
    parked = replace(READY, failed_checks=CELL)
    assert answer(Mode.HOLD, verb, parked).refusal is Refusal.PREFLIGHT
    assert answer(Mode.HOLD, verb, replace(parked, failed_checks=HOST)).refusal is Refusal.NONE
    on_motor = answer(Mode.HOLD, verb, replace(parked, powered=True)).refusal
    assert on_motor is (Refusal.PREFLIGHT if verb is Verb.BRAKE_TEST else Refusal.NONE)


@pytest.mark.parametrize(
    ("by", "witness", "failed", "refusal"),
    [
        (Witness.ENCODER, Witness.BOTH, CELL, Refusal.NONE),
        (Witness.CELL, Witness.BOTH, CELL, Refusal.PREFLIGHT),
        (Witness.BOTH, Witness.ENCODER, CELL, Refusal.NONE),
        (Witness.BOTH, Witness.CELL, CELL, Refusal.PREFLIGHT),
        (Witness.ENCODER, Witness.CELL, CELL, Refusal.NONE),
        (Witness.ENCODER, Witness.BOTH, int(Check.TENSION_HIGH), Refusal.NONE),
        (Witness.BOTH, Witness.BOTH, int(Check.TENSION_HIGH), Refusal.PREFLIGHT),
        (Witness.ENCODER, Witness.BOTH, DRIVE, Refusal.PREFLIGHT),
    ],
)
@pytest.mark.parametrize("mode", [Mode.DISARMED, Mode.HOLD, Mode.FAULT])
@pytest.mark.parametrize("verb", [Verb.CARRY, Verb.LOWER])
def test_a_load_that_the_brake_does_not_hold_is_barred_by_what_concerns_its_witness(
    verb: Verb, mode: Mode, by: Witness, witness: Witness, failed: int, refusal: Refusal
) -> None:
    slips = replace(READY, by=float(by), witness=witness, failed_checks=failed)
    assert answer(mode, verb, slips).refusal is refusal


def machines() -> dict[str, Machine]:
    """Machines with something under way, by what that is."""
    made = {name: Machine() for name in ("stopping", "silent", "arming", "resetting", "trial", "disarming")}
    made["stopping"].stop()
    made["silent"].trip(Trip(Fault.DRIVE_STALE, 1.0, 0.0, Action.SILENCE), 0)
    made["arming"].command(1, Verb.ARM, READY, 0)
    made["resetting"].command(1, Verb.RESET, replace(READY, drive_faulted=True), 0)
    made["trial"].command(1, Verb.TARE, READY, 0)
    made["disarming"].mode = Mode.HOLD
    made["disarming"].command(1, Verb.DISARM, READY, 0)
    return made


@pytest.mark.parametrize("name", sorted(machines()))
@given(verb=st.sampled_from(Verb), failed=st.sampled_from([0, CELL, DRIVE, HOST]), late=st.booleans())
def test_a_machine_answers_what_its_situation_says(name: str, verb: Verb, failed: int, late: bool) -> None:
    machine, t_ns = machines()[name], SUPERVISED_NS if late else 0
    machine.outcome()
    before = machine.mode, machine.sequence.pending, machine.sequence.trial, machine.sequence.disarming
    situation = machine.under_way(replace(READY, failed_checks=failed), t_ns)
    said = answer(machine.mode, verb, situation).refusal
    given_now = machine.command(2, verb, replace(READY, failed_checks=failed), t_ns)
    assert (given_now or Refusal.NONE) is said
    if said is not Refusal.NONE:
        assert (machine.mode, machine.sequence.pending, machine.sequence.trial, machine.sequence.disarming) == before
    after = machine.sequence.pending, machine.sequence.trial, machine.sequence.disarming
    ended = any(was and now != was for was, now in zip(before[1:], after, strict=True))
    answers = [answered.id for answered in machine.outcome().answers]
    assert 1 in answers or not ended, "what was under way is answered once it has given way"
