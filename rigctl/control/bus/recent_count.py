"""How much of something there was lately: ticks skipped, error frames."""

from __future__ import annotations

from collections import deque

MOST_TICKS = 4096  # that are remembered: more than any window has


class RecentCount:
    """``total``: of all that was added. ``count``: of that within the window, at the newest look."""

    def __init__(self, window_ns: int) -> None:
        self._window_ns = window_ns
        self._added: deque[tuple[int, int]] = deque(maxlen=MOST_TICKS)
        self.total = self.count = 0

    def add(self, now_ns: int, number: int) -> None:
        """So many more in this tick; look after it."""
        self._added.append((now_ns, number))
        self.total += number
        self.count += number

    def look(self, now_ns: int) -> None:
        """Forget what is older than the window; it may be left out while ``count`` is 0."""
        added = self._added
        while added and now_ns - added[0][0] > self._window_ns:
            added.popleft()
        self.count = sum(number for _, number in added)
