"""The stroke that HOLD, FAULT and DISARMED keep: its latch, its excursion, and the loop that brings it back.

A drive that is commanded 0 mm/s may still creep. In HOLD and FAULT a position loop with integral action corrects that,

    u = -K_p e - I,    dI/dt = K_i e,    e = stroke - latched stroke, outside a dead zone

while the safety table watches the distance from the latch (`rigctl.control.watch.safety`, STROKE_NOT_HELD) and the sum
of the correction (POSITION_DRIFTS). To a drive that creeps the sum is what it would have moved the load; to an encoder
that drifts it is what the correction has moved it, and no cell that might have stopped measuring can deny that.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.findings import StrokeHoldSeen
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch.plausibility import STROKE_MEMORY_S
from rigctl.control.watch.safety import CONTRADICTION_MM, STROKE_ERROR_MM

SHOWN_MM, OVER_MM = 0.2, 0.1  # an excursion is reported beyond the first and ends within the second
DEAD_ZONE_MM = 0.02  # no correction within it, so that encoder noise and the drive's dead band cause no motion
AUTHORITY_MM_S = STROKE_ERROR_MM / STROKE_MEMORY_S
"""A drive that creeps faster than this trips DRIVE_NOT_FOLLOWING, so no correction needs more."""
CREEP_MM_S, CREEP_S = 0.05, 3.0  # integral action above the first for longer than the second is reported
LAGS_PER_GAIN = 8.0  # 1/K_p in lags of the drive: a phase margin of 70 deg, or 65 deg with twice the lag
INTEGRAL_SHARE = 0.2  # K_i / K_p^2: real poles at 0.28 and 0.72 K_p, no overshoot
STOP_LAGS, SETTLE_LAGS = 3.0, 6.0  # distance of a stop in lags times its first speed; time to its end in lags
REST_MM_S, SPARE_MM = 0.05, 0.05


class StrokeHold:
    """The latch and its position loop. Call ``watch`` every tick, then ``correct``; ``follow`` while the stroke moves.

    ``left``: this tick the stroke left the latch by `SHOWN_MM`; ``creeps``: the correction has now been needed for
    `CREEP_S`. Both are true once per excursion.
    """

    def __init__(self, settings: RigSettings) -> None:
        plant, tension = settings.plant, settings.tension
        self._dt = 1.0 / settings.loop.rate_hz
        lag_s = plant.cylinder_lag_s + plant.command_delay_s + self._dt
        self._gain = 1.0 / (LAGS_PER_GAIN * lag_s)
        self._integral_gain = INTEGRAL_SHARE * self._gain**2
        self._speed_max = tension.speed_max_mm_s
        self._authority = min(AUTHORITY_MM_S, self._speed_max)
        self._stop_s, self._settle_s = STOP_LAGS * lag_s, SETTLE_LAGS * lag_s
        self._deceleration = min(tension.acceleration_max_mm_s2, settings.cylinder.stop_deceleration_mm_s2)
        self.seen = StrokeHoldSeen()
        self.latch_anew()

    def follow(self) -> None:
        """One tick in which the stroke moves on purpose."""
        seen = self.seen
        seen.excursion_mm = seen.corrected_mm = 0.0
        if self._settles_ns is not None:
            self.latch_anew()

    def latch_anew(self) -> None:
        """The motor has taken the load, or a motion is acknowledged; ``seen`` shows it from the next tick on."""
        self.reference_mm = math.nan
        self._error_mm = self._corrected_mm = self.command_mm_s = 0.0
        self.left = self.creeps = False
        self._reported = self._creep_reported = self._doubted = False
        self._settles_ns: int | None = None
        self._low_mm = self._high_mm = math.nan
        self._integral_mm_s = self._creeps_s = 0.0

    def watch(self, t_ns: int, snapshot: Snapshot, command_mm_s: float) -> None:
        """One tick of a mode that keeps the stroke; ``command_mm_s`` is the last command.

        A moving stroke is latched where it comes to rest, within the distance a stop may take: so a stop is not pulled
        back, and a drive that does not stop does not take the latch along.
        """
        self.left = False
        stroke_mm, seen = snapshot.stroke_mm, self.seen
        seen.excursion_mm, seen.corrected_mm = self._error_mm, self._corrected_mm
        if not math.isfinite(stroke_mm):
            return
        if not math.isfinite(self.reference_mm):
            if self._settles_ns is None:
                self._begin(t_ns, stroke_mm, snapshot.speed_mm_s, command_mm_s)
            if self._settles_ns is None or t_ns < self._settles_ns:
                return
            self.reference_mm = max(self._low_mm, min(self._high_mm, stroke_mm))
        self._error_mm = seen.excursion_mm = stroke_mm - self.reference_mm
        distance_mm = abs(seen.excursion_mm)
        self.left = distance_mm > SHOWN_MM and not self._reported
        self._reported = distance_mm > SHOWN_MM or (self._reported and distance_mm > OVER_MM)
        self._doubted |= abs(snapshot.plausibility.contradiction_mm) > CONTRADICTION_MM

    def correct(self, snapshot: Snapshot, ticks: int, *, powered: bool) -> float:
        """Speed in mm/s that brings the stroke back to the latch; 0 where its position is unknown or doubted.

        It is bounded by `AUTHORITY_MM_S`; the law's limits follow.

        Args:
            snapshot: of this tick.
            ticks: since the last call.
            powered: the drive is on and stays on.
        """
        known = math.isfinite(self.reference_mm) and snapshot.drive_heard and not self._doubted
        self.creeps = False
        if not (known and powered):
            self.command_mm_s = 0.0
            return 0.0
        passed_s, error_mm = ticks * self._dt, self._error_mm
        error_mm -= max(-DEAD_ZONE_MM, min(DEAD_ZONE_MM, error_mm))
        wanted = -self._gain * error_mm - self._integral_mm_s
        self.command_mm_s = max(-self._authority, min(self._authority, wanted))
        # Anti-windup: integrate only what the authority lets through, or what leads back inside it.
        if self.command_mm_s == wanted or (wanted - self.command_mm_s) * error_mm > 0.0:
            integral = self._integral_mm_s + self._integral_gain * error_mm * passed_s
            self._integral_mm_s = max(-self._authority, min(self._authority, integral))
        self._creeps_s = self._creeps_s + passed_s if abs(self._integral_mm_s) > CREEP_MM_S else 0.0
        self.creeps = self._creeps_s > CREEP_S and not self._creep_reported
        self._creep_reported |= self.creeps
        self._corrected_mm += self.command_mm_s * passed_s
        return self.command_mm_s

    @property
    def creep_mm_s(self) -> float:
        """Speed at which the drive creeps when commanded 0 mm/s, as the correction has found it."""
        return self._integral_mm_s

    def _begin(self, t_ns: int, stroke_mm: float, speed_mm_s: float, command_mm_s: float) -> None:
        """Set the range in which the stop may end, and its time; the speeds are bounded by the law's limit."""
        lowest = max(-self._speed_max, min(0.0, speed_mm_s, command_mm_s))
        highest = min(self._speed_max, max(0.0, speed_mm_s, command_mm_s))
        fastest = max(-lowest, highest)
        settle_s = fastest / self._deceleration + self._settle_s if fastest > REST_MM_S else 0.0
        self._settles_ns = t_ns + round(settle_s * 1e9)
        self._low_mm = stroke_mm - self._way_mm(-lowest) - SPARE_MM
        self._high_mm = stroke_mm + self._way_mm(highest) + SPARE_MM

    def _way_mm(self, speed_mm_s: float) -> float:
        return speed_mm_s * self._stop_s + speed_mm_s**2 / (2.0 * self._deceleration)
