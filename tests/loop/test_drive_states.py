"""The drive as a start finds it: in every powered state it is off, or the start names it, and nothing runs on.

The judge is the plant's truth: how far the stroke has moved, and whether the motor is powered.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from hil.lockstep import lockstep
from hil.nodes.cylinder_drive import CylinderDrive
from hil.nodes.dictionary import Abort, refuse
from hil.nodes.node import Node
from hil.nodes.power_stage import StagePhase
from hil.wire import FRAME
from rigctl.config.io_section import IoSettings
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings import RigSettings
from rigctl.control.events import Kind, worded
from rigctl.control.modes import Mode, Refusal, Verb
from rigctl.control.tension import Gains
from rigctl.devices import objects as od
from rigctl.devices.objects import DriveState, NmtState
from rigctl.devices.remote_node import StartupError
from tests.builders.rig_on_hub import RigOnHub

SPEED_MM_S = 5.0
NOT_POWERED = (DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON, DriveState.FAULT)
WORST_MM = 1.0
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


WAYS_IN: tuple[Left, ...] = (
    enabled_and_moving, enabled_at_rest_with_a_target, in_a_quick_stop_that_stays,
    switched_on_with_the_motor_carrying, in_a_fault_reaction,
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
    named = [item for item in report.found if item.object_index == od.STATUSWORD]
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
    assert found.nmt() == [0x80, od.NMT_STOP]


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
        assert rig.loop.inbox.states[node] == (NmtState.OPERATIONAL if refused < 3 else NmtState.PRE_OPERATIONAL)
        if name in ("second_force", "rail_encoder"):  # the first bars arming without a zero, the second never does
            return
        assert rig.command(Verb.ARM) is (Refusal.NONE if refused < 3 else Refusal.PREFLIGHT)
        assert rig.loop.machine.mode is (Mode.HOLD if refused < 3 else Mode.DISARMED)


def test_an_error_that_outlives_its_cause_ends_with_a_reset_of_the_communication(
    settings: RigSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = Found(settings)
    drive = found.rig.drive
    monkeypatch.setattr(drive, "_clear_faults", lambda: False)
    drive.raise_error(od.EmcyCode.RPDO_TIMEOUT, 0x10)
    reset = drive.reset_communication

    def cleared() -> None:
        monkeypatch.undo()
        drive._errors.clear()
        reset()

    drive._commands[0x82] = cleared
    found.bring_up()
    (line,) = [line for line in found.said if "reset communication" in line]
    assert "0x8250, RPDO timeout" in line and "node 4" in line
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
