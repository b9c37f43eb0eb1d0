"""``python -m tests.bench [--json F] [--seconds S] [--rates R ...]``;
``access|bridge|calls|holds|margins|peaks|report|telemetry|terminal --help``."""

from __future__ import annotations

import argparse
import json
import pathlib
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

from rich.console import Console

from rigctl.bench.loop import RateResult, measure
from rigctl.cli import bench
from rigctl.cli.progress import progress
from rigctl.config import rig_file as config
from rigctl.demo.lockstep import play_lockstep
from rigctl.ipc.termination import on_signals
from tests.bench import access, bridge, calls, holds, margins, peaks, plant, report, sensors, telemetry, terminal
from tests.builders import daemons

FIGURES: dict[str, Callable[[list[str]], int]] = {
    "access": access.main,
    "bridge": bridge.main,
    "calls": calls.main,
    "holds": holds.main,
    "margins": margins.main,
    "peaks": peaks.main,
    "report": report.main,
    "sensors": sensors.main,
    "telemetry": telemetry.main,
    "terminal": terminal.main,
}


def measure_lockstep() -> float:
    """Speed of the demo in simulated time, start-up and design included, as a multiple of real time."""
    settings = config.load(daemons.PAPER)
    assert settings.demo is not None
    start = time.monotonic()
    summary = play_lockstep(settings, settings.demo, lambda _moment, _step: None)
    return summary.duration_s / (time.monotonic() - start)


def show(measured: list[RateResult], results: dict[str, Any], console: Console) -> None:
    bench.show(measured, console)
    alone = results["plant"]
    console.print(
        f"plant alone, {plant.STEP_US} us steps: {alone['free_x']:.0f} x real time, "
        f"{alone['truth_each_ms_x']:.0f} x with the truth read every ms",
        highlight=False,
    )
    console.print(f"lockstep: {results['lockstep_x']:.1f} x real time", highlight=False)


def main() -> int:
    on_signals(signal.default_int_handler, signal.SIGTERM, signal.SIGHUP)  # ends the child processes as Ctrl-C does
    if sys.argv[1:2] and (figure := FIGURES.get(sys.argv[1])) is not None:
        return figure(sys.argv[2:])
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, help="write the figures here")
    parser.add_argument("--seconds", type=float, default=30.0, help="of loop per rate, and as much of cyclictest")
    parser.add_argument("--rates", type=int, nargs="+", default=[1000, 2000, 4000])
    arguments = parser.parse_args()
    settings = config.load(daemons.PAPER)
    with progress("bench", 2.0 * arguments.seconds * len(arguments.rates)) as advance:
        measured = [measure(settings, rate, arguments.seconds, advance) for rate in arguments.rates]
    results: dict[str, Any] = {"rates": {str(one.rate_hz): one.as_dict() for one in measured}}
    results["plant"] = plant.measure()
    results["lockstep_x"] = round(measure_lockstep(), 2)
    show(measured, results, Console())
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
