"""``python -m hil cell``: hold the stated budget of the cell against the truth, print it, write the figures."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence
from typing import Any

from rich.table import Table

from hil.cli.files import check_outputs, publish, simulated_rig
from hil.runs.result_table import console, table, verdict
from hil.scenario.errors import ScenarioError
from hil.studies.cell import coverage
from hil.studies.cell.coverage import STATED, Coverage
from rigctl.cli.progress import progress
from rigctl.config.settings import RigSettings

WIDTH = 110


def run(rig_file: pathlib.Path, cells: int, json: pathlib.Path | None) -> int:
    """Run the study, print it, write the requested file.

    Args:
        rig_file: with the ``simulation`` and ``calibration`` sections.
        cells: number of cells drawn.
        json: file for the figures.

    Returns:
        0 when no stated budget is too small; else 1.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    if rig.calibration is None:
        raise ScenarioError([f"{rig_file}: calibration: found nothing, expected a section (the cell is calibrated)"])
    check_outputs({"--json": json}, [rig_file])
    with progress("cells", cells) as advance:
        found = coverage.study(rig, cells, advance)
    publish(json, document(rig, found), lambda: console(WIDTH).print(_table(rig, found), highlight=False))
    return 0 if all(way.ok for way in found) else 1


def _table(rig: RigSettings, found: Sequence[Coverage]) -> Table:
    target_n = rig.tension.target_n
    title = f"Error of the tension at {target_n:g} N, in N, over {found[0].cells} cells, against the stated budget"
    columns = ("median", "95 % of cells", "largest", "stated (k = 2)", "% of target", "within", "at least", "")
    shown = table("the cell", columns, title)
    for way in found:
        share = 100.0 * way.stated_n / target_n
        shown.add_row(
            way.title, f"{way.median_n:.3f}", f"{way.p95_n:.3f}", f"{way.largest_n:.3f}", f"{way.stated_n:.3f}",
            f"{share:.3f}", str(way.covered), str(way.least), verdict(way.ok, "holds", "TOO SMALL"),
        )  # fmt: skip
    return shown


def document(rig: RigSettings, found: Sequence[Coverage]) -> dict[str, Any]:
    """Everything that is printed, for JSON."""
    return {
        "target_n": rig.tension.target_n,
        "confidence": STATED,
        "ways": [{**way._asdict(), "holds": way.ok} for way in found],
    }
