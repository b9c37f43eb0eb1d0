"""Device settings that safety depends on stay as start-up wrote them: watched, read back at every arm and sampled."""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable

import can
import pytest

from hil.faults import on_bus
from hil.faults.stand import Stand
from hil.hub import Port
from hil.lockstep import Lockstep
from hil.nodes.power_stage import StagePhase
from hil.wire import FRAME
from rigctl.config.settings import RigSettings
from rigctl.devices import busload, sdo
from rigctl.devices import objects as od
from rigctl.model.checks import Check
from rigctl.model.events import worded
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

Enter = Callable[[Mode], None]
WRITES = (  # objects of the drive's supervision: index, sub-index, size
    (od.CONSUMER_HEARTBEAT, 1, 4),
    (od.RPDO1_COMMUNICATION, 5, 2),
    (od.ABORT_CONNECTION_OPTION, 0, 2),
    (od.QUICK_STOP_OPTION, 0, 2),
    (od.FAULT_REACTION_OPTION, 0, 2),
)


def write(rig: Lockstep, index: int, sub: int, size: int, value: int = 0) -> None:
    """Another master's expedited download to the drive."""
    data = struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, sub, value)
    rig.inject(FRAME.pack(od.SDO_RX_BASE + rig.rig.drive.id, 8, data))


def set_unheard(rig: Lockstep, index: int, sub: int = 0, value: int = 0) -> None:
    """Write through the drive's own service connection: no frame on the bus."""
    entry = rig.rig.drive.device.sdo[index]
    (entry[sub] if sub else entry).raw = value


def rotation_s(rig: Lockstep) -> float:
    return rig.loop.readback.size * sdo.every_ticks(rig.settings) / rig.settings.loop.rate_hz


def said(rig: Lockstep) -> list[str]:
    found = []
    for event in rig.events.read():
        kind, a, b, value, limit, text = (event[n].item() for n in ("kind", "a", "b", "value", "limit", "text"))
        found.append(worded(kind, a, b, value, limit, text.decode()).text)
    return found


@pytest.mark.gate("4118-1-4", "24583-0-2")
@pytest.mark.parametrize(("index", "sub", "size"), WRITES)
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_another_masters_write_is_a_rival_and_named_with_its_value(
    rig: Lockstep, index: int, sub: int, size: int
) -> None:
    said(rig)
    write(rig, index, sub, size)
    rig.run(0.003)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, Fault.RIVAL)
    words = f"writes node 4 0x{index:04X}:{sub:02X} = 0"
    told = said(rig)
    assert f"another master {words}: find it and stop it" in told
    assert any(text.startswith(f"trip RIVAL: another controller {words}") for text in told)


@pytest.mark.gate("5120-5-2")
@pytest.mark.parametrize(("index", "sub", "size"), WRITES)
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_what_it_wrote_keeps_the_fault_and_refuses_the_next_arm(rig: Lockstep, index: int, sub: int, size: int) -> None:
    write(rig, index, sub, size)
    rig.run(1.0)
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert rig.reply["cause"] == Fault.SUPERVISION_LOST
    (lost,) = rig.loop.readback.lost.values()
    assert (lost.item.index, lost.item.sub, lost.found) == (index, sub, 0)


def test_a_write_while_disarmed_is_told_and_refuses_the_arm_by_what_is_read_back(rig: Lockstep) -> None:
    write(rig, od.QUICK_STOP_OPTION, 0, 2)
    rig.run(0.01)
    assert "another master writes node 4 0x605A:00 = 0: find it and stop it" in said(rig)
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert rig.reply["checks"] == Check.RIVAL
    rig.run(1.0)
    for _ in range(2):
        assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
        assert rig.reply["checks"] == Check.DRIVE_SUPERVISION
        assert "a device's setting is lost: node 4 0x605A:00 quick stop option: found 0, wanted 2" in said(rig)
    write(rig, od.QUICK_STOP_OPTION, 0, 2, 2)
    rig.run(1.0)
    assert rig.command(Verb.ARM) is Refusal.NONE


@pytest.mark.starts_in(Mode.HOLD)
def test_a_change_that_nobody_heard_is_found_within_a_rotation(rig: Lockstep) -> None:
    for index, sub, _ in WRITES:
        assert rig.loop.machine.mode is Mode.HOLD
        held = rig.rig.drive.device.sdo[index][sub].raw if sub else rig.rig.drive.device.sdo[index].raw
        set_unheard(rig, index, sub)
        rig.run(rotation_s(rig) + 0.02)
        assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, Fault.SUPERVISION_LOST)
        rig.run(1.5)
        assert rig.rig.drive.control.stage.phase is StagePhase.BRAKED, "unsupervised, it is not held under power"
        assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
        set_unheard(rig, index, sub, held)
        rig.run(rotation_s(rig) + 0.02)
        assert rig.command(Verb.RESET) is Refusal.NONE
        if rig.loop.machine.mode is Mode.DISARMED:
            rig.run(0.3)
            assert rig.command(Verb.ARM) is Refusal.NONE


@pytest.mark.parametrize(("index", "sub", "value"), [(od.MODE_OF_OPERATION, 0, 0), (od.RPDO1_COMMUNICATION, 2, 0)])
@pytest.mark.starts_in(Mode.HOLD)
def test_a_drive_that_does_not_take_commands_as_it_should_loses_its_power(
    rig: Lockstep, index: int, sub: int, value: int
) -> None:
    set_unheard(rig, index, sub, value)
    rig.run(rotation_s(rig) + 0.5)
    # A drive that leaves cyclic synchronous velocity shows it itself (statusword bit 12) before it is read back.
    assert rig.loop.machine.fault in (Fault.SUPERVISION_LOST, Fault.DRIVE_REFUSES)
    assert rig.view.action is Action.POWER_OFF
    assert not rig.rig.drive.control.enabled


@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_drive_whose_quick_stop_was_changed_is_stopped_by_commands(rig: Lockstep) -> None:
    """The ramp of the set-point moves the stroke at 8 mm/s; the quick stop's own ramp would take 34 mm."""
    assert rig.command(Verb.TARGET, 220.0) is Refusal.NONE
    rig.run(0.3)
    set_unheard(rig, od.QUICK_STOP_DECELERATION, value=1_000)
    for _ in range(round((rotation_s(rig) + 0.02) * rig.settings.loop.rate_hz)):
        rig.tick()
        if rig.loop.machine.mode is Mode.FAULT:
            break
    assert rig.loop.machine.fault is Fault.SUPERVISION_LOST
    before_mm = rig.rig.truth.stroke_mm
    rig.run(1.0)
    assert rig.view.action is Action.HOLD
    assert abs(rig.rig.truth.stroke_mm - before_mm) < 0.6


def test_every_object_that_start_up_verified_is_watched_in_every_device(rig: Lockstep) -> None:
    watched = {(item.node, item.index, item.sub) for item in rig.report.watched}
    assert {(4, index, sub) for index, sub, _ in WRITES} <= watched
    assert {(4, od.MODE_OF_OPERATION, 0), (4, od.MODE_DISPLAY, 0), (4, od.RPDO1_COMMUNICATION, 1)} <= watched
    assert {(node, od.TPDO1_MAPPING, sub) for node in (2, 3, 4) for sub in (0, 1, 2)} <= watched
    assert {node for node, _, _ in watched} == set(rig.settings.canopen_nodes.values())


def test_a_server_that_stops_answering_is_lost_armed_and_refuses_an_arm(rig: Lockstep, enter: Enter) -> None:
    answers_lost = on_bus.silent(on_bus.drive, od.SDO_TX_BASE)
    answers_lost(Stand(rig, "silent"))
    assert rig.command(Verb.ARM) is Refusal.PREFLIGHT
    assert "a device's setting is lost: node 4 0x60A8:00 SI unit position: no answer to 3 requests" in said(rig)[-1]
    rig.hub.tap = None
    enter(Mode.HOLD)
    answers_lost(Stand(rig, "silent"))
    rig.run(2.0)
    assert (rig.loop.machine.fault, rig.view.action) == (Fault.SUPERVISION_LOST, Action.HOLD)


@pytest.mark.starts_in(Mode.HOLD)
def test_lost_and_doubled_answers_are_asked_for_again_and_are_nobody_elses(rig: Lockstep) -> None:
    answers = [0]

    def tap(_: object, frame: bytes) -> tuple[bytes, ...]:
        if int.from_bytes(frame[:2], "little") & 0x780 != od.SDO_TX_BASE:
            return (frame,)
        answers[0] += 1
        return () if answers[0] % 5 == 0 else (frame, frame)

    rig.hub.tap = tap
    rig.run(3.0)
    assert rig.loop.machine.mode is Mode.HOLD
    assert not rig.loop.readback.lost


def test_a_disarmed_rig_leaves_the_devices_sdo_channel_to_a_tool(rig: Lockstep) -> None:
    read = rig.loop.readback.read
    rig.run(1.0)
    assert rig.loop.readback.read == read


def test_disarm_ends_an_arm_that_waits_for_the_read_back(rig: Lockstep) -> None:
    with pytest.raises(TimeoutError):
        rig.command(Verb.ARM, limit_s=0.1)
    assert rig.command(Verb.ARM) is Refusal.ALREADY
    assert rig.command(Verb.TARE) is Refusal.WRONG_MODE
    assert rig.command(Verb.DISARM) is Refusal.NONE
    rig.run(1.0)
    assert rig.loop.machine.mode is Mode.DISARMED
    assert not rig.rig.drive.control.enabled


def test_a_trip_while_it_waits_ends_the_arm(rig: Lockstep) -> None:
    with pytest.raises(TimeoutError):
        rig.command(Verb.ARM, limit_s=0.1)
    rig.rig.drive.press_e_stop(True)
    rig.run(1.0)
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, Fault.E_STOP)
    rig.rig.drive.press_e_stop(False)
    rig.run(0.3)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(1.0)
    assert rig.loop.machine.mode is Mode.DISARMED, "the arm of before is over"


@pytest.mark.starts_in(Mode.HOLD)
def test_no_more_than_one_request_in_ten_ticks_and_the_bus_load_says_so(rig: Lockstep) -> None:
    read = rig.loop.readback.read
    rig.run(1.0)
    assert rig.loop.readback.read - read == pytest.approx(100, abs=1)
    (rate,) = {item.rate_hz for item in busload.traffic(rig.settings) if item.name.startswith("settings read back")}
    assert rate == 100.0


def test_a_slow_loop_asks_less_often(settings: RigSettings) -> None:
    slow = settings.model_copy(update={"loop": settings.loop.model_copy(update={"rate_hz": 100})})
    assert sdo.every_ticks(slow) == 4


@pytest.mark.starts_in(Mode.TENSIONING)
def test_the_load_is_held_when_the_loop_dies_after_such_a_write(rig: Lockstep) -> None:
    """Without supervision the drive would have gone on for 70 mm."""
    for index, sub, size in WRITES:
        write(rig, index, sub, size)
    rig.run(0.1)
    before_mm = rig.rig.truth.stroke_mm
    for _ in range(3000):  # the loop is dead: no frame is sent any more
        rig.clock.skip = 1
        rig.clock.next_tick()
    assert rig.rig.truth.stroke_mm == pytest.approx(before_mm, abs=1.0)


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.DISARMED])
def test_a_request_that_could_not_be_sent_is_no_silent_device(rig: Lockstep, enter: Enter, mode: Mode) -> None:
    """The send queue is full of other frames for seconds: the settings are read once there is room again."""
    enter(mode)
    read = rig.loop.readback.read

    def full(_sender: Port, frame: bytes) -> list[bytes]:
        if FRAME.unpack(frame)[0] & ~0x7F == od.SDO_RX_BASE:
            raise can.CanOperationError("send queue full", errno.ENOBUFS)
        return [frame]

    rig.hub.tap = full
    rig.run(3.0)
    assert rig.loop.machine.mode is mode
    assert not rig.loop.readback.lost
    rig.hub.tap = None
    if mode is Mode.DISARMED:
        assert rig.command(Verb.ARM) is Refusal.NONE
    rig.run(rotation_s(rig) + 0.1)
    assert rig.loop.machine.mode is Mode.HOLD
    assert rig.loop.readback.read >= read + rig.loop.readback.size
