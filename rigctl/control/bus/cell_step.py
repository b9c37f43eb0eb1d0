"""A tension that is another one from one sample to the next and stays so: no payload does that on a spring.

In one sample a payload can change the tension by the stretch of its fastest motion and by the rope's loss at its
hardest acceleration. A step beyond that is of the cell's scale, its zero or its amplifier, or a rope that has slipped.
A single bad sample is none, and a slack rope has none either: a weight is hung on its cell by hand.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings

PAYLOAD_MM_S = 80.0  # faster than any payload; a jolt of 1 mm in 20 ms makes 75 at most
PAYLOAD_MM_S2 = 20_000.0  # harder than any payload's jolt
LOSS_S = 0.01  # the rope's damping over its stiffness, 8 ms as it was identified
NOISES = 8.0  # of the cell's noise
UNRESTS = 6.0  # of the mean step from sample to sample, where that is greater
STAYS = 5  # samples at the other value
SHARE = 0.7  # of the step that has to be left in each of them


class CellStep:
    """``step_n``: size of a step that has just stayed for `STAYS` samples, for one sample; else 0."""

    def __init__(self, settings: RigSettings) -> None:
        per_tick = settings.plant.stiffness_n_mm / settings.loop.rate_hz
        self._tick_n, self._jolt_n = per_tick * PAYLOAD_MM_S, per_tick * PAYLOAD_MM_S2 * LOSS_S
        self._noise_n = NOISES * settings.tension_cell.noise_n
        self._before_n = self._last_n = math.nan
        self._size_n, self._stayed = 0.0, 0
        self.step_n = 0.0

    def look(self, reading_n: float, ticks: int, unrest_n: float, *, slack: bool) -> None:
        """One fresh sample, ``ticks`` after the one before; ``unrest_n``: mean step from sample to sample."""
        self.step_n, size_n = 0.0, reading_n - self._last_n
        if slack:
            self._stayed, reading_n = 0, math.nan  # the next sample is compared with none
        elif self._stayed:
            stays_n = (reading_n - self._before_n) * math.copysign(1.0, self._size_n)
            self._stayed = self._stayed + 1 if stays_n > SHARE * abs(self._size_n) else 0
            if self._stayed > STAYS:
                self.step_n, self._stayed = abs(self._size_n), 0
        elif abs(size_n) > self._tick_n * ticks + self._jolt_n + max(self._noise_n, UNRESTS * unrest_n):
            self._before_n, self._size_n, self._stayed = self._last_n, size_n, 1
        self._last_n = reading_n
