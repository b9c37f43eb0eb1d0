"""cyclictest, at the loop's priority and period, on the loop's processor."""

from __future__ import annotations

import json
import pathlib
import shutil
import subprocess
import tempfile
from typing import Any

import numpy as np

LONGEST_US = 100_000


def measure(period_us: int, seconds: float, *, priority: int, cpu: int | None) -> dict[str, Any] | None:
    """Wake-up lateness: percentiles in us, and the number of wake-ups later than one period.

    None if cyclictest is not installed (Debian package rt-tests) or lacks the rights it needs.
    """
    if shutil.which("cyclictest") is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "cyclictest.json"
        where = [f"--affinity={cpu}"] if cpu is not None else []
        ran = subprocess.run(
            ["cyclictest", "--quiet", "--mlockall", "--threads=1", f"--priority={priority}", f"--interval={period_us}",
             f"--loops={round(seconds * 1e6 / period_us)}", f"--histogram={LONGEST_US}", f"--json={out}", *where],
            check=False, capture_output=True,
        )  # fmt: skip
        if ran.returncode or not out.exists():
            return None
        thread = json.loads(out.read_text())["thread"]["0"]
    late_us = np.array([int(us) for us in thread["histogram"]])
    count = np.array(list(thread["histogram"].values()))
    order = np.argsort(late_us)
    late_us, count = late_us[order], count[order]
    below = np.cumsum(count) / count.sum()
    figures = {
        name: float(late_us[np.searchsorted(below, q)]) for name, q in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999))
    }
    figures["max"] = float(thread["max"])
    return {"lateness_us": figures, "wakeups": int(thread["cycles"]), "late": int(count[late_us > period_us].sum())}


def together(rounds: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of several rounds: the worst of each percentile, but the mean of p99.9, by which the loop is judged."""
    p999 = sum(one["lateness_us"]["p999"] for one in rounds) / len(rounds)
    worst = {name: max(one["lateness_us"][name] for one in rounds) for name in ("p50", "p99", "max")}
    return {
        "lateness_us": worst | {"p999": p999},
        "wakeups": sum(one["wakeups"] for one in rounds),
        "later_than_a_period": sum(one["late"] for one in rounds),
    }
