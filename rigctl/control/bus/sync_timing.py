"""How late the samples of a tick were latched, from the time at which its SYNC was sent.

The filter's model has samples one period apart. A tick that wakes late or works longer sends its SYNC later, and the
devices latch later: at 0.5 ms and 6 mm/s on a spring of 34 N/mm the tension is 0.1 N further on, three times the cell's
noise. The mean time from grid point to SYNC is no jitter: it is the same in every tick and part of the delay.
"""

from __future__ import annotations

MEAN_TICKS = 1000  # time constant of the mean


class SyncTiming:
    """Lateness of the newest SYNC against the mean of those before it; ``period_s`` bounds it."""

    def __init__(self, period_s: float) -> None:
        self._most = period_s
        self._mean: float | None = None

    def late_s(self, synced_ns: int, grid_ns: int) -> float:
        """Seconds by which the SYNC of the tick with grid point ``grid_ns`` was late (negative: early)."""
        offset = (synced_ns - grid_ns) * 1e-9
        if not 0.0 <= offset <= self._most:  # no SYNC in that tick, or an overrun: nothing is known
            return 0.0
        if self._mean is None:
            self._mean = offset
        late = offset - self._mean
        self._mean += late / MEAN_TICKS
        return late
