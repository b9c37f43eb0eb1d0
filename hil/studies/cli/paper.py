"""``python -m hil paper``: run the study, print it, and write the requested files."""

from __future__ import annotations

import pathlib

from rich.console import Console

from hil.cli.files import check_folder, check_outputs, publish, say, simulated_rig
from hil.studies.paper import claim_tables, claims, paper_figures, paper_study
from rigctl.cli.progress import progress


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
    check_folder("--plots", folder, paper_figures.FIRST)
    with progress("the paper's study", paper_study.runs()) as advance:
        found = paper_study.run(rig, advance)
    rows = claims.judge(found.passive)
    publish(json, claim_tables.document(rows, found), lambda: claim_tables.show(rows, found, Console()))
    for file in paper_figures.save(found, folder) if folder is not None else ():
        say(json, f"{file}")
    return 0 if all(row.explained for row in rows) else 1
