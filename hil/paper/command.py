"""``python -m hil paper``: run the study, print it, and write what is asked for."""

from __future__ import annotations

import json as json_codec
import pathlib
import sys

from rich.console import Console

from hil.paper import claims, plots, study, tables
from hil.progress import progress
from hil.scenario.command import check_folder, check_writable, simulated_rig
from hil.scenario.errors import ScenarioError


def run(rig_file: pathlib.Path, json: pathlib.Path | None, folder: pathlib.Path | None) -> int:
    """Run the study, print it, write the files asked for.

    Args:
        rig_file: with the ``simulation`` section; springs and moves are the study's own.
        json: where the rows go.
        folder: where a picture per figure goes; made if absent.

    Returns:
        0 when every row agrees, or differs for a reason that is known and printed; else 1.

    Raises:
        ScenarioError: bad input, a rig that cannot be simulated, or a file that cannot be written.
    """
    rig = simulated_rig(rig_file)
    check_writable("--json", json)
    check_folder("--plots", folder, plots.FIRST)
    with progress("the paper's study", study.runs()) as advance:
        found = study.run(rig, lambda name: advance(1.0, f"{name} done"))
    rows = claims.judge(found.passive)
    tables.show(rows, found, Console())
    try:
        if json is not None:
            json.write_text(json_codec.dumps(tables.document(rows, found), indent=2) + "\n", encoding="utf-8")
        for file in plots.save(found, folder) if folder is not None else ():
            sys.stdout.write(f"{file}\n")
    except OSError as error:
        raise ScenarioError([f"{error.filename}: cannot be written: {error.strerror}"]) from None
    return 0 if all(row.explained for row in rows) else 1
