"""Sign checks in the first tensioning after a start: the signs of drive and cell must be right before compensating.

A positive command must move the stroke up, and a shorter rope must pull harder, by a stiffness that the assumed family
of plants has (`PlantSettings.found_n_mm`): beyond it neither the gains nor the lengths of the rig file are right.
A rig that is wired, mounted or configured the other way round would run away in the closed loop; here it is caught
within a millimetre, or within the tension that counts as slack. A tensioning too short for a verdict leaves the check
to the next one. A stiffness beyond the family, but by less than a factor of three, is looked at again over four times
the span, in which a mechanism that swings or a payload that moves shows less.

A wrong scale of the cell makes a wrong stiffness, and a soft mechanism makes the same. Where nothing else checks the
scale, a stiffness beyond `WARNED_SHARE` of the plant's is a warning.

On a rig that starts tight and on target the ramp makes no motion to judge. Then the tension is first lowered by
`SLOPE_N` in open loop at low speed (raised where there is no room below); the ramp then leads back.
"""

from __future__ import annotations

import math

from rigctl.config.plant_section import FOUND_FACTOR
from rigctl.config.settings import RigSettings
from rigctl.control.findings import SignsSeen
from rigctl.model.faults import Fault

TRAVEL_MM = 0.1  # expected travel before the drive is judged: more than its delay hides
PATIENCE_MM = 1.0  # expected travel at which the drive must have moved
FOLLOWS, OPPOSES = 0.5, -0.25  # shares of the expected travel
SLOPE_N, SLOPE_MM = 15.0, 0.2  # span of the slope's verdict: far above noise and the screw's play
WARNED_SHARE = 0.2  # of the plant's stiffness: as much as the assumed family has
AGAIN = 4.0  # spans of the second look
FALL_NOISES = 20.0
PROBE_S, PROBE_MM_S = 0.5, 0.2  # time and least speed of the probing move; a dead band may hold a slower drive


class SignCheck:
    """Runs every tick of TENSIONING until ``passed``; ``slope_n_mm`` is the stiffness found.

    ``warns``: that stiffness is off, and nothing else checks the cell's scale.

    ``probe_mm_s``: speed of the probing move in open loop; 0 for none.
    """

    def __init__(self, settings: RigSettings) -> None:
        plant, tension = settings.plant, settings.tension
        self._stiffness, self._slow_n_mm = plant.stiffness_n_mm, plant.slow_stiffness_n_mm
        self._range_n_mm = plant.found_n_mm
        self._dt = 1.0 / settings.loop.rate_hz
        self._share = 1.0 - math.exp(-self._dt / plant.cylinder_lag_s)
        self._coast_share = 1.0 - math.exp(-self._dt / (plant.cylinder_lag_s + plant.command_delay_s))
        self._stroke_min_mm = settings.cylinder.stroke_min_mm
        self._tight_n = 2.0 * tension.slack_n
        self._fall_n = max(tension.slack_n, FALL_NOISES * settings.tension_cell.noise_n)
        self._warned_n_mm = (1.0 - WARNED_SHARE) * self._slow_n_mm, (1.0 + WARNED_SHARE) * self._stiffness
        self._unchecked = unchecked(settings)
        self.passed = False
        self.seen = SignsSeen()
        self.slope_n_mm = math.nan
        self.begin(0.0, 0.0)

    @property
    def warns(self) -> bool:
        """See the class; False until there is a stiffness."""
        least, most = self._warned_n_mm
        return self._unchecked and (self.slope_n_mm < least or self.slope_n_mm > most)

    def begin(self, stroke_mm: float, tension_n: float, speed_mm_s: float = 0.0) -> None:
        """A tensioning starts at this stroke and tension; ``speed_mm_s``: of a motion before it that is ending."""
        self._coasts_mm_s = speed_mm_s
        self.probe_mm_s, self.seen.words = 0.0, ""
        self._travel_mm, self._span_mm = TRAVEL_MM, max(SLOPE_N / self._stiffness, SLOPE_MM)
        self._last_look = False
        self._start_mm, self._start_n = stroke_mm, tension_n
        self._tight_at: tuple[float, float] | None = None
        self._expected_mm = self._speed_mm_s = 0.0
        self._drive_follows = False

    def feel(self, stroke_mm: float, tension_n: float) -> None:
        """The tension is on target and the check undecided: start the probing move."""
        self.begin(stroke_mm, tension_n)
        # The load seats the nut, so there is no play to exceed, and a stiff rope gains no more tension than a soft one.
        self._span_mm = span_mm = SLOPE_N / self._stiffness
        self._last_look = True  # there is no room for more
        self._travel_mm = min(TRAVEL_MM, 0.5 * span_mm)
        room = stroke_mm - span_mm > self._stroke_min_mm and tension_n - SLOPE_N > self._tight_n
        self.probe_mm_s = math.copysign(max(span_mm / PROBE_S, PROBE_MM_S), -1.0 if room else 1.0)

    def see(self, command_mm_s: float, stroke_mm: float, tension_n: float) -> Fault:
        """One tick, with the command that acts in it, stroke and tension; returns the fault, or NONE."""
        seen, fault = self.seen, self._judge(command_mm_s, stroke_mm, tension_n)
        seen.drive_reversed, seen.cell_reversed = fault is Fault.SIGN_DRIVE, fault is Fault.SIGN_CELL
        return fault

    def _judge(self, command_mm_s: float, stroke_mm: float, tension_n: float) -> Fault:
        self._speed_mm_s += (command_mm_s - self._speed_mm_s) * self._share
        self._expected_mm += self._speed_mm_s * self._dt
        self._coasts_mm_s -= self._coasts_mm_s * self._coast_share
        self._start_mm += self._coasts_mm_s * self._dt
        if not self._drive_follows and self._drive_opposes(stroke_mm):
            return Fault.SIGN_DRIVE
        if self._cell_opposes(stroke_mm, tension_n):
            return Fault.SIGN_CELL
        return Fault.NONE

    def _drive_opposes(self, stroke_mm: float) -> bool:
        if abs(self._expected_mm) < self._travel_mm:
            return False
        share = (stroke_mm - self._start_mm) / self._expected_mm
        self._drive_follows = share >= FOLLOWS
        return share <= OPPOSES or (not self._drive_follows and abs(self._expected_mm) >= PATIENCE_MM)

    def _cell_opposes(self, stroke_mm: float, tension_n: float) -> bool:
        moved_mm, gained_n = stroke_mm - self._start_mm, tension_n - self._start_n
        if moved_mm * gained_n < 0.0 and abs(gained_n) >= self._fall_n:
            # A fall steeper than the rope's stiffness allows comes from a load that moves, not from the stroke.
            return abs(moved_mm) * self._stiffness * FOUND_FACTOR >= abs(gained_n)
        if self._tight_at is None:
            if tension_n >= self._tight_n:
                self._tight_at = stroke_mm, tension_n
            return False
        at_mm, at_n = self._tight_at
        moved_mm = stroke_mm - at_mm
        if abs(moved_mm) < self._span_mm:
            return False
        self.slope_n_mm = (tension_n - at_n) / moved_mm
        least, most = self._range_n_mm
        if least <= self.slope_n_mm <= most:
            self.passed = self._drive_follows
            if self.passed:
                self.probe_mm_s = 0.0
            return False
        near = self._slow_n_mm / FOUND_FACTOR <= self.slope_n_mm <= self._stiffness * FOUND_FACTOR
        if near and not self._last_look:
            self._span_mm, self._last_look = AGAIN * self._span_mm, True
            return False
        self.seen.words = f"{self.slope_n_mm:z.2f} N/mm found, {least:.2f} to {most:.2f} N/mm expected"
        return True


def unchecked(settings: RigSettings) -> bool:
    """Nothing shows a wrong scale of the cell: no calibration is demanded, and the motor's current has no factor."""
    calibration = settings.calibration
    return settings.cylinder.force_per_ampere_n is None and (calibration is None or calibration.waiver is not None)
