"""``python -m tests.bench calls``: Python calls a tick by module, in lockstep: the same on every computer."""

from __future__ import annotations

import argparse
import pathlib
import sys
from collections import Counter
from types import FrameType
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.lockstep import Lockstep, lockstep
from hil.scenario.play import bring_to_target, design
from rigctl.config import rig_file
from rigctl.config.settings import RigSettings
from tests.builders import daemons
from tests.builders.paths import ROOT

LOOP = ("rigctl/control", "rigctl/ipc", "rigctl/devices")
TICKS = 500
_SETTLED_S = 1.0


def calls_a_tick(settings: RigSettings, ticks: int = TICKS) -> dict[str, float]:
    """Calls of Python functions a tick while the tension is held, by module of the project.

    The simulated rig, and what drives it tick by tick, are part of it.
    """
    with lockstep(settings, design(settings)) as rig:
        bring_to_target(rig, settings.tension.target_n, _SETTLED_S)
        return {module: count / ticks for module, count in _counted(rig, ticks).items()}


def of_loop(calls: dict[str, float]) -> float:
    """Of those: in control, ipc and devices."""
    return sum(count for module, count in calls.items() if module.startswith(LOOP))


def _counted(rig: Lockstep, ticks: int) -> Counter[str]:
    files: Counter[str] = Counter()

    def count(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            files[frame.f_code.co_filename] += 1

    sys.setprofile(count)
    try:
        rig.run(ticks * rig.settings.loop.period_ns * 1e-9)
    finally:
        sys.setprofile(None)
    modules = {file: pathlib.Path(file) for file in files}
    return Counter({
        path.relative_to(ROOT).as_posix(): files[file] for file, path in modules.items() if path.is_relative_to(ROOT)
        and path.relative_to(ROOT).parts[0] in ("rigctl", "hil")
    })  # fmt: skip


def main(arguments: list[str]) -> int:
    """Print them; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench calls", description=__doc__)
    parser.add_argument("--rig", type=pathlib.Path, default=daemons.PAPER, help="rig file")
    parser.add_argument("--ticks", type=int, default=TICKS)
    given = parser.parse_args(arguments)
    calls = calls_a_tick(rig_file.load(given.rig), given.ticks)
    table = Table("module", "calls a tick")
    for module, count in sorted(calls.items(), key=lambda one: -one[1]):
        table.add_row(module, f"{count:.2f}")
    table.add_row("control, ipc, devices", f"{of_loop(calls):.2f}", style="bold")
    table.add_row("all, with the simulated rig", f"{sum(calls.values()):.2f}", style="bold")
    Console().print(table)
    return 0
