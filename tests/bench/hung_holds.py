"""``rigctl hold`` with each other process of the daemon stopped (SIGSTOP), one by one and all.

Each command is a process of its own, timed from its start to its end, in turn with a bare interpreter (``python -c
pass``): both wait for the same computer. A HOLD is lost if the command fails or the loop's record does not show it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from rigctl.ipc.runtime_folder import Runtime
from tests.builders import daemons
from tests.builders.paths import ROOT

FACTOR = 3.0
MODULES = {
    "supervisor": ("rigctl", "run"), "gateway": ("rigctl.gateway.gateway_process",), "recorder": ("rigctl.recorder",),
    "page": ("rigctl.page",),
}  # fmt: skip
CONDITIONS: dict[str, tuple[str, ...]] = {"none": (), **{name: (name,) for name in MODULES}, "all": tuple(MODULES)}
TURNS = 10  # holds while a process is stopped: fewer than 5 s of them, after which it is replaced


def _pids(names: Sequence[str], rig: str, file: str) -> list[int]:
    found = []
    for name in names:
        words = (*MODULES[name], file) if name == "supervisor" else (*MODULES[name], f"rigctl-{rig}")
        found.append(daemons.process_with(*words))
    return found


@contextlib.contextmanager
def _stopped(pids: Sequence[int]) -> Iterator[None]:
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


def _timed_ms(words: Sequence[str], environment: dict[str, str]) -> tuple[float, int]:
    start = time.monotonic_ns()
    done = subprocess.run([sys.executable, *words], cwd=ROOT, env=environment, capture_output=True, check=False)
    return (time.monotonic_ns() - start) / 1e6, done.returncode


def measure(file: Any, count: int) -> list[dict[str, Any]]:
    """One row for each condition."""
    rig, environment = daemons.name_of(file), daemons.environment(file)
    records = Runtime.of(rig).records.reader()
    hold = ("-m", "rigctl", "hold", "--connect", daemons.endpoint(file), "--rig", rig)

    def taken() -> int:
        record = records.latest()
        return int(record["hold_seq"]) if record is not None else 0

    rows = []
    for condition, names in CONDITIONS.items():
        bare, held, lost = list[float](), list[float](), 0
        while len(held) + lost < count:
            with _stopped(_pids(names, rig, str(file))):
                for _ in range(min(TURNS, count - len(held) - lost)):
                    bare.append(_timed_ms(("-c", "pass"), environment)[0])
                    before = taken()
                    ms, code = _timed_ms(hold, environment)
                    if code or taken() <= before:
                        lost += 1
                    else:
                        held.append(ms)
            time.sleep(0.5)
        p50, p99 = np.percentile(held, (50, 99)).tolist() if held else (float("nan"),) * 2
        bare_p50, bare_p99 = np.percentile(bare, (50, 99)).tolist()
        rows.append({"stopped": condition, "given": count, "lost": lost, "p50_ms": round(p50, 1),
                     "p99_ms": round(p99, 1), "bare_p50_ms": round(bare_p50, 1), "bare_p99_ms": round(bare_p99, 1),
                     "met": lost == 0 and p99 <= FACTOR * bare_p99})  # fmt: skip
        print(f"{condition} stopped: p99 {p99:.0f} ms, bare {bare_p99:.0f} ms, {lost} lost", file=sys.stderr)
    return rows


def show(rows: list[dict[str, Any]], console: Console) -> None:
    table = Table("stopped", "holds", "lost", "p50 ms", "p99 ms", "bare p50", "bare p99", "", box=None)
    for row in rows:
        figures = (str(row[name]) for name in ("given", "lost", "p50_ms", "p99_ms", "bare_p50_ms", "bare_p99_ms"))
        table.add_row(row["stopped"], *figures, "met" if row["met"] else "NOT MET")
    console.print(table, highlight=False)
    console.print(f"limits: 0 lost; p99 at most {FACTOR:g} x the p99 of a bare interpreter's start", highlight=False)
