"""Time for the loop: an absolute grid on CLOCK_MONOTONIC, and its simulated twin.

Only these functions read a clock. An overrun skips whole periods on the same grid; missed ticks are counted,
never run in a burst.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

WARM_UP_NS = 5_000_000


class Clock(Protocol):
    """The loop's interface to time, in integers of nanoseconds."""

    def now(self) -> int:
        """The time now."""

    def next_tick(self) -> tuple[int, int]:
        """Sleep to the next grid point still ahead; returns (its time, periods skipped before it)."""


class GridClock:
    """CLOCK_MONOTONIC on a grid of ``period_ns``, with an optional busy-wait before each point."""

    def __init__(self, period_ns: int, spin_ns: int = 0) -> None:
        """``spin_ns``: how long before the grid point sleeping ends and polling begins."""
        self._period = period_ns
        self._spin = spin_ns
        self._next = 0

    def now(self) -> int:
        """CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def next_tick(self) -> tuple[int, int]:
        """Sleep to the next grid point; the first call sets the grid."""
        clock, period = time.monotonic_ns, self._period
        now = clock()
        if not self._next:
            self._next = now + WARM_UP_NS - (now + WARM_UP_NS) % period
        point = self._next
        skipped = 0
        if now >= point:
            # A point that has passed within this period is late, not missed: run it now.
            skipped = (now - point) // period
            point += skipped * period
        self._next = point + period
        wake = point - self._spin
        while (now := clock()) < wake:
            time.sleep((wake - now) * 1e-9)
        while clock() < point:
            pass
        return point, skipped


class SimulatedClock:
    """Time that passes only in ``next_tick``: ``advance(t_ns)`` runs the simulated world up to each grid point."""

    def __init__(self, period_ns: int, advance: Callable[[int], None], start_ns: int = 1_000_000_000) -> None:
        self._period = period_ns
        self._advance = advance
        self._now = start_ns

    def now(self) -> int:
        """The last grid point."""
        return self._now

    def next_tick(self) -> tuple[int, int]:
        """Run the world to the next grid point."""
        self._now += self._period
        self._advance(self._now)
        return self._now, 0
