"""The drive as a start finds it: in every powered state it is off, or the start names it, and nothing runs on.

The judge is the plant's truth: how far the stroke has moved, and whether the motor is powered.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from hil.hub import Port
from hil.lockstep import Lockstep, lockstep
from hil.nodes.cylinder_drive import CylinderDrive
from hil.nodes.dictionary import Abort, refuse
from hil.nodes.node import Node
from hil.nodes.power_stage import StagePhase
from hil.wire import FRAME
from rigctl.config.io_section import IoSettings
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.control.power.machine import SUPERVISED_NS
from rigctl.devices import objects as od
from rigctl.devices.objects import drive_state
from rigctl.devices.remote_node import StartupError
from rigctl.model.checks import Check
from rigctl.model.device_states import STATUSWORD, DriveState, NmtState
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.states import HeldBy, Mode
from rigctl.model.verbs import Refusal, Verb
from tests.builders.loop_frames import nmt, stop_node
from tests.builders.rig_on_hub import RigOnHub

SPEED_MM_S = 5.0
NOT_POWERED = (DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON, DriveState.FAULT)
WORST_MM = 1.0
OFF_S = 2.0
SUPERVISED_S = SUPERVISED_NS * 1e-9
"""After a silence a reset is accepted so much later."""
NO_EFFECT = [
    ": no boot-up message after two commands to reset communication",
    " reports error register 0x11: generic, communication, error 0x8250, RPDO timeout, also after reset communication",
]
READ_STATUSWORD = bytes([0x40, 0x41, 0x60, 0])
Left = Callable[[RigOnHub], None]


class Found(RigOnHub):
    """A rig as a controller that has crashed may have left it; ``sent`` has every frame that the start sends."""

    def __init__(self, settings: RigSettings) -> None:
        self.sent: list[tuple[int, bytes]] = []
        super().__init__(settings)
        self.rig.drive.network.notify(od.NMT_COB, bytes([0x01, settings.cylinder.node]), 0.0)
        self.sent.clear()

    def take(self, frame: bytes) -> None:
        can_id, size, data = FRAME.unpack(frame)
        self.sent.append((can_id, data[:size]))
        super().take(frame)

    def nmt(self) -> list[int]:
        """NMT commands to the drive, in order."""
        return [data[0] for can_id, data in self.sent if can_id == od.NMT_COB and data[1] in (0, self.rig.drive.id)]


def drives(rig: RigOnHub, speed_mm_s: float = 0.0) -> CylinderDrive:
    """Have the motor on, at a speed, the supervision of its controller off."""
    drive = rig.rig.drive
    drive.device.set_data(od.ABORT_CONNECTION_OPTION, 0, bytes(2))
    rig._pass_time(lambda: False, 0.05)
    drive.control.enable_locally(rig.t_ns)
    rig._pass_time(lambda: drive.control.state is DriveState.OPERATION_ENABLED, 1.0)
    assert drive.control.state is DriveState.OPERATION_ENABLED
    drive.control.stage.follow(speed_mm_s)
    drive._drive()
    return drive


def enabled_and_moving(rig: RigOnHub) -> None:
    drives(rig, SPEED_MM_S)


def enabled_at_rest_with_a_target(rig: RigOnHub) -> None:
    drives(rig)._target = 20_000


def in_a_quick_stop_that_stays(rig: RigOnHub) -> None:
    drive = drives(rig)
    drive.device.set_data(od.QUICK_STOP_OPTION, 0, (6).to_bytes(2, "little"))
    drive.control.obey(od.Controlword.QUICK_STOP, rig.t_ns, may_enable=False)
    rig._pass_time(lambda: False, 0.3)
    assert drive.control.state is DriveState.QUICK_STOP_ACTIVE


def switched_on_with_the_motor_carrying(rig: RigOnHub) -> None:
    drives(rig).control.state = DriveState.SWITCHED_ON


def in_a_fault_reaction(rig: RigOnHub) -> None:
    drives(rig, SPEED_MM_S).trip(0x2310)


def whose_stop_ends_in(state: DriveState) -> Left:
    def left(rig: RigOnHub) -> None:
        drives(rig, SPEED_MM_S).control.persists = state

    left.__name__ = f"whose_stop_ends_in_{state.name}"
    return left


PERSISTENT = (DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE)
WAYS_IN: tuple[Left, ...] = (
    enabled_and_moving, enabled_at_rest_with_a_target, in_a_quick_stop_that_stays,
    switched_on_with_the_motor_carrying, in_a_fault_reaction, *map(whose_stop_ends_in, PERSISTENT),
)  # fmt: skip


@pytest.mark.parametrize("left", WAYS_IN, ids=lambda left: left.__name__)
@pytest.mark.parametrize("operational", [True, False], ids=["operational", "pre-operational"])
def test_a_drive_that_is_found_powered_is_off_before_it_is_configured(
    settings: RigSettings, left: Left, operational: bool
) -> None:
    found = Found(settings)
    left(found)
    drive = found.rig.drive
    if not operational:
        drive._enter(NmtState.PRE_OPERATIONAL)
    before_mm, found.sent[:] = found.rig.truth.stroke_mm, []
    started, target = drive.control.state, drive._target
    report = found.bring_up()
    named = [item for item in report.found if item.object_index == STATUSWORD]
    assert [item.value for item in named] == ([started] if left is not in_a_fault_reaction else [])
    assert all(DriveState(item.left) in NOT_POWERED for item in named)
    assert [item for item in report.found if item.object_index == od.TARGET_VELOCITY] == (
        [(od.TARGET_VELOCITY, target, 0)] if target else []
    )
    assert drive.control.state in NOT_POWERED
    assert drive.control.stage.phase is StagePhase.BRAKED
    assert abs(found.rig.truth.stroke_mm - before_mm) < WORST_MM
    assert (drive._target, drive._offset) == (0, 0)
    assert found.sent[0] == (od.SDO_RX_BASE + drive.id, READ_STATUSWORD.ljust(8, b"\0")), "read before all else"
    stays_mm = found.rig.truth.stroke_mm
    found._pass_time(lambda: False, 2.0)
    assert found.rig.truth.stroke_mm == stays_mm


def arms(rig: Lockstep) -> None:
    """Arm a rig that is DISARMED, whose drive may have missed the commands of a loop that has ended."""
    if od.drive_state(int(rig.record["statusword"])) in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
        assert rig.command(Verb.RESET) is Refusal.NONE
    if rig.loop.machine.mode is Mode.DISARMED:
        assert rig.command(Verb.ARM) is Refusal.NONE


def until_off(rig: Lockstep) -> None:
    """Until the loop has the drive switch off."""
    for _ in range(20_000):
        if not rig.view.drive_wanted:
            return
        rig.tick()
    raise TimeoutError


def disarmed(rig: Lockstep) -> None:
    assert rig.command(Verb.HOLD) is Refusal.NONE
    rig.give(Verb.DISARM)


def parked(rig: Lockstep) -> None:
    assert rig.command(Verb.HOLD) is Refusal.NONE
    until_off(rig)


def tripped(rig: Lockstep) -> None:
    stop_node(rig, rig.settings.tension_cell.node)
    until_off(rig)


@pytest.mark.gate("disarmed-SWITCHED_ON", "parked-QUICK_STOP_ACTIVE", "tripped-OPERATION_ENABLED")
@pytest.mark.parametrize("state", PERSISTENT, ids=lambda state: state.name)
@pytest.mark.parametrize("way", [disarmed, parked, tripped], ids=lambda way: way.__name__)
@pytest.mark.starts_in(Mode.COMPENSATING)
def test_a_powered_state_in_which_a_stop_ends_is_left_within_two_seconds(
    rig: Lockstep, way: Callable[[Lockstep], None], state: DriveState
) -> None:
    """The motor carries 300 N meanwhile; what the fault's remedy names brings the rig back."""
    drive = rig.rig.drive
    drive.control.persists = state
    way(rig)
    before_mm = rig.rig.truth.stroke_mm
    records = rig.run(OFF_S)
    assert drive.control.stage.phase is StagePhase.BRAKED
    assert abs(rig.rig.truth.stroke_mm - before_mm) < WORST_MM
    fault = Fault.CELL_STALE if way is tripped else Fault.DRIVE_UNASKED
    assert (rig.loop.machine.mode, rig.loop.machine.fault) == (Mode.FAULT, fault)
    in_state = [drive_state(int(word)) is state for word in records["statusword"]]
    assert any(in_state)
    assert not (records["held_by"][in_state] == HeldBy.BRAKE).any(), "it is not called off while it is not"
    drive.control.persists = None
    rig.rig.receive(nmt(od.NMT_START, rig.settings.tension_cell.node))
    rig.run(SUPERVISED_S)
    assert rig.command(Verb.RESET) is Refusal.NONE
    rig.run(1.0)
    arms(rig)
    assert rig.command(Verb.TENSION) is Refusal.NONE


def refuses(_controlword: int) -> None:
    raise refuse(Abort.VALUE_RANGE)


def ignores(_controlword: int) -> None:
    """It answers, and does nothing."""


@pytest.mark.parametrize("obeys", [refuses, ignores])
def test_a_drive_that_stays_powered_is_left_to_its_supervision_and_named(
    settings: RigSettings, obeys: Callable[[int], None]
) -> None:
    found = Found(settings)
    drive = drives(found, SPEED_MM_S)
    drive.device.set_data(od.ABORT_CONNECTION_OPTION, 0, (3).to_bytes(2, "little"))
    drive.writers[od.CONTROLWORD, 0] = obeys
    with pytest.raises(StartupError, match=r"NMT stop .* use the emergency stop") as refused:
        found.bring_up()
    assert "\n" not in str(refused.value)
    assert found.nmt()[-1] == od.NMT_STOP
    assert drive.nmt_state is NmtState.STOPPED
    assert not any(can_id & ~0x7F == od.HEARTBEAT_BASE for can_id, _ in found.sent), "no heartbeat of ours"
    found._pass_time(lambda: False, 1.0)
    assert drive.control.stage.phase is StagePhase.BRAKED, "its own supervision has stopped it"


def test_a_drive_in_nmt_stopped_is_made_to_answer(settings: RigSettings) -> None:
    found = Found(settings)
    found.rig.drive._enter(NmtState.STOPPED)
    assert found.bring_up().supervised
    assert found.nmt()[0] == 0x80
    assert found.rig.drive.nmt_state is NmtState.OPERATIONAL


def test_a_drive_that_never_answers_gets_nmt_stop_and_is_named(settings: RigSettings) -> None:
    found = Found(settings.model_copy(update={"can": settings.can.model_copy(update={"boot_wait_s": 0.2})}))
    found.rig.drive._on_sdo = lambda *_: None  # type: ignore[method-assign]
    found.rig.drive.network.unsubscribe(found.rig.drive.device.sdo.rx_cobid)
    with pytest.raises(StartupError, match="state of the drive is unknown, so it was sent NMT stop"):
        found.bring_up()
    assert found.nmt() == [0x80, od.NMT_STOP, od.NMT_STOP]


def fitted(settings: RigSettings, name: str) -> RigSettings:
    """The rig file with the device of the section ``name``."""
    sections = {
        "io": IoSettings(e_stop_input=9),
        "rail_encoder": RailEncoderSettings(counts_per_turn=1 << 20, rate_hz=1000),
        "second_force": SecondForceSettings(
            kind="cell", u_n=0.1, cell_u_n=0.05, disagree_n=0.5, fuse_s=1.0, rate_hz=50
        ),
    }
    return settings.model_copy(update={name: sections[name]}) if name in sections else settings


@pytest.mark.gate("cylinder-once", "tension_cell-three times", "inclinometer-twice", "io-once")
@pytest.mark.parametrize("refused", [1, 2, 3], ids=["once", "twice", "three times"])
@pytest.mark.parametrize("name", ["tension_cell", "inclinometer", "cylinder", "io", "rail_encoder", "second_force"])
def test_an_nmt_start_that_is_not_taken_is_repeated(
    settings: RigSettings, gains: Gains, monkeypatch: pytest.MonkeyPatch, name: str, refused: int
) -> None:
    settings = fitted(settings, name)
    node, left, enter = getattr(settings, name).node, [refused], Node._enter

    def entered(self: Node, state: NmtState) -> None:
        if self.id == node and state is NmtState.OPERATIONAL and left[0] > 0:
            left[0] -= 1
            return
        enter(self, state)

    monkeypatch.setattr(Node, "_enter", entered)
    with lockstep(settings, gains) as rig:
        rig.run(2.0)
        started = refused < 3
        assert rig.loop.inbox.network.states[node] == (NmtState.OPERATIONAL if started else NmtState.PRE_OPERATIONAL)
        if name in ("second_force", "rail_encoder"):  # the first bars arming without a zero, the second never does
            return
        assert rig.command(Verb.ARM) is (Refusal.NONE if started else Refusal.PREFLIGHT)
        if not started:
            assert Check(int(rig.reply["checks"])) & Check.NODE_NOT_OPERATIONAL
            rig.start_anew()  # the remedy that it names
            rig.run(2.0)
            arms(rig)
        assert rig.loop.machine.mode is Mode.HOLD


@pytest.mark.parametrize("times", [0, 1, 2], ids=["taken", "lost once", "lost twice"])
def test_an_error_that_outlives_its_cause_ends_with_a_reset_of_the_communication(
    settings: RigSettings, monkeypatch: pytest.MonkeyPatch, times: int
) -> None:
    """One that is lost is repeated, without the boot-up message; one that has no effect is named."""
    found, left = Found(settings), [times]
    drive = found.rig.drive
    monkeypatch.setattr(drive, "_clear_faults", lambda: False)
    drive.raise_error(od.EmcyCode.RPDO_TIMEOUT, 0x10)
    reset = drive.reset_communication

    def cleared() -> None:
        monkeypatch.undo()
        drive._errors.clear()
        reset()

    def tap(_sender: Port, frame: bytes) -> list[bytes]:
        can_id, _, data = FRAME.unpack(frame)
        lost = (can_id, data[:2]) == (od.NMT_COB, bytes([0x82, drive.id])) and left[0] > 0
        left[0] -= lost
        return [] if lost else [frame]

    drive._commands[0x82] = cleared
    found.hub.tap = tap
    found.bring_up()
    first, *more = [line for line in found.said if "reset communication" in line]
    assert "0x8250, RPDO timeout" in first and "node 4" in first
    assert (od.EmcyCode.RPDO_TIMEOUT in drive._errors) is (times == 2)
    assert [line.partition("(node 4)")[2] for line in more] == (NO_EFFECT if times == 2 else [])
    assert drive.nmt_state is NmtState.OPERATIONAL
    assert not math.isnan(found.rig.truth.stroke_mm)


def test_what_a_start_found_is_on_record(settings: RigSettings, gains: Gains, monkeypatch: pytest.MonkeyPatch) -> None:
    reset = CylinderDrive.on_node_reset

    def with_a_target(self: CylinderDrive) -> None:
        reset(self)
        self._target = 20_000

    monkeypatch.setattr(CylinderDrive, "on_node_reset", with_a_target)
    with lockstep(settings, gains) as rig:
        rig.run(0.1)
        (event,) = [event for event in rig.events.read() if event["kind"] == Kind.FOUND_AT_START]
        kind, a, b, value, limit, text = (event[n].item() for n in ("kind", "a", "b", "value", "limit", "text"))
    said = worded(kind, a, b, value, limit, text.decode())
    assert said.text == "0x60FF of the drive was found at 20000 at the start, set to 0"
    assert said.severity == "warning"
