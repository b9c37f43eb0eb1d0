"""Whether a drive that was commanded off is without power: what shows it, or that nothing does.

The command is no evidence. Neither is the drive's own state alone: a drive whose firmware has failed may report any.
Nor is a load at rest alone, which a motor may carry.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.faults import Fault
from rigctl.control.modes import REST_S, PowerOff
from rigctl.control.safety import Action
from rigctl.control.snapshot import Snapshot

REST_NS = round(REST_S * 1e9)
REST_MM = 0.1  # of stretch: in 2 s a motor moves more at 0.05 mm/s
WAIT_NS = 5_000_000_000  # the drive's own supervision (2 s at most), then rest
_SMOOTH_S = 0.05  # of the cell's noise
CELL_DOUBTED = frozenset(
    {Fault.CELL_STALE, Fault.CELL_INVALID, Fault.CELL_STUCK, Fault.CELL_NOISY, Fault.CELL_NEGATIVE, Fault.SIGN_CELL,
     Fault.STRETCH_UNEXPLAINED, Fault.INNOVATION, Fault.CELL_FROZEN, Fault.LOAD_UNSEEN, Fault.SENSOR_EMERGENCY}
)  # fmt: skip
"""Faults after which a tension at rest shows nothing."""


class PowerOffWatch:
    """Watches from the command on, until the fault behind it is reset."""

    def __init__(self, settings: RigSettings) -> None:
        self._rest_n = REST_MM * settings.plant.stiffness_n_mm
        self._slack_n = settings.tension.slack_n
        self._stale_ns = settings.safety.stale_ms * 1_000_000
        self._share = settings.loop.period_ns * 1e-9 / _SMOOTH_S
        self._from_ns = self._rest_from_ns = 0
        self._tension_n = self._reference_n = math.nan
        self.shown = PowerOff.NONE

    def since_s(self, t_ns: int) -> float:
        """Time since the command in s."""
        return (t_ns - self._from_ns) * 1e-9

    def look(self, fault: Fault, action: Action, snapshot: Snapshot, *, braked: bool) -> PowerOff:
        """One tick with ``fault`` latched and ``action`` taken; ``braked``: see `Observer.braked`."""
        if fault is Fault.NONE or action < Action.POWER_OFF:
            self.shown = PowerOff.NONE
            return self.shown
        if self.shown is PowerOff.NONE:
            self.shown, self._from_ns, self._tension_n = PowerOff.AWAITED, snapshot.t_ns, math.nan
        seen = (
            fault not in CELL_DOUBTED and not snapshot.cell_frozen
            and snapshot.cell_quality == 0 and snapshot.cell_age_ns <= self._stale_ns
        )  # fmt: skip
        rest_ns = self._at_rest_ns(snapshot) if seen else 0
        slack = seen and snapshot.tension_n < self._slack_n
        shown = self._evidence(snapshot, rest_ns, slack=slack, braked=braked)
        if shown is not PowerOff.AWAITED:
            self.shown = shown
        elif self.shown.confirmed:
            moves = seen and not rest_ns and not self._drive_at_rest(snapshot)
            on = not braked and self.shown is not PowerOff.INPUT
            self.shown = PowerOff.UNCONFIRMED if moves or on else self.shown
        elif snapshot.t_ns - self._from_ns > WAIT_NS:
            self.shown = PowerOff.UNCONFIRMED
        return self.shown

    def _evidence(self, snapshot: Snapshot, rest_ns: int, *, slack: bool, braked: bool) -> PowerOff:
        """``rest_ns``: 0 where the tension says nothing; ``slack`` only where it says something."""
        if snapshot.torque_off:
            return PowerOff.INPUT
        if braked and not slack and rest_ns >= REST_NS:
            return PowerOff.TENSION
        return PowerOff.STROKE if braked and slack and self._drive_at_rest(snapshot, REST_NS) else PowerOff.AWAITED

    def _drive_at_rest(self, snapshot: Snapshot, at_least_ns: int = 1) -> bool:
        """The drive reports a state without power, and its stroke has stood still since the command or longer."""
        still_ns = min(snapshot.still_ns, snapshot.off_ns, snapshot.t_ns - self._from_ns)
        return snapshot.drive_age_ns <= self._stale_ns and still_ns >= at_least_ns

    def _at_rest_ns(self, snapshot: Snapshot) -> int:
        """Time for which the smoothed tension has stayed within `REST_MM` of stretch."""
        if math.isnan(self._tension_n):
            self._tension_n, self._reference_n = snapshot.tension_n, math.inf
        self._tension_n += (snapshot.tension_n - self._tension_n) * self._share
        if abs(self._tension_n - self._reference_n) > self._rest_n:
            self._reference_n, self._rest_from_ns = self._tension_n, snapshot.t_ns
        return snapshot.t_ns - self._rest_from_ns
