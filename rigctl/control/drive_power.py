"""Whether the drive's power stage is off: what the drive is, apart from what it was commanded."""

from __future__ import annotations

from enum import StrEnum

from rigctl.control.modes import HeldBy
from rigctl.devices.objects import STOPPING_STATES, UNPOWERED_STATES, DriveState, drive_state


class DrivePower(StrEnum):
    """Whether the motor may have torque; the value is what the screens show."""

    OFF = "off"  # it has reported a state without power for as long as its brake takes to close
    STOPPING = "stopping"  # on its way there by itself
    NOT_OFF = "not off"


def drive_shown(statusword: int, held_by: int) -> tuple[DriveState, DrivePower]:
    """The state that a statusword reports, and whether it is off, by what carries the load in the same tick."""
    state = drive_state(statusword)
    if state in UNPOWERED_STATES and held_by == HeldBy.BRAKE:
        return state, DrivePower.OFF
    stops = state in STOPPING_STATES or state in UNPOWERED_STATES
    return state, DrivePower.STOPPING if stops and held_by != HeldBy.TAKING else DrivePower.NOT_OFF
