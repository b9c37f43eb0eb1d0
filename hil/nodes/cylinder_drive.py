"""Cylinder drive, CiA 402 in cyclic synchronous velocity mode, which watches its controller and stops by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hil.nodes.deadline import Deadline
from hil.nodes.device_control import PROFILE_DECELERATION, QUICK_STOP_OPTIONS, DeviceControl
from hil.nodes.dictionary import Abort, number, refuse
from hil.nodes.drive_states import command_of
from hil.nodes.encoder import Encoder
from hil.nodes.motor import Motor
from hil.nodes.network import RigNetwork
from hil.nodes.node import COMMUNICATION_ERROR, GENERIC_ERROR, Node
from hil.nodes.pdo import ReceivePdo
from hil.nodes.power_stage import PowerStage, StagePhase
from hil.plant import Plant
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import DriveSettings, SimulationSettings
from rigctl.devices import objects
from rigctl.devices.objects import Controlword, DriveState, EmcyCode, NmtState

SERIAL = 402001
MODES = frozenset({0, objects.CYCLIC_SYNCHRONOUS_VELOCITY})

_STATUS_ALWAYS = 0x0010  # voltage enabled
_STOP_COMMANDS = frozenset({Controlword.QUICK_STOP, Controlword.DISABLE_VOLTAGE})
_INT16_MAX = 0x7FFF
_FAULT_REACTION = 1  # value of 0x6007: react as 0x605E says
LOWER_LIMIT, UPPER_LIMIT, HOME, E_STOP_CLOSED = 1 << 0, 1 << 1, 1 << 2, 1 << 16
"""Bits of the digital inputs (0x60FD); the emergency stop's circuit is closed while it is not pressed."""
HOME_MM = 1.0


@dataclass(frozen=True)
class ServiceTool:
    """A commissioning tool at the drive's own port, which enables the drive independently of the bus.

    ``deaf``: the drive meanwhile ignores even quick stop and disable voltage from the bus. ``shows_remote``: its
    statusword does not show the tool (bits 9 and 12 stay on).
    """

    speed_mm_s: float
    deaf: bool = False
    shows_remote: bool = False


class CylinderDrive(Node):
    """The drive on the bus. ``advance`` is called on the rig's fixed grid, ``on_sync`` at each SYNC.

    Heartbeat loss (0x1016), a missed RPDO deadline (0x1400:05) and leaving NMT OPERATIONAL while enabled are answered
    by the abort connection option (0x6007). An emergency stop is a fault of its own: emergency, fault
    reaction (0x605E), brake; nothing enables the drive or clears the fault while it is pressed.
    """

    def __init__(
        self, network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant
    ) -> None:
        cylinder = settings.cylinder
        drive = simulation.drive
        super().__init__(network, cylinder.node, settings.file(cylinder.eds), plant, SERIAL, drive.clock_ppm)
        self._encoder = Encoder(plant, drive.encoder_mm)
        stage = PowerStage(drive.brake_ms * 1_000_000)
        self._motor = Motor(drive, number(self.device, objects.MOTOR_RATED_CURRENT))
        self._creep_n_s_mm = drive.creep_n_s_mm
        self.e_stop_pressed = False
        own = drive.increments_per_mm
        self._unit_mm = objects.MM_PER_POSITION_UNIT if own is None else 1.0 / own  # of position; of speed per second
        self.control = DeviceControl(
            stage, lambda index: number(self.device, index), self._clear_faults, unit_mm_s2=self._unit_mm
        )
        self._heartbeat = Deadline()
        self._heartbeat_cob = 0
        self._commands_due = Deadline()
        self._target = self._offset = 0
        self._mode = 0
        self._error_code = 0
        self._speed_max_mm_s = drive.speed_mm_s
        self.tool: ServiceTool | None = None
        self._received: bytes | None = None
        self._rpdo: ReceivePdo | None = None
        self.defect: Callable[[float, bool], tuple[float, bool]] | None = None
        """Defect of motor and brake: maps the right speed (mm/s) and brake (whether it holds) to the actual ones."""
        self.readers.update(
            {
                (objects.STATUSWORD, 0): self._statusword,
                (objects.POSITION_ACTUAL, 0): self._position,
                (objects.VELOCITY_ACTUAL, 0): self._velocity,
                (objects.VELOCITY_ACTUAL_16, 0): self._velocity_16,
                (objects.MODE_DISPLAY, 0): lambda: self._mode,
                (objects.ERROR_CODE, 0): lambda: self._error_code,
                (objects.CONTROLWORD, 0): lambda: self.control.controlword,
                (objects.TARGET_VELOCITY, 0): lambda: self._target,
                (objects.CURRENT_ACTUAL, 0): lambda: self._motor.current_units,
                (objects.DRIVE_TEMPERATURE, 0): lambda: self._motor.temperature_units,
                (objects.DIGITAL_INPUTS, 0): self._inputs,
            }
        )
        if own is not None:
            self._count_in_increments(own, drive)
        self.writers.update(
            {
                (objects.CONTROLWORD, 0): self._obey,
                (objects.TARGET_VELOCITY, 0): self._set_target,
                (objects.VELOCITY_OFFSET, 0): self._set_offset,
                (objects.MODE_OF_OPERATION, 0): self._set_mode,
                (objects.QUICK_STOP_OPTION, 0): _check_quick_stop_option,
                (objects.CONSUMER_HEARTBEAT, 1): self._watch_heartbeat,
                (objects.RPDO1_COMMUNICATION, 5): self._commands_due.set_limit_ms,
            }
        )

    def _count_in_increments(self, per_mm: float, drive: DriveSettings) -> None:
        """Units are increments per turn of the screw, without an SI unit (0x60A8, 0x60A9); ramps last as before."""
        per_turn = round(per_mm * drive.screw_lead_mm)
        self.readers.update(
            {
                (objects.SI_UNIT_POSITION, 0): lambda: 0,
                (objects.SI_UNIT_VELOCITY, 0): lambda: 0,
                (objects.ENCODER_RESOLUTION, 1): lambda: per_turn,
                (objects.FEED_CONSTANT, 1): lambda: per_turn,
            }
        )
        for index in (PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION):
            variable = self.device.object_dictionary[index]
            variable.default = round(variable.default * objects.MM_PER_POSITION_UNIT * per_mm)

    # -- commands ----------------------------------------------------------------------------------------------

    def on_sync(self) -> None:
        """Act on the RPDO received since the last SYNC and drive at the target velocity; then send the TPDO."""
        if self._received is not None and self._rpdo is not None:
            received, self._received = self._received, None
            self._rpdo.apply(received)
        if self.control.state is DriveState.OPERATION_ENABLED:
            moves = self._mode == objects.CYCLIC_SYNCHRONOUS_VELOCITY
            bus_mm_s = self._target_mm_s if moves else 0.0
            self.control.stage.follow(bus_mm_s if self.tool is None else self.tool.speed_mm_s)
            self._drive()
        super().on_sync()

    def advance(self, t_ns: int) -> None:
        """Measure speed and current; advance ramps and the brake to ``t_ns``."""
        self._encoder.advance()
        self.control.advance(t_ns, self._encoder.speed_mm_s)
        self._drive()
        stage, truth = self.control.stage, self.plant.truth
        self._motor.advance(t_ns, truth.tension_n if stage.powered else 0.0, stage.velocity_mm_s)

    def press_e_stop(self, pressed: bool) -> None:
        """Open the emergency stop's circuit, or close it again."""
        self.e_stop_pressed = pressed
        if pressed:
            self.trip(EmcyCode.EXTERNAL)

    def take_over(self, tool: ServiceTool | None) -> None:
        """Let a service tool at the drive's own port enable and move the drive; None withdraws it."""
        self.tool = tool
        if tool is not None:
            self.control.enable_locally(self.now_ns)

    @property
    def _target_mm_s(self) -> float:
        return (self._target + self._offset) * self._unit_mm

    def _drive(self) -> None:
        stage = self.control.stage
        falling = stage.phase is StagePhase.FALLING
        speed_mm_s = -self.plant.truth.tension_n / self._creep_n_s_mm if falling else stage.velocity_mm_s
        if self.defect is None:
            self.plant.set_drive(speed_mm_s, stage.braked)
        else:
            self.plant.set_drive(*self.defect(speed_mm_s, stage.braked))

    def _on_rpdo(self, _: int, data: bytes, __: float) -> None:
        rpdo = self._rpdo
        if rpdo is None or self.nmt_state is not NmtState.OPERATIONAL or len(data) < rpdo.size:
            return
        self._commands_due.renew()
        if rpdo.synchronous:
            self._received = data
        else:
            rpdo.apply(data)

    def _obey(self, controlword: int) -> None:
        tool = self.tool
        if tool is not None and (tool.deaf or command_of(controlword, self.control.controlword) not in _STOP_COMMANDS):
            self.control.controlword = controlword
            return
        self.control.obey(controlword, self.now_ns, may_enable=self.nmt_state is NmtState.OPERATIONAL)

    def _set_target(self, velocity_um_s: int) -> None:
        self._target = velocity_um_s

    def _set_offset(self, velocity_um_s: int) -> None:
        self._offset = velocity_um_s

    def _set_mode(self, mode: int) -> None:
        if mode not in MODES:
            raise refuse(Abort.VALUE_RANGE)
        self._mode = mode

    # -- supervision of the controller -------------------------------------------------------------------------

    def supervise(self, t_ns: int, elapsed_ns: int) -> None:
        """Send the heartbeat and check the controller's silence."""
        super().supervise(t_ns, elapsed_ns)
        if self._heartbeat.runs_out(elapsed_ns):
            self._lose_connection(EmcyCode.HEARTBEAT_LOST)
        if self._commands_due.runs_out(elapsed_ns):
            self._lose_connection(EmcyCode.RPDO_TIMEOUT)
        if self.errors and not self.control.faulty:
            self._clear_faults()  # 0x6007 demands no fault: the error ends with its cause

    def on_state(self, before: NmtState, now: NmtState) -> None:
        """Leaving OPERATIONAL while enabled is a lost connection; the wait for commands starts again."""
        super().on_state(before, now)
        self._commands_due.restart()
        self._received = None
        if before is NmtState.OPERATIONAL and self.control.enabled:
            self._lose_connection(EmcyCode.COMMUNICATION)

    def on_node_reset(self) -> None:
        """Objects at their defaults; the state machine starts anew, once a motor that was on has been stopped."""
        self._mode = number(self.device, objects.MODE_OF_OPERATION)
        self._target = 0
        has_offset = objects.VELOCITY_OFFSET in self.device.object_dictionary  # optional in the profile
        self._offset = number(self.device, objects.VELOCITY_OFFSET) if has_offset else 0
        self._error_code = 0
        self.control.restart(self.now_ns)
        if self.e_stop_pressed:
            self.trip(EmcyCode.EXTERNAL)

    def on_communication_reset(self) -> None:
        """Heartbeat consumer and RPDO deadline at their defaults: off."""
        self._watch_heartbeat(number(self.device, objects.CONSUMER_HEARTBEAT, 1))
        self._commands_due.set_limit_ms(number(self.device, objects.RPDO1_COMMUNICATION, 5))

    def on_pdo_change(self) -> None:
        """Compile the RPDO anew and listen to its identifier."""
        super().on_pdo_change()
        if self._rpdo is not None and self._rpdo.valid:
            self.network.unsubscribe(self._rpdo.cob_id, self._on_rpdo)
        self._received = None
        self._rpdo = ReceivePdo(self.device, self.writers)
        if self._rpdo.valid:
            self.network.subscribe(self._rpdo.cob_id, self._on_rpdo)

    def _watch_heartbeat(self, entry: int) -> None:
        """0x1016:01: node id in bits 16 to 22, time in ms below; a 0 in either turns supervision off."""
        if self._heartbeat_cob:
            self.network.unsubscribe(self._heartbeat_cob, self._on_heartbeat)
        node, limit_ms = entry >> 16 & 0x7F, entry & 0xFFFF
        self._heartbeat_cob = objects.HEARTBEAT_BASE + node if node and limit_ms else 0
        self._heartbeat.set_limit_ms(limit_ms if node else 0)
        if self._heartbeat_cob:
            self.network.subscribe(self._heartbeat_cob, self._on_heartbeat)

    def _on_heartbeat(self, _: int, data: bytes, __: float) -> None:
        if data and data[0] != NmtState.BOOT_UP:
            self._heartbeat.renew()

    @property
    def stopping(self) -> bool:
        """Whether the motor stops for good: it ramps down, or its brake closes or is closed."""
        return self.control.stage.phase not in (StagePhase.OPENING, StagePhase.DRIVING)

    def trip(self, code: int) -> None:
        """A fault of the drive itself: emergency, and the fault reaction (0x605E)."""
        self._error_code = code
        self.raise_error(code, GENERIC_ERROR)
        self.control.lose_connection(_FAULT_REACTION, self.now_ns)

    def _lose_connection(self, code: EmcyCode) -> None:
        self._error_code = code
        self.raise_error(code, COMMUNICATION_ERROR)
        self.control.lose_connection(number(self.device, objects.ABORT_CONNECTION_OPTION), self.now_ns)

    def _clear_faults(self) -> bool:
        """Drop the errors if no cause is left; returns whether it did."""
        if self._heartbeat.overdue or self._commands_due.overdue or self.e_stop_pressed:
            return False
        for code in self.errors:
            self.clear_error(code)
        self._error_code = 0
        return True

    # -- reports -----------------------------------------------------------------------------------------------

    def _statusword(self) -> int:
        """Bit 9: the controlword is obeyed; 12: in CSV the target velocity is followed; 11: a limit acts on it."""
        tool, enabled = self.tool, self.control.state is DriveState.OPERATION_ENABLED
        status = self.control.state | _STATUS_ALWAYS
        if tool is None or tool.shows_remote:
            status |= objects.STATUS_REMOTE
        if enabled and self._mode == objects.CYCLIC_SYNCHRONOUS_VELOCITY and (tool is None or tool.shows_remote):
            status |= objects.STATUS_FOLLOWS
        if self.plant.at_stroke_end or (enabled and abs(self._target_mm_s) > self._speed_max_mm_s):
            status |= objects.STATUS_INTERNAL_LIMIT
        return status

    def _inputs(self) -> int:
        """Bits of the digital inputs; the limit switches are at the mechanical ends."""
        p, x = self.plant.parameters[0], self.plant.state[0]
        bits = LOWER_LIMIT if x["motor"] <= p["stroke_low"] else 0
        bits |= UPPER_LIMIT if x["motor"] >= p["stroke_high"] else 0
        bits |= HOME if abs(x["motor"]) <= HOME_MM else 0
        return bits | (0 if self.e_stop_pressed else E_STOP_CLOSED)

    def _position(self) -> int:
        return round(self._encoder.position_mm / self._unit_mm)

    def _velocity(self) -> int:
        return round(self._encoder.speed_mm_s / self._unit_mm)

    def _velocity_16(self) -> int:
        units = round(self._encoder.speed_mm_s / objects.MM_S_PER_VELOCITY_16_UNIT)
        return min(max(units, -_INT16_MAX), _INT16_MAX)


def _check_quick_stop_option(option: int) -> None:
    if option not in QUICK_STOP_OPTIONS:
        raise refuse(Abort.VALUE_RANGE)
