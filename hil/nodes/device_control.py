"""CiA 402 device control: the power drive state machine over motor and brake."""

from __future__ import annotations

from collections.abc import Callable

from hil.nodes.drive_states import WHEN_STOPPED, command_of, next_state
from hil.nodes.power_stage import PowerStage, StagePhase
from rigctl.devices import objects
from rigctl.devices.objects import OFF_STATES, Controlword
from rigctl.model.device_states import DriveState

PROFILE_DECELERATION = 0x6084
QUICK_STOP_OPTIONS = frozenset({0, 1, 2, 5, 6})
_STAYS = 5  # quick stop options from here on stay in QUICK STOP ACTIVE; 5 and 6 ramp like 1 and 2
_CUT, _QUICK_STOP_RAMP = 0, 2
_OPTION_OBJECTS = {
    Controlword.QUICK_STOP: objects.QUICK_STOP_OPTION,
    Controlword.SHUTDOWN: objects.SHUTDOWN_OPTION,
    Controlword.SWITCH_ON: objects.DISABLE_OPERATION_OPTION,
}
_RAMP_OBJECTS = {1: PROFILE_DECELERATION, 2: objects.QUICK_STOP_DECELERATION, 5: PROFILE_DECELERATION,
                 6: objects.QUICK_STOP_DECELERATION}  # fmt: skip
_BY_ITSELF = frozenset({DriveState.FAULT_REACTION_ACTIVE, DriveState.NOT_READY})
"""States that no command leads to."""
_FAULTS = frozenset({DriveState.FAULT_REACTION_ACTIVE, DriveState.FAULT})


class DeviceControl:
    """State of the drive. Every way out of OPERATION ENABLED ends with power off and the brake closed.

    Quick stop, shutdown, disable operation and a fault stop the motor first, on the ramp their option code names; its
    value 0, and disable voltage always, take power off at once and leave the load to the closing brake.

    Args:
        stage: motor and brake.
        parameter: current value of an object of the drive (0x605A to 0x605E, 0x6084, 0x6085).
        clear_faults: called at a fault reset; returns whether no cause is left.
        unit_mm_s2: one unit of 0x6084 and 0x6085, in mm/s2.
    """

    def __init__(
        self,
        stage: PowerStage,
        parameter: Callable[[int], int],
        clear_faults: Callable[[], bool],
        unit_mm_s2: float = objects.MM_S_PER_VELOCITY_UNIT,
    ) -> None:
        self.state = DriveState.NOT_READY
        self.stage = stage
        self.controlword = 0
        self._parameter = parameter
        self._unit_mm_s2 = unit_mm_s2
        self._clear_faults = clear_faults
        self._enabling = False
        self._torque_off = False
        self.persists: DriveState | None = None
        """Defect: every commanded stop ends in this state, the motor carrying; only disable voltage leads out of it."""
        self.refuses = False
        """Defect: it does not switch its motor on."""

    @property
    def enabled(self) -> bool:
        """Whether the motor drives, or will as soon as the brake is open."""
        return self._enabling or self.state is DriveState.OPERATION_ENABLED

    @property
    def faulty(self) -> bool:
        """Whether a fault is being reacted to, or latched."""
        return self.state in _FAULTS

    def obey(self, controlword: int, t_ns: int, may_enable: bool) -> None:
        """Evaluate a controlword (0x6040)."""
        command = command_of(controlword, self.controlword)
        self.controlword = controlword
        target = next_state(self.state, command)
        if target is None or (self._torque_off and self.state is DriveState.SWITCH_ON_DISABLED):
            return
        if target is DriveState.OPERATION_ENABLED:
            if may_enable:
                self._enable(t_ns)
        elif command is not Controlword.FAULT_RESET or self._clear_faults():
            self._stop(target, self._option(command), t_ns)

    def advance(self, t_ns: int, speed_mm_s: float) -> None:
        """Advance ramp, brake and the states that wait for them to ``t_ns``."""
        self.stage.advance(t_ns, speed_mm_s)
        if self._enabling and self.stage.phase is StagePhase.DRIVING:
            self._enabling = False
            self.state = DriveState.OPERATION_ENABLED
        elif self.state in WHEN_STOPPED and self.stage.phase is StagePhase.BRAKED and not self._stays():
            self.state = WHEN_STOPPED[self.state]

    def safe_torque_off(self, active: bool, t_ns: int) -> None:
        """IEC 61800-5-2 STO: the motor has no torque, its brake closes, and SWITCH ON DISABLED is kept meanwhile."""
        self._torque_off = active
        if active and not self.faulty:
            self._stop(DriveState.SWITCH_ON_DISABLED, _CUT, t_ns)
        elif active:
            self.stage.cut(t_ns)

    def restart(self, t_ns: int) -> None:
        """Node reset, transitions 0 and 1; a motor that is on is stopped first."""
        self.controlword = 0
        self._stop(DriveState.NOT_READY, _QUICK_STOP_RAMP, t_ns)

    def enable_locally(self, t_ns: int) -> None:
        """Enable the drive from its own port; not from a fault, and not while the motor stops."""
        if not self._torque_off and (self.state in OFF_STATES or self.state is DriveState.SWITCHED_ON):
            self.state = DriveState.SWITCHED_ON
            self._enable(t_ns)

    def lose_connection(self, option: int, t_ns: int) -> None:
        """React as 0x6007 says: 0 nothing, 1 fault reaction (0x605E), 2 disable voltage, 3 quick stop then FAULT."""
        if option == 0 or self.faulty:
            return
        if option == 2:
            self._stop(DriveState.SWITCH_ON_DISABLED, _CUT, t_ns)
            return
        quick = option == objects.ABORT_CONNECTION_QUICK_STOP
        ramp = _QUICK_STOP_RAMP if quick else self._parameter(objects.FAULT_REACTION_OPTION)
        self._stop(DriveState.FAULT_REACTION_ACTIVE, ramp, t_ns)

    def _enable(self, t_ns: int) -> None:
        if self.refuses or (self.state is DriveState.QUICK_STOP_ACTIVE and not self._stays()):
            return
        self._enabling = True
        self.stage.start(t_ns)

    def _stop(self, target: DriveState, ramp_option: int, t_ns: int) -> None:
        """Go to ``target``; motor at rest on the ramp of an option code, then brake closed (0: power off at once)."""
        self._enabling = False
        stuck = None if ramp_option == _CUT or target in _BY_ITSELF or not self.stage.powered else self.persists
        self.state = target if stuck is None else stuck
        self.stage.carries_on = stuck is not None
        if ramp_option == _CUT:
            self.stage.cut(t_ns)
        else:
            self.stage.stop(t_ns, self._parameter(_RAMP_OBJECTS[ramp_option]) * self._unit_mm_s2)

    def _option(self, command: Controlword | None) -> int:
        """Option code by which a command stops the motor; it counts where the command leaves OPERATION ENABLED."""
        if command is Controlword.DISABLE_VOLTAGE:
            return _CUT
        driving = self.state is DriveState.OPERATION_ENABLED and command in _OPTION_OBJECTS
        return self._parameter(_OPTION_OBJECTS[command]) if driving and command else _QUICK_STOP_RAMP

    def _stays(self) -> bool:
        """Whether QUICK STOP ACTIVE ends only by a command (0x605A)."""
        return self.state is DriveState.QUICK_STOP_ACTIVE and self._parameter(objects.QUICK_STOP_OPTION) >= _STAYS
