"""Controlwords that lead the cylinder drive through the CiA 402 power states: pure tables; what a start found in it."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from rigctl.devices.objects import Controlword
from rigctl.model.device_states import DriveState


class Power(IntEnum):
    """State wanted of the drive."""

    OFF = 0  # stopped, brake closed, no power
    ON = 1  # operation enabled
    RESET = 2  # the rising edge of the fault reset, after RESET_LOW
    QUICK_STOP = 3  # stop on the drive's own ramp, then off
    CUT = 4  # off at once, even in motion: the brake is the last resort
    RESET_LOW = 5  # the word before that edge


class LeftInDrive(NamedTuple):
    """A value that a former controller has left in the drive, and that which it has after the start.

    Of the statusword (0x6041) it is the state, see `DriveState`.
    """

    object_index: int
    value: int
    left: int


_TO_ON: dict[DriveState, Controlword] = {
    DriveState.SWITCH_ON_DISABLED: Controlword.SHUTDOWN,
    DriveState.READY_TO_SWITCH_ON: Controlword.SWITCH_ON,
    DriveState.SWITCHED_ON: Controlword.ENABLE_OPERATION,
    DriveState.OPERATION_ENABLED: Controlword.ENABLE_OPERATION,
    DriveState.QUICK_STOP_ACTIVE: Controlword.QUICK_STOP,  # it may still move, so its stop must not be cut short
}
_TO_OFF: dict[DriveState, Controlword] = {
    DriveState.SWITCHED_ON: Controlword.SHUTDOWN,
    DriveState.OPERATION_ENABLED: Controlword.SHUTDOWN,
    DriveState.READY_TO_SWITCH_ON: Controlword.SHUTDOWN,
    DriveState.SWITCH_ON_DISABLED: Controlword.SHUTDOWN,
    DriveState.QUICK_STOP_ACTIVE: Controlword.QUICK_STOP,  # it goes off by itself at standstill (0x605A)
}


_STOPPABLE = frozenset({DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE})


def next_controlword(state: DriveState, power: Power) -> Controlword:
    """Command that takes the drive one step towards ``power``.

    A fault reset is a rising edge of bit 7. Each of its two words stays for longer than a drive takes to read its
    controlword again, see `rigctl.control.power.stage.RESET_WORD_NS`.
    """
    if power is Power.RESET and state is DriveState.FAULT:
        return Controlword.FAULT_RESET
    if power in (Power.CUT, Power.RESET_LOW):
        return Controlword.DISABLE_VOLTAGE
    if power is Power.QUICK_STOP and state in _STOPPABLE:
        return Controlword.QUICK_STOP
    steps = _TO_ON if power is Power.ON else _TO_OFF
    return steps.get(state, Controlword.SHUTDOWN)  # in an unknown state the motor may turn
