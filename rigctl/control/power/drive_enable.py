"""The hard-wired enable of the drive: the I/O node's output at the drive's input for safe torque off (STO).

The output is set while the drive is to be on, and dropped once the drive has been off for long enough to have closed
its brake: an output that drops earlier would leave the load to a brake that is still closing. As a part of the last
resort it drops at once.
"""

from __future__ import annotations

from rigctl.config.settings import RigSettings
from rigctl.devices.process_data import DRIVE_ENABLE, ProcessData

REPEATS = 10  # ticks in which a change is sent, since a frame may be lost


class DriveEnable:
    """Which frame of the output is due. On a rig without the output none ever is.

    ``fitted``: the rig file has the output. ``on``: the output is set.
    """

    def __init__(self, settings: RigSettings, data: ProcessData) -> None:
        io = settings.io
        self.fitted = DRIVE_ENABLE in data.frames
        self.on = False
        self.can_id = data.can_ids(settings).get(DRIVE_ENABLE, 0)
        self._frames = (b"", b"")
        if self.fitted and io is not None:
            pack = data.frames[DRIVE_ENABLE].codec.pack
            self._frames = pack(0), pack(io.enable_mask)
        self._left = REPEATS

    def due(self, on: bool, *, heartbeat: bool) -> bytes | None:
        """The frame to send in this tick: a change in the ticks that follow it, and with each ``heartbeat``."""
        if on is not self.on:
            self.on, self._left = on, REPEATS
        if not self.fitted or not (self._left or heartbeat):
            return None
        self._left = max(0, self._left - 1)
        return self._frames[self.on]
