"""``python -m tests.bench report``: time and size of the report of a long recording."""

from __future__ import annotations

import argparse
import json
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np

from rigctl.model.states import Mode
from tests.builders import synthetic
from tests.builders.paths import ROOT


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench report", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="of recording at 1 kHz, frames included")
    parser.add_argument("--recording", type=pathlib.Path, help="instead of one that is made up")
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        file = options.recording or _made_up(pathlib.Path(folder) / "recording.mcap", options.minutes * 60.0)
        page = pathlib.Path(folder) / "report.html"
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        start = time.monotonic()
        command = [sys.executable, "-m", "rigctl", "report", str(file.resolve()), "-o", str(page), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        passed_s = time.monotonic() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if not page.exists():
            sys.stderr.write(done.stderr)
            return 1
        figures = {
            "recording_s": round(json.loads(done.stdout)["duration_s"], 1),
            "recording_mb": round(file.stat().st_size / 1e6, 1),
            "seconds": round(passed_s, 1),
            "cpu_s": round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1),
            "memory_mb": round(after.ru_maxrss / 1024, 0),
            "page_mb": round(page.stat().st_size / 1e6, 2),
        }
    for name, value in figures.items():
        print(f"{name:14} {value:g}")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


def _made_up(file: pathlib.Path, seconds: float) -> pathlib.Path:
    """A recording of noise and a slow sine, in which every drawn signal varies."""
    random = np.random.default_rng(6)

    def error(t_s: synthetic.Floats) -> synthetic.Floats:
        return 0.02 * np.sin(2 * np.pi * 0.37 * t_s) + random.normal(0.0, 0.03, len(t_s))

    records = synthetic.run(
        synthetic.stay(Mode.HOLD, 5.0), synthetic.stay(Mode.COMPENSATING, seconds - 10.0, error),
        synthetic.stay(Mode.HOLD, 5.0),
    )  # fmt: skip
    t_s = np.arange(len(records)) / synthetic.RATE_HZ
    for name, size in (("tangential_rad", 0.012), ("normal_rad", 0.001), ("stroke_mm", 0.2), ("speed_mm_s", 0.1)):
        records[name] += size * np.sin(2 * np.pi * t_s / 60.0) + random.normal(0.0, size / 50, len(t_s))
    records["command_mm_s"] = records["speed_mm_s"] + random.normal(0.0, 0.4, len(t_s))
    records["lateness_ns"] = random.lognormal(9.0, 1.0, len(t_s))
    records["work_ns"] = random.lognormal(11.9, 0.2, len(t_s))
    for name in ("estimate_n", "innovation_n", "disturbance_mm_s", "integral_mm_s", "reading_n"):
        records[name] = random.normal(0.0, 0.03, len(t_s))
    return synthetic.write(file, records, with_frames=True)
