"""The drive's current, temperature and inputs, where its status is configured: what is known of them, and of power."""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.findings import DriveStatusSeen
from rigctl.control.power.drive_power import CURRENT_SHARE
from rigctl.control.watch.safety import status_stale_ns

CURRENT_NS = 500_000_000
"""For so long after the drive reports off, `CURRENT_SHARE` of the motor's rated current shows power."""


class DriveStatus:
    """Call ``look`` every tick; a status that is stale counts as unknown."""

    def __init__(self, settings: RigSettings) -> None:
        self._stale_ns = status_stale_ns(settings)
        self._current_a = CURRENT_SHARE * (settings.cylinder.rated_current_a or math.inf)
        self._e_stop_fitted = settings.cylinder.e_stop_input is not None
        self._without_ns = 0  # last tick that shows no power
        self.seen = DriveStatusSeen()

    def look(self, now_ns: int, inbox: Inbox, *, off: bool) -> None:
        """One tick; ``off``: the drive reports a state without power."""
        if not self._stale_ns:
            return
        seen = self.seen
        seen.age_ns = now_ns - inbox.drive_status.t_ns
        stale = seen.age_ns > self._stale_ns
        seen.temperature_c = math.nan if stale else inbox.drive_status.temperature_c
        current_a = seen.current_a = math.nan if stale else inbox.drive_status.current_a
        seen.flows = current_a > self._current_a or current_a < -self._current_a
        if not (seen.flows and off):
            self._without_ns = now_ns
        seen.lasts = now_ns - self._without_ns >= CURRENT_NS
        seen.e_stop_unseen = stale and self._e_stop_fitted
