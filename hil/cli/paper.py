"""``python -m hil paper``: run the study, print it, and write the requested files."""

from __future__ import annotations

import json as json_codec
import pathlib
import sys

from rich.console import Console

from hil.cli.scenario import check_folder, check_outputs, simulated_rig
from hil.paper import claims, plots, study, tables
from rigctl.cli.progress import progress
from rigctl.ipc import output_file


def run(rig_file: pathlib.Path, json: pathlib.Path | None, folder: pathlib.Path | None) -> int:
    """Run the study, print it, write the requested files.

    Args:
        rig_file: with the ``simulation`` section; springs and moves are the study's own.
        json: file for the rows.
        folder: folder for one plot per figure; made if absent.

    Returns:
        0 when every row agrees, or differs for a known reason, which is printed; else 1.

    Raises:
        ScenarioError: bad input, or a rig that cannot be simulated.
        OutputError: a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    check_outputs({"--json": json}, [rig_file])
    check_folder("--plots", folder, plots.FIRST)
    with progress("the paper's study", study.runs()) as advance:
        found = study.run(rig, lambda name: advance(1.0, f"{name} done"))
    rows = claims.judge(found.passive)
    tables.show(rows, found, Console())
    if json is not None:
        output_file.write(json, json_codec.dumps(tables.document(rows, found), indent=2) + "\n")
    for file in plots.save(found, folder) if folder is not None else ():
        sys.stdout.write(f"{file}\n")
    return 0 if all(row.explained for row in rows) else 1
