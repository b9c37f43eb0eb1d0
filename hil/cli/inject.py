"""``python -m hil inject``: a fault of the catalogue into the simulated rig that runs."""

from __future__ import annotations

import pathlib
import sys

from hil.cli.files import simulated_rig
from hil.faults import served
from hil.faults.catalogue import CATALOGUE
from hil.faults.judging.standing import hindrance
from hil.scenario.errors import ScenarioError


def run(file: pathlib.Path | None, fault: str | None, for_s: float | None, *, end: bool) -> int:
    """Ask the served rig; returns 0 if it was done, else 1.

    Raises:
        ScenarioError: wrong usage, bad input, or no rig is served.
    """
    if file is None or (fault is None) != end:
        raise ScenarioError(["hil: expected RIG FAULT, RIG --end or --list (see python -m hil inject --help)"])
    if end and for_s is not None:
        raise ScenarioError(["--for: found it beside --end, expected a fault to inject"])
    answer = served.ask(simulated_rig(file), fault, for_s)
    (sys.stdout if answer.done else sys.stderr).write(f"{answer.text}\n")
    return 0 if answer.done else 1


def show_list() -> int:
    """Print the faults that can be injected."""
    rows = [row for row in CATALOGUE if not hindrance(row, served=True)]
    width = max(len(row.id) for row in rows)
    for row in rows:
        sys.stdout.write(f"{row.id:{width}}  {row.place:6}  {row.what}\n")
    return 0
