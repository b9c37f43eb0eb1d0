"""Lateness of every tick as a histogram with logarithmic classes, and the missed deadlines, of the last hour."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.page.history import WINDOWS_S, Ids

PER_DECADE = 8
DECADES = 5  # 1 us to 100 ms; values beyond count in the first or the last class
EDGES_US = 10.0 ** (np.arange(PER_DECADE * DECADES + 1) / PER_DECADE)
_SECOND_NS = 1_000_000_000
_SECONDS = WINDOWS_S[-1]


class Lateness:
    """A row of counts for every second of the last hour."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._counts = np.zeros((_SECONDS, len(EDGES_US) - 1), np.uint16)
        self._missed = np.zeros(_SECONDS, np.int64)
        self._worst_ns = np.zeros(_SECONDS, np.int64)
        self._newest = -1
        self._skipped: int | None = None

    def add(self, wall_ns: Ids, records: npt.NDArray[Any]) -> None:
        """Add records of the fast stream at ``wall_ns``, ascending; at most 65535 of one second are counted."""
        if not len(wall_ns):
            return
        seconds = wall_ns // _SECOND_NS
        if seconds[0] < self._newest - 1:
            self.reset()
        classes = np.searchsorted(EDGES_US[1:-1], records["lateness_ns"] / 1000.0, side="right")
        missed = self._missed_in(records)
        for second in np.unique(seconds).tolist():
            self._open(second)
            slot, here = second % _SECONDS, seconds == second
            counts = self._counts[slot] + np.bincount(classes[here], minlength=len(EDGES_US) - 1)
            self._counts[slot] = np.minimum(counts, 65535)
            self._missed[slot] += missed[here].sum()
            self._worst_ns[slot] = max(int(self._worst_ns[slot]), int(records["lateness_ns"][here].max()))

    def _missed_in(self, records: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """Ticks skipped since the record before; the counter of a new loop starts at 0."""
        skipped = records["skipped"].astype(np.int64)
        before = skipped[0] if self._skipped is None else self._skipped
        missed = np.diff(skipped, prepend=before)
        self._skipped = int(skipped[-1])
        return np.where(missed < 0, skipped, missed)

    def _open(self, second: int) -> None:
        fresh = min(second - self._newest, _SECONDS)
        if fresh > 0:
            slots = np.arange(second - fresh + 1, second + 1) % _SECONDS
            self._counts[slots] = 0
            self._missed[slots] = self._worst_ns[slots] = 0
            self._newest = second

    def window(self, seconds: int) -> dict[str, Any]:
        """Counts by class, ticks, missed deadlines and the worst lateness in us of the last ``seconds``."""
        slots = np.arange(self._newest - min(seconds, _SECONDS) + 1, self._newest + 1) % _SECONDS
        counts = self._counts[slots].sum(axis=0, dtype=np.int64)
        return {
            "counts": counts.tolist(),
            "ticks": int(counts.sum()),
            "missed": int(self._missed[slots].sum()),
            "worst_us": round(int(self._worst_ns[slots].max()) / 1000.0, 1),
        }
