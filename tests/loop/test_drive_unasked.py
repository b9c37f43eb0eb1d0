"""The drive under another master's control, its statusword, and the devices' heartbeats."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hil.lockstep import Lockstep
from hil.nodes.cylinder_drive import ServiceTool
from hil.nodes.power_stage import StagePhase
from hil.wire import FRAME
from rigctl.control.modes import command_slot
from rigctl.devices import objects
from rigctl.model.checks import Check
from rigctl.model.device_states import STATUSWORD, DriveState, NmtState
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Flag, Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_frames import latched

ARMED = (Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)
DEVICES = {2: "tension cell", 3: "inclinometer", 4: "cylinder drive"}
Enter = Callable[[Mode], None]


def trips(rig: Lockstep) -> list[str]:
    found = rig.events.read()
    return [
        worded(e["kind"], e["a"], e["b"], e["value"], e["limit"], e["text"].decode()).text
        for e in found
        if e["kind"] == Kind.TRIP
    ]


def status_bit(rig: Lockstep, bit: int, *, on: bool) -> None:
    rig.rig.drive.distort(STATUSWORD, 0, lambda raw: raw | bit if on else raw & ~bit)


# -- another master's drive --------------------------------------------------------------------------------------
def test_a_service_tool_that_drives_while_disarmed_trips_and_is_stopped(rig: Lockstep) -> None:
    rig.events.read()
    before_mm = rig.rig.truth.stroke_mm
    rig.rig.drive.take_over(ServiceTool(5.0))
    rig.run(0.3)
    assert latched(rig) == (Mode.FAULT, Fault.DRIVE_UNASKED, Action.POWER_OFF)
    assert rig.rig.drive.control.stage.phase is StagePhase.BRAKED
    assert abs(rig.rig.truth.stroke_mm - before_mm) < 0.3  # 20 ms of persistence at 5 mm/s, the lag and the ramp
    (said,) = trips(rig)
    assert "the drive has been enabled by somebody else" in said


def test_a_tool_that_only_enables_trips_too_and_nobody_resets_or_arms_while_it_is_there(rig: Lockstep) -> None:
    rig.rig.drive.take_over(ServiceTool(0.0))
    rig.run(0.3)
    assert rig.loop.machine.fault is Fault.DRIVE_UNASKED
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert rig.reply["cause"] == Fault.DRIVE_REFUSES  # stopped by now, but its remote bit is still off
    rig.rig.drive.take_over(None)
    rig.run(0.1)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(0.2)
    assert rig.command(Verb.ARM) is Refusal.NONE


def test_a_tool_that_comes_in_the_very_tick_of_arm_is_seen_before_it(rig: Lockstep) -> None:
    rig.rig.drive.take_over(ServiceTool(5.0, shows_remote=True))
    while not rig.record["flags"] & Flag.DRIVE_ENABLED:
        rig.loop.tick()
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert Check(int(rig.reply["checks"])) & Check.DRIVE_REFUSES


@pytest.mark.gate("2", "4")
@pytest.mark.parametrize("rig", ARMED, indirect=["rig"])
def test_our_own_drive_is_no_stranger(rig: Lockstep) -> None:
    """Arming, disarming and cancelling an arm: the loop has enabled the drive, or switches it off."""
    rig.command(Verb.HOLD)
    rig.run(0.1)
    assert rig.command(Verb.DISARM) is Refusal.NONE
    rig.run(1.5)
    assert rig.command(Verb.ARM) is Refusal.NONE
    rig.run(0.1)
    assert rig.loop.machine.fault is Fault.NONE


@pytest.mark.parametrize("ticks", [1, 3, 10, 40, 70])
def test_an_arm_that_is_called_off_leaves_no_stranger(rig: Lockstep, ticks: int) -> None:
    rig._commands.write(*command_slot(rig.clock.now(), 900, Verb.ARM, 0.0))
    for _ in range(ticks):
        rig.loop.tick()
    rig._commands.write(*command_slot(rig.clock.now(), 901, Verb.DISARM))
    rig.run(0.5)
    assert rig.loop.machine.fault is Fault.NONE


@pytest.mark.starts_in(Mode.HOLD)
def test_a_drive_that_stays_enabled_when_told_to_go_off_trips(rig: Lockstep) -> None:
    enabled = int(DriveState.OPERATION_ENABLED) | objects.STATUS_REMOTE | objects.STATUS_FOLLOWS
    rig.rig.drive.distort(STATUSWORD, 0, lambda _: enabled)
    id_ = rig.give(Verb.DISARM)
    rig.run(0.9)
    assert rig.loop.machine.fault is Fault.NONE
    rig.run(0.3)
    assert rig.loop.machine.fault is Fault.DRIVE_UNASKED
    assert rig.answer(id_) is Refusal.OFF_UNSEEN, "the answer states the effect that was seen, or that it was not"
    assert objects.drive_state(int(rig.reply["drive_state"])) is DriveState.OPERATION_ENABLED


# -- statusword --------------------------------------------------------------------------------------------------
BITS = [
    (objects.STATUS_REMOTE, False, 20, Action.HOLD),
    (objects.STATUS_INTERNAL_LIMIT, True, 100, Action.HOLD),
    (objects.STATUS_FOLLOWS, False, 20, Action.POWER_OFF),
]


@pytest.mark.parametrize(("bit", "on", "persistence_ms", "action"), BITS)
@pytest.mark.starts_in(Mode.HOLD)
def test_a_bit_of_the_statusword_trips_once_it_lasts(
    rig: Lockstep, bit: int, on: bool, persistence_ms: int, action: Action
) -> None:
    rig.events.read()
    status_bit(rig, bit, on=on)
    rig.run((persistence_ms - 1) * 1e-3)
    assert rig.loop.machine.fault is Fault.NONE
    rig.run(0.005)
    assert (rig.loop.machine.fault, rig.view.action) == (Fault.DRIVE_REFUSES, action)
    (said,) = trips(rig)
    assert "statusword bit" in said


@pytest.mark.parametrize(("bit", "on"), [(bit, on) for bit, on, _, _ in BITS[:2]])
def test_and_bars_arming(rig: Lockstep, bit: int, on: bool) -> None:
    status_bit(rig, bit, on=on)
    rig.run(0.05)
    assert rig.loop.machine.fault is Fault.NONE
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert Check(int(rig.reply["checks"])) == Check.DRIVE_REFUSES


def test_the_simulated_drive_sets_its_bits_as_cia_402_says(rig: Lockstep, enter: Enter) -> None:
    def bits() -> tuple[bool, bool, bool]:
        word = rig.loop.inbox.drive.statusword
        return tuple(  # type: ignore[return-value]
            bool(word & bit) for bit in (objects.STATUS_REMOTE, objects.STATUS_INTERNAL_LIMIT, objects.STATUS_FOLLOWS)
        )

    assert bits() == (True, False, False)  # not enabled: there is no target to follow
    enter(Mode.HOLD)
    assert bits() == (True, False, True)
    rig.rig.drive._set_mode(0)
    rig.run(0.003)
    assert bits() == (True, False, False)  # without a mode of operation the target velocity is not followed
    rig.rig.drive._set_mode(objects.CYCLIC_SYNCHRONOUS_VELOCITY)
    rig.run(0.003)
    assert rig.settings.simulation is not None
    rig.rig.drive._target = round(rig.settings.simulation.drive.speed_mm_s * 1000) + 1  # um/s
    assert rig.rig.drive._statusword() & objects.STATUS_INTERNAL_LIMIT


# -- heartbeats --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("node", DEVICES)
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_heartbeat_that_stops_while_samples_go_on_is_a_fault(rig: Lockstep, node: int) -> None:
    rig.events.read()
    gone = objects.HEARTBEAT_BASE + node
    rig.hub.tap = lambda _, frame: () if FRAME.unpack(frame)[0] == gone else (frame,)
    rig.run(0.39)
    assert rig.loop.machine.fault is Fault.NONE  # three lost in a burst are no fault
    rig.run(0.22)
    assert latched(rig) == (Mode.FAULT, Fault.NODE_NOT_OPERATIONAL, Action.HOLD)
    (said,) = trips(rig)
    assert f"{DEVICES[node]} (node {node}) has sent no heartbeat for 501 ms (limit 500 ms)" in said
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    rig.hub.tap = None
    rig.run(0.2)
    assert rig.command(Verb.RESET) is Refusal.NONE


@pytest.mark.parametrize("node", DEVICES)
@pytest.mark.starts_in(Mode.HOLD)
def test_a_heartbeat_that_says_pre_operational_is_a_fault_at_once(rig: Lockstep, node: int) -> None:
    rig.events.read()
    rig.inject(FRAME.pack(objects.HEARTBEAT_BASE + node, 1, bytes([NmtState.PRE_OPERATIONAL])))
    rig.run(0.005)
    assert rig.loop.machine.fault is Fault.NODE_NOT_OPERATIONAL
    (said,) = trips(rig)
    assert f"{DEVICES[node]} (node {node}) is pre-operational" in said


@pytest.mark.parametrize("node", DEVICES)
def test_without_a_heartbeat_nobody_arms(rig: Lockstep, node: int) -> None:
    gone = objects.HEARTBEAT_BASE + node
    rig.hub.tap = lambda _, frame: () if FRAME.unpack(frame)[0] == gone else (frame,)
    rig.run(0.6)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert Check(int(rig.reply["checks"])) == Check.NODE_NOT_OPERATIONAL
