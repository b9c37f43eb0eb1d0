"""A drive that reads its controlword only every few milliseconds: every reset takes effect, every answer is true."""

from __future__ import annotations

import itertools

import pytest

from hil.lockstep import Lockstep
from rigctl.control.power.stage import DRIVE_RESET_NS
from rigctl.model.device_states import DriveState
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_frames import stop_node

OVERCURRENT = 0x2310
SLOWEST_MS = 16
STOPPED_S = 0.5
"""A motor at rest has closed its brake by then."""


def reads_every(rig: Lockstep, period_ms: int, phase_ms: int) -> None:
    """Have the drive act on one command in ``period_ms``, the first after ``phase_ms``."""
    ticks = itertools.count(-phase_ms)
    rig.rig.drive.rpdo_defect = lambda command: command if next(ticks) % period_ms == 0 else None


def state(rig: Lockstep) -> DriveState:
    return rig.rig.drive.control.state


def resets(rig: Lockstep) -> list[Fault]:
    """Faults that the events since the last call report as reset."""
    return [Fault(int(event["a"])) for event in rig.events.read() if event["kind"] == Kind.RESET]


@pytest.mark.parametrize("period_ms", range(1, SLOWEST_MS + 1))
@pytest.mark.starts_in(Mode.DISARMED)
def test_a_reset_takes_effect_whenever_the_drive_reads_its_controlword(rig: Lockstep, period_ms: int) -> None:
    for phase_ms in range(period_ms):
        rig.rig.drive.trip(OVERCURRENT)
        rig.run(0.02)
        assert state(rig) is DriveState.FAULT
        reads_every(rig, period_ms, phase_ms)
        assert rig.command(Verb.RESET) is Refusal.NONE
        assert state(rig) is not DriveState.FAULT, f"phase {phase_ms} ms"
        rig.rig.drive.rpdo_defect = None


EVERY_PHASE = [(period_ms, phase_ms) for period_ms in range(1, SLOWEST_MS + 1) for phase_ms in range(period_ms)]


@pytest.mark.gate("1-0-clears", "2-1-stays", "4-2-clears", "8-5-clears", "10-9-stays", "16-0-clears", "16-15-clears")
@pytest.mark.parametrize("clears", [True, False], ids=["clears", "stays"])
@pytest.mark.parametrize(("period_ms", "phase_ms"), EVERY_PHASE)
@pytest.mark.starts_in(Mode.HOLD)
def test_the_answer_to_a_reset_of_a_latched_fault_is_true_whenever_the_drive_reads_its_controlword(
    rig: Lockstep, monkeypatch: pytest.MonkeyPatch, period_ms: int, phase_ms: int, clears: bool
) -> None:
    rig.rig.drive.trip(OVERCURRENT)
    rig.run(STOPPED_S)
    fault = rig.loop.machine.fault
    assert fault is not Fault.NONE
    if not clears:
        monkeypatch.setattr(rig.rig.drive.control, "_clear_faults", lambda: False)
    reads_every(rig, period_ms, phase_ms)
    resets(rig)
    assert rig.command(Verb.RESET) is (Refusal.NONE if clears else Refusal.DRIVE_STATE)
    assert (state(rig) is DriveState.FAULT) is not clears
    assert rig.loop.machine.mode is (Mode.DISARMED if clears else Mode.FAULT)
    assert resets(rig) == ([fault] if clears else [])


@pytest.mark.starts_in(Mode.HOLD)
def test_a_fault_that_stays_in_the_drive_stays_latched_and_the_answer_says_so(
    rig: Lockstep, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.rig.drive.trip(OVERCURRENT)
    rig.run(STOPPED_S)
    monkeypatch.setattr(rig.rig.drive.control, "_clear_faults", lambda: False)
    resets(rig)
    began_ns = rig.clock.now()
    assert rig.command(Verb.RESET) is Refusal.DRIVE_STATE
    assert rig.clock.now() - began_ns == pytest.approx(DRIVE_RESET_NS, abs=5_000_000)
    assert DriveState(int(rig.reply["drive_state"])) is DriveState.FAULT is state(rig)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, Fault.DRIVE_FAULT)
    assert resets(rig) == []


@pytest.mark.parametrize("verb", [Verb.HOLD, Verb.DISARM])
@pytest.mark.starts_in(Mode.HOLD)
def test_hold_and_disarm_abort_a_reset(rig: Lockstep, verb: Verb) -> None:
    rig.rig.drive.trip(OVERCURRENT)
    rig.run(STOPPED_S)
    reads_every(rig, 10_000, 9_999)  # it reads no command for a while
    fault = rig.loop.machine.fault
    rig.give(Verb.RESET)
    rig.run(0.1)
    assert rig.command(verb) is Refusal.NONE
    rig.rig.drive.rpdo_defect = None
    rig.run(0.5)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, fault)
    assert state(rig) is DriveState.FAULT, "no word of the reset is sent any more"


@pytest.mark.starts_in(Mode.DISARMED)
def test_a_drive_that_does_not_follow_a_reset_while_disarmed_is_a_fault(
    rig: Lockstep, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.rig.drive.trip(OVERCURRENT)
    rig.run(0.02)
    monkeypatch.setattr(rig.rig.drive.control, "_clear_faults", lambda: False)
    rig.events.read()
    assert rig.command(Verb.RESET) is Refusal.DRIVE_STATE
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, Fault.DRIVE_FAULT)
    assert [Fault(int(event["a"])) for event in rig.events.read() if event["kind"] == Kind.TRIP] == [Fault.DRIVE_FAULT]
    monkeypatch.undo()
    assert rig.command(Verb.RESET) is Refusal.NONE
    assert (rig.loop.machine.mode, state(rig)) == (Mode.DISARMED, DriveState.SWITCH_ON_DISABLED)


@pytest.mark.starts_in(Mode.HOLD)
def test_a_cause_that_begins_during_a_reset_refuses_it(rig: Lockstep) -> None:
    rig.rig.drive.trip(OVERCURRENT)
    rig.run(STOPPED_S)
    reads_every(rig, 600, 500)  # it reads the reset after half a second
    fault = rig.loop.machine.fault
    reset = rig.give(Verb.RESET)
    rig.run(0.1)
    stop_node(rig, rig.settings.tension_cell.node)
    assert rig.answer(reset) is Refusal.CAUSE_PRESENT
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, fault)


@pytest.mark.starts_in(Mode.HOLD)
def test_a_second_disarm_leaves_the_first_as_it_is(rig: Lockstep) -> None:
    rig.rig.drive.trip(OVERCURRENT)
    rig.run(0.01)
    first, second = rig.give(Verb.DISARM), rig.give(Verb.DISARM)
    assert rig.answer(second) is Refusal.ALREADY
    assert rig.answer(first) is Refusal.NONE
    assert state(rig) is DriveState.FAULT
