"""A smoke test, which runs real processes, is repeated where it fails; each repeat is named at the end of the gate.

The smoke tests run before all others. What they repeated is added to the file named by ``SMOKE_SUMMARY``, by whichever
worker runs the test, so that the run after them, whose closing line is the gate's last, prints it above that line.
"""

from __future__ import annotations

import os
import pathlib

import pytest

REPEATS = 2
SUMMARY = "SMOKE_SUMMARY"
_OUTCOMES = pytest.StashKey[list[str]]()


def _kept() -> pathlib.Path | None:
    """The file of what smoke tests repeated; None in a run that keeps none."""
    name = os.environ.get(SUMMARY)
    return pathlib.Path(name) if name else None


def repeatable(item: pytest.Item, reports: list[pytest.TestReport], runs: int) -> bool:
    """Whether a smoke test that has failed ``runs`` times is repeated; notes it, and ends what its fixtures started."""
    if item.get_closest_marker("smoke") is None:
        return False
    again = runs <= REPEATS
    crash = next(getattr(report.longrepr, "reprcrash", None) for report in reports if report.failed)
    why = crash.message.partition("\n")[0][:120] if crash is not None else "no place of its failure is known"
    outcome = f"run {runs} failed, {'repeated' if again else 'the last'}: {why}"
    if (kept := _kept()) is None:
        item.config.stash.setdefault(_OUTCOMES, []).append(f"{item.nodeid}: {outcome}")
    else:
        with kept.open("a") as file:
            file.write(f"{item.nodeid}: {outcome}\n")
    if again:
        item.session._setupstate.teardown_exact(None)
    return again


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print what was repeated in this run, else in the smoke tests before it."""
    outcomes = config.stash.get(_OUTCOMES, [])
    if (kept := _kept()) is not None and kept.exists():
        outcomes = kept.read_text().splitlines()
    if outcomes:
        terminalreporter.section("smoke tests that failed")
        for line in outcomes:
            terminalreporter.write_line(line)
