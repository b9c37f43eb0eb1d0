"""``python -m tests.bench terminal``: from a cold shell to the loop's record of HOLD, and to the end of ``--help``.

Each command is a shell of its own that starts ``rigctl``, as an operator's does, against the real daemon on the
simulated rig, armed. HOLD ends at the tick whose record shows it; the others when the shell ends. The measuring process
has the usual priority, since an operator's terminal has it too.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import shlex
import subprocess
import sys
import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tests.bench.holds import Subject, subject

LIMITS_MS: dict[str, tuple[float, float]] = {"hold": (300.0, 600.0), "--help": (150.0, float("inf"))}
"""p50 and p99 that are promised."""
PROGRAM = pathlib.Path(sys.executable).with_name("rigctl")
PAUSE_S = 0.05


def taken_ms(words: str) -> tuple[float, str]:
    """Milliseconds until the shell has ended, and what it printed; a command that fails ends the measurement."""
    start = time.monotonic_ns()
    done = subprocess.run(
        ["/bin/sh", "-c", f"{shlex.quote(str(PROGRAM))} {words}"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    passed = (time.monotonic_ns() - start) / 1e6
    if done.returncode:
        raise RuntimeError(f"rigctl {words}: {done.stderr}")
    return passed, done.stdout


def hold_ms(rig: Subject) -> float:
    """Milliseconds until the tick that carried out a HOLD from a shell."""
    start = time.monotonic_ns()
    _, said = taken_ms(f"hold --json --connect {rig.endpoint} --rig {rig.rig} --operator kim")
    return float((json.loads(said)["t_ns"] - start) / 1e6)


def measure(rig: Subject, count: int) -> dict[str, dict[str, Any]]:
    """p50, p99 and largest of ``count`` starts of each command, alternating."""
    found: dict[str, list[float]] = {"hold": [], "--help": [], "status": []}
    for _ in range(count):
        found["hold"].append(hold_ms(rig))
        found["--help"].append(taken_ms("--help")[0])
        found["status"].append(taken_ms(f"status --connect {rig.endpoint} --rig {rig.rig}")[0])
        time.sleep(PAUSE_S)
    return {name: _row(name, ms) for name, ms in found.items()}


def _row(name: str, ms: list[float]) -> dict[str, Any]:
    p50, p99 = np.percentile(ms, (50, 99)).tolist()
    limits = LIMITS_MS.get(name)
    met = limits is None or (p50 <= limits[0] and p99 <= limits[1])
    return {
        "starts": len(ms),
        "p50_ms": round(p50, 1),
        "p99_ms": round(p99, 1),
        "max_ms": round(max(ms), 1),
        "met": met,
    }


def show(rows: dict[str, dict[str, Any]], console: Console) -> None:
    table = Table("rigctl", "starts", "p50 ms", "p99 ms", "max ms", "promised", "", box=None)
    for name, row in rows.items():
        limits = LIMITS_MS.get(name)
        promised = "-" if limits is None else " / ".join(f"{limit:g}" for limit in limits if limit != float("inf"))
        figures = (str(row[key]) for key in ("starts", "p50_ms", "p99_ms", "max_ms"))
        table.add_row(name, *figures, promised, "met" if row["met"] else "NOT MET")
    console.print(table, highlight=False)


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench terminal", description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="starts of each command")
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    arguments = parser.parse_args(words)
    with subject() as rig:
        rows = measure(rig, arguments.count)
    show(rows, Console(width=100))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")
    return 0 if all(row["met"] for row in rows.values()) else 1
