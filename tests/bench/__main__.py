"""``python -m tests.bench [--json F] [--seconds S] [--rates R ...]``, ``python -m tests.bench telemetry --help``."""

from __future__ import annotations

import argparse
import contextlib
import json
import pathlib
import sys
import time
from typing import Any

import yaml
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from rigctl import config
from rigctl.demo.lockstep import play_lockstep
from rigctl.report.metrics import PERCENTILES
from tests import daemons
from tests.bench import cyclictest, plant, report, telemetry
from tests.bench.loop import BenchRig, figures

ROUNDS = 3


def measure_rate(rate_hz: int, seconds: float, progress: Progress) -> dict[str, Any]:
    """Loop and cyclictest in turn, so that both see the same machine."""
    loop = yaml.safe_load(daemons.PAPER.read_text())["loop"]
    task = progress.add_task(f"{rate_hz} Hz", total=2 * ROUNDS)
    slices, rounds = [], []
    for _ in range(ROUNDS):
        with contextlib.ExitStack() as stack:
            slices.append(BenchRig(rate_hz, stack).measure(seconds / ROUNDS))
        progress.advance(task)
        if cyclictest.available():
            rounds.append(
                cyclictest.measure(1_000_000 // rate_hz, seconds / ROUNDS, priority=loop["priority"], cpu=loop["cpu"])
            )
        progress.advance(task)
    result: dict[str, Any] = {"loop": figures(slices)}
    if rounds:
        p999 = sum(r["lateness_us"]["p999"] for r in rounds) / len(rounds)
        result["cyclictest"] = {
            "lateness_us": {name: max(r["lateness_us"][name] for r in rounds) for name in ("p50", "p99", "max")}
            | {"p999": p999},
            "wakeups": sum(r["wakeups"] for r in rounds),
            "later_than_a_period": sum(r["late"] for r in rounds),
        }
        result["lateness_p999_ratio"] = result["loop"]["lateness_us"]["p999"] / max(p999, 1.0)
    return result


def measure_lockstep() -> float:
    """Speed of the demo in simulated time, start-up and design included, as a multiple of real time."""
    settings = config.load(daemons.PAPER)
    assert settings.demo is not None
    start = time.monotonic()
    summary = play_lockstep(settings, settings.demo, lambda _moment, _step: None)
    return summary.duration_s / (time.monotonic() - start)


def show(results: dict[str, Any], console: Console) -> None:
    table = Table("Hz", "us", *(f"{name:>6}" for name in PERCENTILES), "missed periods", box=None)
    for rate, result in results["rates"].items():
        loop, other = result["loop"], result.get("cyclictest")
        table.add_row(rate, "loop, work", *_numbers(loop["work_us"]), "")
        table.add_row("", "loop, lateness", *_numbers(loop["lateness_us"]), f"{loop['skipped_ticks']}")
        if other:
            table.add_row("", "cyclictest", *_numbers(other["lateness_us"]), f"{other['later_than_a_period']}")
            table.add_row("", "ratio of p99.9", "", "", f"{result['lateness_p999_ratio']:>6.2f}")
    console.print(table, highlight=False)
    alone = results["plant"]
    console.print(
        f"plant alone, {plant.STEP_US} us steps: {alone['free_x']:.0f} x real time, "
        f"{alone['truth_each_ms_x']:.0f} x with the truth read every ms",
        highlight=False,
    )
    console.print(f"lockstep: {results['lockstep_x']:.1f} x real time", highlight=False)


def _numbers(values: dict[str, float]) -> list[str]:
    return [f"{values[name]:>6.0f}" for name in PERCENTILES]


def main() -> int:
    if sys.argv[1:2] == ["telemetry"]:
        return telemetry.main(sys.argv[2:])
    if sys.argv[1:2] == ["report"]:
        return report.main(sys.argv[2:])
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    parser.add_argument("--seconds", type=float, default=30.0, help="of loop per rate, and as much of cyclictest")
    parser.add_argument("--rates", type=int, nargs="+", default=[1000, 2000, 4000])
    arguments = parser.parse_args()
    console = Console()
    if not cyclictest.available():
        console.print("cyclictest is not installed (Debian package rt-tests): ratios are left out")
    results: dict[str, Any] = {"rates": {}}
    with Progress(console=Console(stderr=True)) as progress:
        for rate in arguments.rates:
            results["rates"][str(rate)] = measure_rate(rate, arguments.seconds, progress)
    results["plant"] = plant.measure()
    results["lockstep_x"] = round(measure_lockstep(), 2)
    show(results, console)
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
