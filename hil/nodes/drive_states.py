"""CiA 402 device control as tables: controlword to command, state and command to state."""

from __future__ import annotations

from rigctl.devices.objects import Controlword
from rigctl.model.device_states import DriveState

_COMMAND_BITS = (  # CiA 402 table "command coding": mask, value, command
    (0x82, 0x00, Controlword.DISABLE_VOLTAGE),
    (0x86, 0x02, Controlword.QUICK_STOP),
    (0x87, 0x06, Controlword.SHUTDOWN),
    (0x8F, 0x07, Controlword.SWITCH_ON),
    (0x8F, 0x0F, Controlword.ENABLE_OPERATION),
)

_COMMANDS: tuple[Controlword | None, ...] = tuple(
    next((command for mask, value, command in _COMMAND_BITS if low & mask == value), None) for low in range(0x100)
)

_NEXT = {
    DriveState.SWITCH_ON_DISABLED: {
        Controlword.SHUTDOWN: DriveState.READY_TO_SWITCH_ON,  # transition 2
    },
    DriveState.READY_TO_SWITCH_ON: {
        Controlword.SWITCH_ON: DriveState.SWITCHED_ON,  # 3
        Controlword.ENABLE_OPERATION: DriveState.SWITCHED_ON,  # 3, and 4 with the next evaluation
        Controlword.QUICK_STOP: DriveState.SWITCH_ON_DISABLED,  # 7
        Controlword.DISABLE_VOLTAGE: DriveState.SWITCH_ON_DISABLED,  # 7
    },
    DriveState.SWITCHED_ON: {
        Controlword.ENABLE_OPERATION: DriveState.OPERATION_ENABLED,  # 4
        Controlword.SWITCH_ON: DriveState.SWITCHED_ON,  # calls off 4 while the brake opens
        Controlword.SHUTDOWN: DriveState.READY_TO_SWITCH_ON,  # 6
        Controlword.QUICK_STOP: DriveState.SWITCH_ON_DISABLED,  # 10
        Controlword.DISABLE_VOLTAGE: DriveState.SWITCH_ON_DISABLED,  # 10
    },
    DriveState.OPERATION_ENABLED: {
        Controlword.SWITCH_ON: DriveState.SWITCHED_ON,  # 5, disable operation
        Controlword.SHUTDOWN: DriveState.READY_TO_SWITCH_ON,  # 8
        Controlword.DISABLE_VOLTAGE: DriveState.SWITCH_ON_DISABLED,  # 9
        Controlword.QUICK_STOP: DriveState.QUICK_STOP_ACTIVE,  # 11
    },
    DriveState.QUICK_STOP_ACTIVE: {
        Controlword.DISABLE_VOLTAGE: DriveState.SWITCH_ON_DISABLED,  # 12
        Controlword.ENABLE_OPERATION: DriveState.OPERATION_ENABLED,  # 16, if the quick stop option says "stay"
    },
    DriveState.FAULT: {
        Controlword.FAULT_RESET: DriveState.SWITCH_ON_DISABLED,  # 15
    },
}
"""Transitions a controlword can cause; 0 and 1 (start-up), 13 and 14 (faults) and the automatic 12 are the drive's."""

WHEN_STOPPED = {
    DriveState.NOT_READY: DriveState.SWITCH_ON_DISABLED,  # 1
    DriveState.FAULT_REACTION_ACTIVE: DriveState.FAULT,  # 14
    DriveState.QUICK_STOP_ACTIVE: DriveState.SWITCH_ON_DISABLED,  # 12, unless the option says "stay"
}
"""Where a state goes by itself once the motor is stopped and the brake closed."""


def command_of(controlword: int, previous: int) -> Controlword | None:
    """The command in a controlword; a fault reset is the rising edge of bit 7."""
    if controlword & ~previous & Controlword.FAULT_RESET:
        return Controlword.FAULT_RESET
    return _COMMANDS[controlword & 0xFF]


def next_state(state: DriveState, command: Controlword | None) -> DriveState | None:
    """State a command leads to, None where it changes nothing."""
    leads = _NEXT.get(state)
    return leads.get(command) if leads is not None and command is not None else None
