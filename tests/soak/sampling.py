"""Memory, descriptors and pids of the daemon's processes over time, and every record of the loop."""

from __future__ import annotations

import contextlib
import pathlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from rigctl.ipc.ring import RingReader


@dataclass
class Life:
    """One process from its start to its end: name, pid, and samples (s, private memory in MiB, descriptors)."""

    name: str
    pid: int
    samples: list[tuple[float, float, int]] = field(default_factory=list)

    @property
    def table(self) -> npt.NDArray[np.float64]:
        """Samples, shape (count, 3)."""
        return np.array(self.samples, float).reshape(-1, 3)


class Processes:
    """Samples of a daemon's processes; shared memory, which the rings fill by design, is not counted."""

    def __init__(self, pids: Callable[[], dict[str, int]]) -> None:
        """``pids``: the processes that run now, by name."""
        self._pids = pids
        self.lives: list[Life] = []
        self._now: dict[str, Life] = {}

    def sample(self, at_s: float) -> None:
        """Take a sample of every process."""
        pids = self._pids()
        for name, pid in pids.items():
            life = self._now.get(name)
            if life is None or life.pid != pid:
                life = self._now[name] = Life(name, pid)
                self.lives.append(life)
            with contextlib.suppress(OSError, TypeError):
                status = pathlib.Path(f"/proc/{pid}/status").read_text()
                private = re.search(r"RssAnon:\s+(\d+) kB", status)
                count = len(list(pathlib.Path(f"/proc/{pid}/fd").iterdir()))
                if private is not None:
                    life.samples.append((at_s, int(private[1]) / 1024.0, count))


class Lateness:
    """Lateness of every tick in us, as a histogram for each kind of time; 1 % resolution."""

    EDGES = np.geomspace(1.0, 1e7, 1621)

    def __init__(self, records: RingReader) -> None:
        self._records = records
        self._counts = {kind: np.zeros(len(self.EDGES) - 1, np.int64) for kind in ("alone", "busy")}
        self._worst = dict.fromkeys(self._counts, 0.0)
        self.records = self.gaps = 0
        self._last: int | None = None

    def follow(self, kind: str) -> None:
        """Read the new records, and count them as ``kind``; a record that the ring no longer held is a gap."""
        slots = self._records.read()
        if not len(slots):
            return
        seq = slots["seq"].astype(np.int64)
        steps = np.diff(seq) if self._last is None else np.diff(seq, prepend=self._last)
        self.gaps += int((steps - 1).clip(0).sum())
        self._last = int(seq[-1])
        self.records += len(slots)
        late_us = slots["lateness_ns"] / 1e3
        self._counts[kind] += np.histogram(late_us.clip(self.EDGES[0], self.EDGES[-1] * 0.999), self.EDGES)[0]
        self._worst[kind] = max(self._worst[kind], float(late_us.max()))

    def figures(self) -> dict[str, dict[str, float]]:
        """Percentiles in us by kind."""
        found = {}
        for kind, counts in self._counts.items():
            total, cumulated = int(counts.sum()), np.cumsum(counts)
            at = {name: int(np.searchsorted(cumulated, share * total)) for name, share in _SHARES.items()}
            found[kind] = {
                "ticks": total,
                **{name: round(float(self.EDGES[index + 1]), 1) if total else 0.0 for name, index in at.items()},
                "worst_us": round(self._worst[kind], 1),
            }
        return found


_SHARES = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999}
