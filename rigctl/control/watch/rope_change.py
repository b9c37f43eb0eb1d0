"""The stiffness by which the tension answers the stroke in the probe's windows, against that of all windows before.

What the cell's noise or a payload moves is in tension and stroke alike, and not in step with the probe; so the mean of
many windows is the stiffness of rope, spring and mechanism, whatever the law does. It is compared with the rig's own
from before and not with the rig file's, which need not know the mechanism.
"""

from __future__ import annotations

import math
from collections import deque

from rigctl.control.excitation.probe_plan import FALSE_ALARM_SIGMA, LEAST_CHANGE, OVERLAP, ProbePlan


class RopeChange:
    """``changed``: the newest windows differ from all before; ``now_n_mm`` and ``before_n_mm``: their stiffness."""

    def __init__(self, plan: ProbePlan) -> None:
        self._windows, self._least_variance = plan.rope_windows, plan.silent**2
        self.forget()

    def forget(self) -> None:
        """A change is acknowledged, or the law's gains have changed: begin anew."""
        self._newest: deque[tuple[complex, complex, float]] = deque()
        self._tension = self._stroke = 0j  # sums of the windows before the newest
        self._before = 0
        self._sum = self._squares = 0.0  # of the newest windows' differences
        self.changed = False
        self.now_n_mm = self.before_n_mm = math.nan

    def add(self, tension: complex, stroke: complex) -> None:
        """One window: what answers the probe in N and in mm, both with the same weights."""
        newest, windows = self._newest, self._windows
        difference = 0.0
        if self._before >= windows:
            mean = self._stroke / self._before
            power = mean.real**2 + mean.imag**2
            stiffness = (self._tension * mean.conjugate()).real / (self._before * power)
            difference = ((tension - stiffness * stroke) * mean.conjugate()).real / (stiffness * power)
            self.before_n_mm = stiffness
        newest.append((tension, stroke, difference))
        self._sum += difference
        self._squares += difference * difference
        if len(newest) <= windows:
            return
        tension, stroke, difference = newest.popleft()
        self._tension += tension
        self._stroke += stroke
        self._before += 1
        self._sum -= difference
        self._squares -= difference * difference
        self.changed = self._before >= 2 * windows and self._judge()

    def _judge(self) -> bool:
        windows = self._windows
        mean = self._sum / windows
        self.now_n_mm = (1.0 + mean) * self.before_n_mm
        variance = max(self._squares / windows - mean * mean, self._least_variance)
        sure = FALSE_ALARM_SIGMA * math.sqrt(OVERLAP * variance * (1.0 / windows + 1.0 / self._before))
        return abs(mean) > max(sure, 0.5 * LEAST_CHANGE)
