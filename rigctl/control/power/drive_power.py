"""Whether the drive's power stage is off: what the drive is, apart from what it was commanded."""

from __future__ import annotations

from rigctl.devices.objects import STOPPING_STATES, UNPOWERED_STATES, drive_state
from rigctl.model.device_states import DriveState
from rigctl.model.states import DrivePower

CURRENT_SHARE = 0.05
"""Of the motor's rated current: more shows power, less shows nothing."""


def drive_shown(statusword: int, *, off: bool, taking: bool) -> tuple[DriveState, DrivePower]:
    """The state that a statusword reports, and whether the power is off.

    Args:
        statusword: as the drive has sent it.
        off: it has reported a state without power for its brake's time, see `rigctl.model.states.Flag`.
        taking: it has been commanded on, and is not enabled yet.
    """
    state = drive_state(statusword)
    if off:
        return state, DrivePower.OFF
    stops = state in STOPPING_STATES or state in UNPOWERED_STATES
    return state, DrivePower.STOPPING if stops and not taking else DrivePower.NOT_OFF
