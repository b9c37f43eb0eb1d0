"""Whether the drive's power stage is off: what the drive is, apart from what it was commanded."""

from __future__ import annotations

from rigctl.control.modes import DrivePower, HeldBy
from rigctl.devices.objects import STOPPING_STATES, UNPOWERED_STATES, DriveState, drive_state


def drive_shown(statusword: int, held_by: int) -> tuple[DriveState, DrivePower]:
    """The state that a statusword reports, and whether it is off, by what carries the load in the same tick."""
    state = drive_state(statusword)
    if state in UNPOWERED_STATES and held_by == HeldBy.BRAKE:
        return state, DrivePower.OFF
    stops = state in STOPPING_STATES or state in UNPOWERED_STATES
    return state, DrivePower.STOPPING if stops and held_by != HeldBy.TAKING else DrivePower.NOT_OFF
