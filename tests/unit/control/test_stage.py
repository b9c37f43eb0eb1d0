"""The machine of drive, brake and load: each row of its tables, and what holds after any inputs."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.control.commands.situation import Situation
from rigctl.control.power import stage
from rigctl.control.power.arming import ArmingStep
from rigctl.control.power.stage import (
    ARM_LIMIT_NS,
    CUT_AFTER_NS,
    DRIVE_RESET_NS,
    KEPT_NS,
    ROWS,
    STAGES,
    STEPS,
    Accepted,
    DriveStage,
    Input,
    Sequence,
    TickSeen,
    after,
    decide,
    held_by,
    power,
)
from rigctl.control.watch.safety import Trip
from rigctl.devices.drive import Power
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import HeldBy, Mode
from rigctl.model.verbs import OFF_LIMIT_NS, Refusal, Verb
from tests.builders.outcomes import MachineLog
from tests.builders.paths import ROOT

READY = Situation(carry_s=60.0)
CARRY = Accepted(7, Verb.CARRY, carry_ns=60_000_000_000)
BASES = [one for one in DriveStage if one not in STEPS]
"""The stages in which no command waits."""


TENSION = Accepted(7, Verb.TENSION)


def waiting(step: DriveStage, *, command: Accepted = TENSION, until_ns: int = 100) -> Sequence:
    return Sequence(step=step, command=command, until_ns=until_ns)


PREPARE, ENABLE, RESET = (waiting(step) for step in STEPS)
RUN = Sequence(base=DriveStage.RUN)
CARRIED = replace(RUN, carry_until_ns=100)
CASES = (
    (PREPARE, TickSeen(0, prepared=ArmingStep.SLIPPED)),
    (PREPARE, TickSeen(0, prepared=ArmingStep.LATE)),
    (PREPARE, TickSeen(0, prepared=ArmingStep.READY)),
    (RESET, TickSeen(0, cause=True)),
    (RESET, TickSeen(0)),
    (RESET, TickSeen(100, faulted=True)),
    (ENABLE, TickSeen(200, enabled=True)),
    (waiting(DriveStage.ENABLE, command=CARRY, until_ns=ARM_LIMIT_NS), TickSeen(DRIVE_RESET_NS, faulted=True)),
    (ENABLE, TickSeen(100, latched=True)),
    (ENABLE, TickSeen(100)),
    (CARRIED, TickSeen(100, gone=True)),
    (CARRIED, TickSeen(100)),
    (RUN, TickSeen(100, True, due=True, fails=True)),
    (RUN, TickSeen(100, due=True)),
    (RUN, TickSeen(100, ended=True)),
)
"""For each row a wait that it alone ends."""


@pytest.mark.parametrize("number", range(len(ROWS)))
def test_a_wait_is_ended_by_its_row_and_by_no_other(number: int) -> None:
    at, seen = CASES[number]
    assert decide(at, seen) is ROWS[number]


@pytest.mark.parametrize(
    ("at", "seen"),
    [
        (PREPARE, TickSeen(100)), (RESET, TickSeen(99, faulted=True)), (ENABLE, TickSeen(99, faulted=True)),
        (waiting(DriveStage.ENABLE, command=CARRY, until_ns=ARM_LIMIT_NS), TickSeen(DRIVE_RESET_NS - 1, faulted=True)),
        (Sequence(), TickSeen(100, enabled=True)), (CARRIED, TickSeen(99)), (RUN, TickSeen(0)),
        (Sequence(), TickSeen(100, due=True, ended=True, gone=True)),
    ],
)  # fmt: skip
def test_a_wait_goes_on_until_then(at: Sequence, seen: TickSeen) -> None:
    assert decide(at, seen) is None


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.stage.name} {row.words[:30]}")
def test_each_row_names_the_test_that_fails_without_it(row: stage.StageRow) -> None:
    files = pathlib.Path(ROOT / "tests/unit/control").glob("test_*.py")
    assert any(f"def {row.test}(" in file.read_text() for file in files)


def parked() -> MachineLog:
    machine = MachineLog()
    machine.command(1, Verb.ARM, READY, 0)
    machine.follow_drive(True, 1)
    machine.park()
    machine.answers.clear()
    return machine


def test_a_brake_that_slips_in_its_test_refuses_the_command() -> None:
    machine = MachineLog()
    machine.command(1, Verb.ARM, READY, 0)
    assert machine.follow(TickSeen(1, prepared=ArmingStep.SLIPPED)) is stage.SLIPPED
    assert [answer.refusal for answer in machine.answers] == [Refusal.BRAKE_SLIPPED]
    assert machine.power(2, drive_enabled=False, drive_faulted=False) is Power.OFF


@pytest.mark.parametrize("seen", [TickSeen(1, barred=True), TickSeen(1, prepared=ArmingStep.LATE)])
def test_a_check_that_fails_while_a_command_is_prepared_refuses_it(seen: TickSeen) -> None:
    machine = parked()
    machine.command(2, Verb.TENSION, READY, 0)
    machine.follow(seen)
    assert [answer.refusal for answer in machine.answers] == [Refusal.PREFLIGHT]
    assert machine.sequence.stage is DriveStage.STOP


def test_a_prepared_command_has_the_drive_enabled() -> None:
    machine = parked()
    machine.command(2, Verb.TENSION, READY, 0)
    machine.prepared(5)
    assert machine.power(6, drive_enabled=False, drive_faulted=False) is Power.ON
    machine.follow_drive(False, 5 + ARM_LIMIT_NS - 1)
    assert machine.answers == []
    machine.follow_drive(False, 5 + ARM_LIMIT_NS)
    assert [answer.refusal for answer in machine.answers] == [Refusal.DRIVE_TIMEOUT]


def test_a_cause_that_begins_meanwhile_ends_a_reset() -> None:
    machine = MachineLog()
    machine.trip(Trip(Fault.CELL_STALE, 1.0, 0.5), 0)
    machine.command(1, Verb.RESET, Situation(drive_faulted=True), 0)
    machine.follow_drive(False, 1, drive_faulted=True, cause_present=True)
    assert [answer.refusal for answer in machine.answers] == [Refusal.CAUSE_PRESENT]
    assert machine.fault is Fault.CELL_STALE


def test_a_carry_whose_drive_stays_in_its_fault_is_refused() -> None:
    machine = parked()
    machine.trip(Trip(Fault.STROKE_MOVES, 0.3, 0.2, Action.POWER_OFF), 10)
    machine.command(3, Verb.CARRY, READY, 20)
    machine.prepared(21)
    assert machine.power(22, drive_enabled=False, drive_faulted=True) in (Power.RESET, Power.RESET_LOW)
    machine.follow_drive(False, 21 + DRIVE_RESET_NS, drive_faulted=True)
    assert [answer.refusal for answer in machine.answers] == [Refusal.DRIVE_STATE]


def carried() -> MachineLog:
    machine = parked()
    machine.trip(Trip(Fault.STROKE_MOVES, 0.3, 0.2, Action.POWER_OFF), 10)
    machine.command(3, Verb.CARRY, READY, 20)
    machine.prepared(21)
    machine.follow_drive(True, 30)
    return machine


def test_a_carry_ends_on_the_brake_or_by_lowering() -> None:
    machine, until_ns = carried(), 30 + 60_000_000_000
    assert machine.follow(TickSeen(until_ns - 1)) is None
    machine.follow(TickSeen(until_ns))
    assert (machine.mode, machine.sequence.stage) == (Mode.RELEASING, DriveStage.RUN)
    machine = carried()
    machine.follow(TickSeen(40, gone=True))
    assert (machine.mode, machine.sequence.stage) == (Mode.FAULT, DriveStage.STOP)
    assert machine.sequence.carry_until_ns == 0


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.FAULT])
def test_a_load_is_not_given_to_a_brake_that_is_known_not_to_hold(mode: Mode) -> None:
    machine = MachineLog()
    machine.command(1, Verb.ARM, READY, 0)
    machine.follow_drive(True, 1)
    if mode is Mode.FAULT:
        machine.trip(Trip(Fault.CELL_STALE, 20.0, 15.0), 1)
    assert machine.follow(TickSeen(2, enabled=True, due=True, fails=True)) is stage.KEPT
    assert (machine.mode, machine.sequence.stage) == (mode, DriveStage.RUN)
    assert machine.follow(TickSeen(1 + KEPT_NS)) is None
    machine.follow(TickSeen(2 + KEPT_NS))
    assert machine.mode is Mode.RELEASING
    assert (machine.sequence.carry_until_ns > 0) is (mode is Mode.FAULT), "a ramp from HOLD is no carrying"


def test_a_drive_that_went_off_cannot_keep_the_load() -> None:
    machine = MachineLog()
    machine.command(1, Verb.ARM, READY, 0)
    machine.follow_drive(True, 1)
    machine.follow(TickSeen(2, enabled=False, due=True, fails=True))
    assert machine.sequence.stage is DriveStage.STOP


@pytest.mark.parametrize("enabled", [True, False])
def test_a_load_whose_hold_is_due_is_parked_and_a_drive_that_went_off_is_armed_again(enabled: bool) -> None:
    machine = MachineLog()
    machine.command(1, Verb.ARM, READY, 0)
    machine.follow_drive(True, 1)
    machine.follow(TickSeen(2, enabled, due=True))
    assert (machine.mode, machine.sequence.stage, machine.sequence.armed) == (Mode.HOLD, DriveStage.STOP, enabled)


def test_a_process_that_ends_leaves_the_load_on_the_brake() -> None:
    machine = MachineLog()
    machine.command(1, Verb.ARM, READY, 0)
    machine.follow_drive(True, 1)
    machine.stop(50)
    assert machine.sequence.stage is DriveStage.RUN
    machine.follow(TickSeen(2, ended=True))
    assert machine.sequence.stage is DriveStage.STOP


@pytest.mark.parametrize("base", BASES)
def test_a_step_leads_back_to_the_stage_before_it(base: DriveStage) -> None:
    for input_, step in ((Input.NEEDED, DriveStage.PREPARE), (Input.DRIVE_RESET, DriveStage.RESET)):
        at = after(Sequence(base=base), input_, 0, command=CARRY)
        assert at.stage is (step if (base, input_) in STAGES else base)
        assert after(at, Input.WITHDRAWN, 1).stage is base


@pytest.mark.parametrize("step", [DriveStage.PREPARE, DriveStage.RESET])
def test_the_power_is_cut_in_its_time_while_a_command_waits(step: DriveStage) -> None:
    at = Sequence(base=DriveStage.QUICK, step=step, command=CARRY, action=Action.POWER_OFF, cut_ns=CUT_AFTER_NS)
    at, wanted = power(at, CUT_AFTER_NS - 1, drive_enabled=True, drive_faulted=False)
    assert (wanted, at.base, at.stage) == (Power.QUICK_STOP, DriveStage.QUICK, step)
    at, wanted = power(at, CUT_AFTER_NS, drive_enabled=True, drive_faulted=False)
    assert (wanted, at.base, at.stage) == (Power.CUT, DriveStage.CUT, step)


@pytest.mark.parametrize("base", BASES)
def test_a_drive_is_seen_off_where_it_is_to_be_off(base: DriveStage) -> None:
    off = after(Sequence(base=base), Input.SEEN_OFF, 0)
    assert off.off is (base in (DriveStage.STOP, DriveStage.OFF))
    assert after(off, Input.SEEN_ON, 0).stage is (DriveStage.STOP if off.off else base)


def test_a_disarm_is_answered_in_any_stage() -> None:
    for trip in (None, Action.QUICK_STOP, Action.SILENCE):
        machine = parked()
        if trip is not None:
            machine.trip(Trip(Fault.LIMIT, 1.0, 0.0, trip), 1)
        machine.answers.clear()
        machine.command(2, Verb.DISARM, READY, 2)
        machine.follow_off(2 + OFF_LIMIT_NS - 1, off=False)
        assert machine.answers == []
        machine.follow_off(2 + OFF_LIMIT_NS, off=False)
        assert [(answer.id, answer.refusal) for answer in machine.answers] == [(2, Refusal.OFF_UNSEEN)]


@given(st.lists(st.tuples(st.sampled_from(Input), st.integers(0, 10**9))))
def test_whatever_comes_a_silence_stays_and_only_enable_leads_to_run(inputs: list[tuple[Input, int]]) -> None:
    at = Sequence()
    for input_, t_ns in inputs:
        before, at = at, after(at, input_, t_ns)
        assert at.base not in STEPS
        assert at.step is None or at.step in STEPS
        assert at.base is DriveStage.SILENT or before.base is not DriveStage.SILENT
        if at.motor and not before.motor:
            assert before.stage is DriveStage.ENABLE
        if at.taking and not before.taking:
            assert before.stage in (DriveStage.PREPARE, DriveStage.OFF, DriveStage.STOP)
            assert at.base in (DriveStage.OFF, DriveStage.STOP)
            assert at.action is Action.HOLD


def test_a_sequence_has_no_more_than_twelve_fields_of_its_own() -> None:
    own = [name for name, one in Sequence.__dataclass_fields__.items() if one.init]
    assert len(own) <= 12


def test_a_sequence_is_not_changed_in_place() -> None:
    with pytest.raises(AttributeError):
        Sequence().base = DriveStage.RUN  # type: ignore[misc]
    assert replace(Sequence(), base=DriveStage.RUN).motor


@pytest.mark.parametrize(
    ("known", "braked", "rests", "settles", "by"),
    [
        (True, True, True, False, HeldBy.BRAKE), (True, True, False, True, HeldBy.CLOSING),
        (True, True, False, False, HeldBy.UNKNOWN), (True, False, True, True, HeldBy.CLOSING),
        (False, True, True, False, HeldBy.UNKNOWN),
    ],
)  # fmt: skip
def test_the_brake_holds_a_load_that_is_at_rest_with_the_drive_off(
    known: bool, braked: bool, rests: bool, settles: bool, by: HeldBy
) -> None:
    found = held_by(Sequence(), Mode.HOLD, known=known, enabled=False, braked=braked, rests=rests, settles=settles)
    assert found is by
