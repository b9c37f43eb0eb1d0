"""``python -m hil inject``: a fault of the catalogue into the simulated rig that runs."""

from __future__ import annotations

import pathlib
import sys

from hil.cli.files import simulated_rig
from hil.faults import served
from hil.faults.catalogue import CATALOGUE
from hil.faults.judging.standing import hindrance
from hil.scenario.errors import ScenarioError
from rigctl.model.parts import Part


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


def show_list(file: pathlib.Path | None, *, for_this_rig: bool) -> int:
    """Print the faults that can be injected, by the part that each is of.

    Raises:
        ScenarioError: ``for_this_rig`` without a rig file, or bad input.
    """
    rows = [row for row in CATALOGUE if not hindrance(row, served=True)]
    if for_this_rig:
        if file is None:
            raise ScenarioError(["hil: --for-this-rig: found no rig file, expected RIG --list --for-this-rig"])
        rows = served.possible(simulated_rig(file), rows)
    width = max((len(row.id) for row in rows), default=0)
    for part in Part:
        of_part = [row for row in rows if row.part[:1] == (part,)]
        for number, row in enumerate(of_part):
            head = f"{part}:\n" if number == 0 else ""
            sys.stdout.write(f"{head}  {row.id:{width}}  {row.place:6}  {row.what}\n")
    return 0
