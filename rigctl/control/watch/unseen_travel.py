"""How far the stroke has moved the load while the law acts, in newtons that the cell did not show.

The rope stretches by the stroke s and by the lean of the rope, and its tension shows it:

    unseen = k (s + L (1/cos theta - 1)) - T, each since it was latched

and the way that a stop from the present speed takes. A payload that moves up and down looks the same, up to what the
rig file declares of it (``safety.heave_mm``). A frozen cell looks like that for the probe's time to detection at most,
so a second bound counts from the newest moment at which the cell is known to have measured. From the ramp of
TENSIONING on the same holds with a tolerance for the stiffness: a cell that drifts makes a ramp too short or too long.
"""

from __future__ import annotations

from collections import deque

from rigctl.config.settings import RigSettings
from rigctl.control.findings import TravelSeen

MOST_SHARE = 0.1  # of the rope's set-point: what a frozen cell may do unseen
SHARE = 0.09  # at which it trips: the rest is for persistence, stop and an error of the stiffness
LEAST_MM = 0.5  # of stroke, in any case: levels and run-out
LATCH_MM = 0.1  # beside the motion that is declared: of stretch, from the tension's error when it was latched
STOP_S = 0.03  # beside the drive's lag and delay: the row's persistence, and the ramp to standstill
TOLERANCE = 0.2  # of a change of tension: the stiffness may be off by so much, as in the family of the design


class UnseenTravel:
    """Call ``look`` in every tick in which the travel is bounded, else ``end``."""

    def __init__(self, settings: RigSettings, detection_s: float, step_s: float) -> None:
        """``detection_s``: of a frozen cell; ``step_s``: between two judgements of the probe."""
        plant, safety = settings.plant, settings.safety
        self.stiffness_n_mm, self._length_mm = plant.slow_stiffness_n_mm, plant.rope_length_mm
        self._least_n = LEAST_MM * self.stiffness_n_mm
        self._heave_mm = (safety.heave_mm or 0.0) + LATCH_MM
        self._in_time_mm = frozen_mm(settings, detection_s) + LATCH_MM
        self._stop_s = plant.cylinder_lag_s + plant.command_delay_s + STOP_S
        self.seen = TravelSeen()
        self._before = max(1, round(detection_s / step_s))  # judgements
        self.end()

    def end(self) -> None:
        """Nothing is watched: the stroke may go anywhere."""
        seen = self.seen
        seen.excess_n = seen.unseen_n = seen.bound_n = 0.0
        self._from: tuple[float, float] | None = None
        self._known: deque[float] = deque(maxlen=self._before)

    def look(
        self, stroke_mm: float, speed_mm_s: float, tension_n: float, cosine: float, setpoint_n: float, *, judged: bool
    ) -> None:
        """One tick; ``judged``: the probe has just found the cell to answer."""
        seen, stretch_mm = self.seen, stroke_mm + self._length_mm / cosine
        if self._from is None:
            self._from = stretch_mm, tension_n
            self._known.append(0.0)
        from_mm, from_n = self._from
        unseen_n = self.stiffness_n_mm * (stretch_mm - from_mm) - (tension_n - from_n)
        if judged:
            self._known.append(unseen_n)
        bound_n = max(SHARE * setpoint_n, self._least_n) + TOLERANCE * abs(tension_n - from_n)
        lately_n = unseen_n - self._known[0]
        stop_n = self.stiffness_n_mm * speed_mm_s * self._stop_s
        whole_n, lately_n = abs(unseen_n + stop_n), abs(lately_n + stop_n)
        whole_bound_n = max(bound_n, self.stiffness_n_mm * self._heave_mm)
        lately_bound_n = max(bound_n, self.stiffness_n_mm * self._in_time_mm)
        if whole_n - whole_bound_n > lately_n - lately_bound_n:
            seen.unseen_n, seen.bound_n = whole_n, whole_bound_n
        else:
            seen.unseen_n, seen.bound_n = lately_n, lately_bound_n
        seen.excess_n = seen.unseen_n - seen.bound_n

    def found_stiffness(self, n_mm: float) -> None:
        """Take a rope or mechanism that gives way by more than the tolerance, as the sign check found it."""
        if (1.0 + TOLERANCE) * n_mm < self.stiffness_n_mm:
            self.stiffness_n_mm = n_mm


def share_n(settings: RigSettings, setpoint_n: float) -> float:
    """Bound in N for a payload that does not move."""
    return max(SHARE * setpoint_n, LEAST_MM * settings.plant.slow_stiffness_n_mm)


def frozen_mm(settings: RigSettings, detection_s: float) -> float:
    """Motion of the declared payload that a frozen cell cannot be distinguished from, until the probe finds it."""
    safety = settings.safety
    if safety.heave_mm is None:
        return 0.0
    way_mm = 2.0 * safety.heave_mm
    return way_mm if safety.heave_mm_s is None else min(way_mm, safety.heave_mm_s * detection_s)
