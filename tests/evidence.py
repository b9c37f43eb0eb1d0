"""``python -m tests.evidence``: every test that is evidence rather than the gate, to the end, with a table of outcomes.

A run of tests that fails does not keep the next from being made. A test that failed while the host paused the loop, and
passed when it was repeated (`tests.builders.host_pause`), is listed with the pause that the loop measured.
"""

from __future__ import annotations

import argparse
import pathlib
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree

from rich.console import Console
from rich.table import Table

from tests.builders.host_pause import PAUSED_MS
from tests.builders.paths import ROOT

REAL_TIME = ("tests/guest", "tests/live", "tests/loop/test_pytest_plugin.py")
TOGETHER = ("--numprocesses", "auto", "--dist", "loadfile", "--no-loadscope-reorder")
RUNS: dict[str, tuple[str, ...]] = {
    "studies": (
        "tests/studies", "tests/loop", "tests/live", "tests/unit", "tests/plant",
        "-m", "study and not real_time and not smoke and not long", *TOGETHER,
    ),
    "real time": (
        *REAL_TIME, "-m", "real_time and not alone and not smoke and not machine and not long", *TOGETHER,
    ),
    "alone": (*REAL_TIME, "-m", "alone and not smoke and not machine and not long"),
}  # fmt: skip
"""pytest's arguments of each run, in this order."""
NO_TESTS = 5
"""pytest's exit code of a run that selected none."""


@dataclass
class Outcomes:
    """What became of the tests of a run. ``repeated``: longest pause in ms, of tests that then passed."""

    passed: int = 0
    skipped: int = 0
    failed: list[str] = field(default_factory=list)
    repeated: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    complete: bool = True

    @classmethod
    def read(cls, report: pathlib.Path) -> Outcomes:
        """From pytest's JUnit XML; a run that wrote none has not come to its end."""
        if not report.exists():
            return cls(complete=False)
        outcomes = cls()
        root = ElementTree.parse(report).getroot()
        for case in root.iter("testcase"):
            name = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"
            paused = [int(float(p.get("value", "0"))) for p in case.iter("property") if p.get("name") == PAUSED_MS]
            if case.find("failure") is not None or case.find("error") is not None:
                outcomes.failed.append(name)
            elif case.find("skipped") is not None:
                outcomes.skipped += 1
            else:
                outcomes.passed += 1
                if paused:
                    outcomes.repeated[name] = max(paused)
        outcomes.seconds = sum(float(suite.get("time", "0")) for suite in root.iter("testsuite"))
        return outcomes


def run(name: str, arguments: Sequence[str], folder: pathlib.Path) -> Outcomes:
    """Make one run of pytest, whose output passes through."""
    report = folder / f"{name.replace(' ', '-')}.xml"
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", *arguments, f"--junitxml={report}"]
    code = subprocess.run(command, cwd=ROOT, check=False).returncode
    outcomes = Outcomes.read(report)
    outcomes.complete = outcomes.complete and code in (0, 1, NO_TESTS)
    return outcomes


def show(found: dict[str, Outcomes]) -> None:
    """Print the closing table, and below it each test that failed or was repeated."""
    console = Console(width=None if sys.stdout.isatty() else 120)
    table = Table(box=None)
    for title in ("run", "passed", "failed", "failed once, passed again", "skipped", "s"):
        table.add_column(title, justify="left" if title == "run" else "right")
    for name, run_ in found.items():
        once = len(run_.repeated)
        cells = (run_.passed - once, len(run_.failed), once, run_.skipped, round(run_.seconds))
        table.add_row(name if run_.complete else f"{name}: not to its end", *map(str, cells))
    console.print(table)
    for run_ in found.values():
        for test in run_.failed:
            console.print(f"failed: {test}", soft_wrap=True, highlight=False)
        for test, paused_ms in run_.repeated.items():
            line = f"failed once, passed again: {test}: the host paused its loop for {paused_ms} ms"
            console.print(line, soft_wrap=True, highlight=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the runs; 0: every test passed."""
    parser = argparse.ArgumentParser(prog="python -m tests.evidence", description=__doc__)
    parser.add_argument("--only", action="append", choices=RUNS, help="one of the runs; may be repeated")
    parser.add_argument("--tests", nargs="*", default=[], metavar="PATH", help="instead of the runs' own folders")
    chosen = parser.parse_args(arguments)
    folder = ROOT / "results/evidence"
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, Outcomes] = {}
    for name, words in RUNS.items():
        if not chosen.only or name in chosen.only:
            options = words[words.index("-m") :] if chosen.tests else words
            found[name] = run(name, (*chosen.tests, *options), folder)
    show(found)
    return int(any(outcomes.failed or not outcomes.complete for outcomes in found.values()))


if __name__ == "__main__":
    sys.exit(main())
