"""The motor's torque before the brake opens (0x60B2), so that the load does not turn it back when it takes over."""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.snapshot import Snapshot


class Preload:
    """Rope force that the drive's torque offset shall carry.

    It follows the tension while the drive is off and its brake closed, also where that brake slips. While the motor
    holds it stays, because a step of the offset would move the load; so does a tension that is not known any more.
    """

    def __init__(self, settings: RigSettings) -> None:
        self._most_n = settings.safety.tension_high_n
        self._force_n = 0.0

    def look(self, snapshot: Snapshot) -> float:
        """Force for this tick's command, N."""
        braked = snapshot.drive_off and snapshot.power.brake_time_over
        known = snapshot.drive_heard and snapshot.cell_heard and snapshot.cell_quality == 0
        if braked and known and math.isfinite(snapshot.tension_n):
            self._force_n = min(max(snapshot.tension_n, 0.0), self._most_n)
        return self._force_n
