"""History for the charts: smallest and largest value of every signal, in buckets of several widths.

Every tick counts in its bucket, so no spike is lost however wide the window; memory is bounded by the windows.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rigctl.page.chart_signals import SIGNALS, Values

WINDOWS_S = (60, 300, 900, 3600)
BUCKETS = 1200  # per window: about one for each pixel column of a chart

Ids = npt.NDArray[np.int64]


class Level:
    """One window: a ring of buckets, each with a number counted from 1970 in bucket widths."""

    def __init__(self, window_s: int, signals: int = len(SIGNALS), buckets: int = BUCKETS) -> None:
        self.window_s = window_s
        self.width_ns = window_s * 1_000_000_000 // buckets
        self.newest = -1  # number of the newest bucket, -1 without one
        self._low = np.full((buckets, signals), np.nan, np.float32)
        self._high = self._low.copy()

    def add(self, wall_ns: Ids, values: Values) -> None:
        """Add values (n, signals) at ``wall_ns`` (n), ascending, not older than those held."""
        ids = wall_ns // self.width_ns
        starts = np.concatenate(([0], np.flatnonzero(np.diff(ids)) + 1))
        numbers = ids[starts]
        self._open(int(numbers[-1]))
        recent = numbers > self.newest - len(self._low)
        slots = numbers[recent] % len(self._low)
        low, high = (f.reduceat(values, starts, axis=0)[recent] for f in (np.fmin, np.fmax))
        with np.errstate(over="ignore"):
            self._low[slots] = np.fmin(self._low[slots], low)
            self._high[slots] = np.fmax(self._high[slots], high)

    def _open(self, newest: int) -> None:
        """Clear the buckets up to a new one."""
        fresh = min(newest - self.newest, len(self._low))
        if fresh > 0:
            slots = np.arange(newest - fresh + 1, newest + 1) % len(self._low)
            self._low[slots] = self._high[slots] = np.nan
            self.newest = newest

    def since(self, number: int) -> tuple[int, npt.NDArray[np.float32]]:
        """Number of the first bucket, and the buckets (n, signals, 2: smallest and largest) from ``number`` on."""
        if self.newest < 0:
            return 0, np.empty((0, self._low.shape[1], 2), np.float32)
        first = max(number, self.newest - len(self._low) + 1)
        slots = np.arange(first, self.newest + 1) % len(self._low)
        return first, np.stack((self._low[slots], self._high[slots]), axis=2)


class History:
    """All windows; ``reset`` is for a clock that went backwards."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.levels = tuple(Level(window_s) for window_s in WINDOWS_S)
        self.newest_ns = 0  # wall clock of the newest record

    def add(self, wall_ns: Ids, values: Values) -> None:
        """Add values (n, signals) of records at ``wall_ns`` (n), ascending."""
        if not len(wall_ns):
            return
        if wall_ns[0] < self.newest_ns - 1_000_000_000:
            self.reset()
        for level in self.levels:
            level.add(wall_ns, values)
        self.newest_ns = int(wall_ns[-1])
