"""Cylinder drive, CiA 402 in cyclic synchronous velocity mode, which watches its controller and stops by itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from hil.nodes.brake import Brake
from hil.nodes.clock import GRID_NS
from hil.nodes.deadline import Deadline
from hil.nodes.device_control import PROFILE_DECELERATION, QUICK_STOP_OPTIONS, DeviceControl
from hil.nodes.dictionary import Abort, number, refuse
from hil.nodes.drive_states import command_of
from hil.nodes.encoder import Encoder
from hil.nodes.heartbeat_consumer import HeartbeatConsumer
from hil.nodes.motor import Motor
from hil.nodes.network import RigNetwork
from hil.nodes.node import COMMUNICATION_ERROR, GENERIC_ERROR, Node
from hil.nodes.pdo import ReceivePdo
from hil.nodes.power_stage import PowerStage, StagePhase
from hil.nodes.speed_loop import IdealSpeedControl, SpeedControl, SpeedLoop
from hil.plant import Plant
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import DriveSettings, SimulationSettings
from rigctl.devices import objects
from rigctl.devices.objects import Controlword, EmcyCode
from rigctl.model.device_states import STATUSWORD, DriveState, NmtState

SERIAL = 402001
MODES = frozenset({0, objects.CYCLIC_SYNCHRONOUS_VELOCITY})

_STATUS_ALWAYS = 0x0010  # voltage enabled
_STOP_COMMANDS = frozenset({Controlword.QUICK_STOP, Controlword.DISABLE_VOLTAGE})
_INT16_MAX = 0x7FFF
_FAULT_REACTION = 1  # value of 0x6007: react as 0x605E says
LOWER_LIMIT, UPPER_LIMIT, HOME, E_STOP_CLOSED = 1 << 0, 1 << 1, 1 << 2, 1 << 16
"""Bits of the digital inputs (0x60FD); the emergency stop's circuit is closed while it is not pressed."""
HOME_MM = 1.0
PEAK_PER_RATED = 3.0
"""Peak torque of servo motors, per rated torque."""
SYNCS_MISSED = 20
"""Periods (0x1006) without SYNC after which this drive calls it lost; CiA 301 leaves the number to the device."""
_GRID_S = GRID_NS * 1e-9
_NS_PER_MS = 1_000_000


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

    Heartbeat loss (0x1016), a missed RPDO deadline (0x1400:05), loss of SYNC (0x1006, where there is one) and leaving
    NMT OPERATIONAL while enabled are answered by the abort connection option (0x6007). An emergency stop is a fault of
    its own: emergency, fault reaction (0x605E), brake; nothing enables the drive or clears the fault while it is
    pressed. Its input for safe torque off (`enable_by_wire`) takes the motor's power away at once and closes the brake.
    """

    def __init__(
        self, network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant
    ) -> None:
        cylinder = settings.cylinder
        drive = simulation.drive
        super().__init__(network, cylinder.node, settings.file(cylinder.eds), plant, SERIAL, drive.clock_ppm)
        self._encoder = Encoder(plant, drive.encoder_mm)
        stage = PowerStage(drive.brake_ms * _NS_PER_MS, Brake(*(ms * _NS_PER_MS for ms in drive.brake_times_ms)))
        rated_ma = number(self.device, objects.MOTOR_RATED_CURRENT)
        self._motor = Motor(drive, rated_ma)
        rated_n = rated_ma * objects.A_PER_RATED_CURRENT_UNIT * drive.force_n_a
        self._n_per_torque_unit = rated_n * objects.PER_TORQUE_UNIT * (1.0 - drive.preload_error_pct * 1e-2)
        self._speed_control = _speed_control(drive, PEAK_PER_RATED * rated_n)
        self._carries = False  # the motor alone, on the force that it had when the brake let go
        self._yielding_mm_s = 0.0
        self._creep_n_s_mm = drive.creep_n_s_mm
        self.e_stop_pressed = False
        own = drive.increments_per_mm
        self._unit_mm = objects.MM_PER_POSITION_UNIT if own is None else 1.0 / own  # of position; of speed per second
        self.control = DeviceControl(
            stage, lambda index: number(self.device, index), self._clear_faults, unit_mm_s2=self._unit_mm
        )
        self._heartbeat = HeartbeatConsumer(network)
        self._commands_due = Deadline()
        self._sync_due = Deadline()
        self._target = self._offset = 0
        self._position_sign = self._velocity_sign = 1
        self._mode = 0
        self._error_code = 0
        self._speed_max_mm_s = drive.speed_mm_s
        self.tool: ServiceTool | None = None
        self._received: bytes | None = None
        self._rpdo: ReceivePdo | None = None
        self.defect: Callable[[float, bool], tuple[float, bool]] | None = None
        """Defect of the motor: maps its right speed (mm/s) and whether the brake holds to the actual ones."""
        self.rpdo_defect: Callable[[bytes], bytes | None] | None = None
        """Defect of the application behind the CAN controller: maps a received RPDO to what it takes; None: nothing."""
        self.torque_defect: Callable[[float, int], float | None] | None = None
        """Defect of the motor: maps the load (N) and the time (ns) to the speed (mm/s) at which the load turns it, to
        None while its torque is as it should be; called while the brake is open."""
        self.hung = False
        """Defect of the same: nothing on the bus, and no loss of it, changes what the motor does."""
        self.readers.update(
            {
                (STATUSWORD, 0): self._statusword,
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
                (objects.TORQUE_OFFSET, 0): self._set_torque_offset,
                (objects.POLARITY, 0): self._set_polarity,
                (objects.MODE_OF_OPERATION, 0): self._set_mode,
                (objects.QUICK_STOP_OPTION, 0): _check_quick_stop_option,
                (objects.CONSUMER_HEARTBEAT, 1): self._heartbeat.watch,
                (objects.RPDO1_COMMUNICATION, 5): self._commands_due.set_limit_ms,
                (objects.CYCLE_PERIOD, 0): self._watch_sync,
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
        self._sync_due.renew()
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
        """Measure speed and current; advance ramps, brake and the motor's torque to ``t_ns``."""
        self._encoder.advance()
        self.control.advance(t_ns, self._encoder.speed_mm_s)
        self._motor.advance(t_ns, self._force_n(), self.control.stage.velocity_mm_s)
        self._drive()

    def _force_n(self) -> float:
        """The motor's force now; over the grid step that begins, the load may turn the motor back."""
        stage, load_n, control = self.control.stage, self.plant.truth.tension_n, self._speed_control
        carried, self._carries = self._carries, stage.powered and not self.brake.closed
        self._yielding_mm_s = 0.0
        if not stage.powered:
            control.switch_off()
            return 0.0
        control.build_up(_GRID_S)
        if not self._carries:
            control.wind_up(stage.velocity_mm_s * _GRID_S)
            return control.against_brake(load_n)
        if not carried:
            control.take_over(load_n, self.brake.drag_n)
        way_mm, excess_n = control.carry(_GRID_S)
        self._yielding_mm_s = way_mm / _GRID_S
        drag_n = math.copysign(self.brake.drag_n, stage.velocity_mm_s) if stage.velocity_mm_s else 0.0
        return load_n + excess_n + drag_n

    @property
    def brake(self) -> Brake:
        """The holding brake on the motor's shaft."""
        return self.control.stage.brake

    def press_e_stop(self, pressed: bool) -> None:
        """Open the emergency stop's circuit, or close it again."""
        self.e_stop_pressed = pressed
        if pressed:
            self.trip(EmcyCode.EXTERNAL)

    def enable_by_wire(self, on: bool) -> None:
        """The input for safe torque off: closed (True), or open."""
        self.control.safe_torque_off(not on, self.now_ns)

    def take_over(self, tool: ServiceTool | None) -> None:
        """Let a service tool at the drive's own port enable and move the drive; None withdraws it."""
        self.tool = tool
        if tool is not None:
            self.control.enable_locally(self.now_ns)

    @property
    def _target_mm_s(self) -> float:
        return (self._target + self._offset) * self._velocity_sign * self._unit_mm

    def _drive(self) -> None:
        stage, brake, load_n = self.control.stage, self.brake, self.plant.truth.tension_n
        speed_mm_s, held = stage.velocity_mm_s, brake.closed
        yielding_mm_s = self._yielding_mm_s
        if held and brake.slip_mm_s and load_n > 0.0:
            yielding_mm_s, held = -brake.slip_mm_s, False
        elif not (held or stage.powered):
            speed_mm_s = -load_n / self._creep_n_s_mm
        if self.torque_defect is not None and not held:
            turned_mm_s = self.torque_defect(load_n, self.plant.t_ns)
            if turned_mm_s is not None:
                speed_mm_s, yielding_mm_s = 0.0, turned_mm_s
        if self.defect is not None:
            speed_mm_s, held = self.defect(speed_mm_s, held)
        self.plant.set_drive(speed_mm_s, held, yielding_mm_s)

    def _on_rpdo(self, _: int, data: bytes, __: float) -> None:
        rpdo = self._rpdo
        if rpdo is None or self.nmt_state is not NmtState.OPERATIONAL or len(data) < rpdo.size:
            return
        self._commands_due.renew()
        taken = data if self.rpdo_defect is None else self.rpdo_defect(data)
        if taken is None or self.hung:
            return
        if rpdo.synchronous:
            self._received = taken
        else:
            rpdo.apply(taken)

    def _obey(self, controlword: int) -> None:
        if self.hung:
            return
        tool = self.tool
        if tool is not None and (tool.deaf or command_of(controlword, self.control.controlword) not in _STOP_COMMANDS):
            self.control.controlword = controlword
            return
        self.control.obey(controlword, self.now_ns, may_enable=self.nmt_state is NmtState.OPERATIONAL)

    def _set_target(self, velocity_um_s: int) -> None:
        self._target = velocity_um_s

    def _set_offset(self, velocity_um_s: int) -> None:
        self._offset = velocity_um_s

    def _set_torque_offset(self, per_mille: int) -> None:
        """0x60B2, of the rated torque: a preload while the brake opens, so that the load does not turn the motor."""
        self._speed_control.offset_n = per_mille * self._n_per_torque_unit

    def _set_polarity(self, polarity: int) -> None:
        """0x607E; it counts at once, also while the motor turns."""
        self._position_sign = -1 if polarity & objects.POSITION_POLARITY else 1
        self._velocity_sign = -1 if polarity & objects.VELOCITY_POLARITY else 1

    def _set_mode(self, mode: int) -> None:
        if mode not in MODES:
            raise refuse(Abort.VALUE_RANGE)
        self._mode = mode

    # -- supervision of the controller -------------------------------------------------------------------------

    def supervise(self, t_ns: int, elapsed_ns: int) -> None:
        """Send the heartbeat and check the controller's silence."""
        super().supervise(t_ns, elapsed_ns)
        silent_ns = self.clock.span_ns(elapsed_ns)
        if self._heartbeat.runs_out(silent_ns):
            self._lose_connection(EmcyCode.HEARTBEAT_LOST)
        if self._commands_due.runs_out(silent_ns):
            self._lose_connection(EmcyCode.RPDO_TIMEOUT)
        if self._sync_due.runs_out(silent_ns):
            self._lose_connection(EmcyCode.SYNC_LOST)
        if self.errors and not self.control.faulty:
            self._clear_faults()  # 0x6007 demands no fault: the error ends with its cause

    def on_state(self, before: NmtState, now: NmtState) -> None:
        """Leaving OPERATIONAL while enabled is a lost connection; the wait for commands starts again."""
        super().on_state(before, now)
        self._commands_due.restart()
        self._sync_due.restart()
        self._received = None
        if before is NmtState.OPERATIONAL and self.control.enabled:
            self._lose_connection(EmcyCode.COMMUNICATION)

    def on_node_reset(self) -> None:
        """Objects at their defaults; the state machine starts anew, once a motor that was on has been stopped."""
        self._mode = number(self.device, objects.MODE_OF_OPERATION)
        self._target = 0
        self._offset = self._optional(objects.VELOCITY_OFFSET)
        self._set_torque_offset(self._optional(objects.TORQUE_OFFSET))
        self._set_polarity(self._optional(objects.POLARITY))
        self._error_code = 0
        self.control.restart(self.now_ns)
        if self.e_stop_pressed:
            self.trip(EmcyCode.EXTERNAL)

    def _optional(self, index: int) -> int:
        """Default of an object that the profile leaves optional, 0 without it."""
        return number(self.device, index) if index in self.device.object_dictionary else 0

    def on_communication_reset(self) -> None:
        """Heartbeat consumer, RPDO deadline and SYNC's period at their defaults: off."""
        self._watch_sync(self._optional(objects.CYCLE_PERIOD))
        self._heartbeat.watch(number(self.device, objects.CONSUMER_HEARTBEAT, 1))
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

    def _watch_sync(self, period_us: int) -> None:
        """0x1006: SYNC is lost when so many periods pass without one; 0 turns supervision off."""
        self._sync_due.set_limit_ns(SYNCS_MISSED * period_us * 1000)

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
        if self.hung:
            return
        self.control.lose_connection(number(self.device, objects.ABORT_CONNECTION_OPTION), self.now_ns)

    def _clear_faults(self) -> bool:
        """Drop the errors if no cause is left; returns whether it did."""
        missed = (self._heartbeat, self._commands_due, self._sync_due)
        if self.e_stop_pressed or any(deadline.overdue for deadline in missed):
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
        return self._position_sign * round(self._encoder.position_mm / self._unit_mm)

    def _velocity(self) -> int:
        return self._velocity_sign * round(self._encoder.speed_mm_s / self._unit_mm)

    def _velocity_16(self) -> int:
        units = self._velocity_sign * round(self._encoder.speed_mm_s / objects.MM_S_PER_VELOCITY_16_UNIT)
        return min(max(units, -_INT16_MAX), _INT16_MAX)


def _check_quick_stop_option(option: int) -> None:
    if option not in QUICK_STOP_OPTIONS:
        raise refuse(Abort.VALUE_RANGE)


def _speed_control(drive: DriveSettings, most_n: float) -> SpeedControl:
    if drive.speed_loop_hz is None:
        return IdealSpeedControl()
    return SpeedLoop(drive.moved_kg, drive.speed_loop_hz, most_n, drive.torque_ms * 1e-3)
