"""Pauses of the computer, which explain a trip: of each processor, and of the two processes that a trip depends on.

``python -m tests.soak.pauses CPU``: a process that sleeps on one processor and prints when it woke up late, until its
input ends. A thread of the soak itself would not do: it also waits for the other threads of its process.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from tests.builders.paths import ROOT

LATE_MS = 50.0
_SLEEP_S = 0.01
_LOOK_S, _FIND_S = 0.05, 1.0


@dataclass(frozen=True)
class Pause:
    """A pause that ended at ``t_ns`` (CLOCK_MONOTONIC), of what and for how long."""

    t_ns: int
    ms: float
    what: str

    def __str__(self) -> str:
        """E.g. ``processor 1 paused for 120 ms``."""
        return f"{self.what} for {self.ms:.0f} ms"


class Pauses:
    """Collects the pauses of every processor, and of processes that wait for one."""

    def __init__(self, pids: Callable[[], dict[str, int]]) -> None:
        """``pids``: names and numbers of the processes to watch, at any time."""
        self.seen: list[Pause] = []
        self._pids, self._over = pids, threading.Event()
        self.sleepers = [
            subprocess.Popen(
                [sys.executable, "-m", "tests.soak.pauses", str(cpu)],
                cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            )
            for cpu in sorted(os.sched_getaffinity(0))
        ]  # fmt: skip
        for sleeper in self.sleepers:
            assert sleeper.stdout is not None
            sleeper.stdout.readline()  # it sleeps
        self._thread = threading.Thread(target=self._watch, name="pauses", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        waited: dict[int, int] = {}
        pids, found_at = self._pids(), time.monotonic()
        while not self._over.wait(_LOOK_S):
            if time.monotonic() - found_at >= _FIND_S:
                pids, found_at = self._pids(), time.monotonic()
            for name, pid in pids.items():
                with contextlib.suppress(OSError, IndexError, ValueError):
                    now = int(pathlib.Path(f"/proc/{pid}/schedstat").read_text().split()[1])
                    ms = (now - waited.get(pid, now)) / 1e6
                    waited[pid] = now
                    if ms >= LATE_MS:
                        self.seen.append(Pause(time.monotonic_ns(), ms, f"{name} waited for a processor"))

    def end(self) -> None:
        """End the processes and take what they saw."""
        self._over.set()
        self._thread.join()
        for sleeper in self.sleepers:
            for line in sleeper.communicate("")[0].splitlines():
                cpu, t_ns, ms = line.split()
                self.seen.append(Pause(int(t_ns), float(ms), f"processor {cpu} paused"))
        self.seen.sort(key=lambda pause: pause.t_ns)


def _sleep_on(cpu: int) -> None:
    os.sched_setaffinity(0, {cpu})
    lines: list[str] = []
    before = time.monotonic_ns()
    sys.stdout.write("sleeping\n")
    sys.stdout.flush()
    ended = False
    while not ended:  # from one wake-up to the next, so that no pause falls between two measurements
        ended = bool(select.select([sys.stdin], [], [], _SLEEP_S)[0])
        now = time.monotonic_ns()
        late_ms, before = (now - before) / 1e6 - 1000.0 * _SLEEP_S, now
        if late_ms >= LATE_MS:
            lines.append(f"{cpu} {now} {late_ms:.1f}\n")
    sys.stdout.writelines(lines)


if __name__ == "__main__":
    _sleep_on(int(sys.argv[1]))
