"""The first tick at which position or speed shows a motor that the load turns; the reference cuts its power there."""

from __future__ import annotations

from collections import deque

from hil.faults.stand import Stand, Step
from rigctl.control.watch.safety import SPEED_ERROR_MM_S, STROKE_ERROR_MM

MEMORY_S = 0.1
"""Five lags of the drive: what was commanded before has no part in its speed any more."""


def cut_at_first_sign(stand: Stand, step: Step | None) -> Step:
    """A step that, beside ``step``, opens the input for safe torque off once the frames show what no command explains.

    That is a speed that no command of the last `MEMORY_S` explains, or a way that they cannot have made.
    """
    rig, drive = stand.lockstep, stand.drive
    period_s = 1.0 / rig.settings.loop.rate_hz
    fastest = deque[float](maxlen=round(MEMORY_S / period_s))
    beyond_mm = 0.0

    def watched(t_s: float) -> None:
        nonlocal beyond_mm
        if step is not None:
            step(t_s)
        loop = rig.loop
        fastest.append(abs(loop.law.command_mm_s))
        excess_mm_s = abs(loop.inbox.drive.speed_mm_s) - max(fastest)
        beyond_mm = max(0.0, beyond_mm + excess_mm_s * period_s)
        if rig.view.drive_enabled and (excess_mm_s > SPEED_ERROR_MM_S or beyond_mm > STROKE_ERROR_MM):
            drive.enable_by_wire(False)

    return watched
