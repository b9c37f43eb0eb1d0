"""``python -m hil paper``: run the study, print it, and write what is asked for."""

from __future__ import annotations

import json as json_codec
import pathlib
import sys

from rich.console import Console

from hil.paper import claims, plots, study, tables
from hil.progress import progress
from hil.scenario.command import check_writable
from hil.scenario.errors import ScenarioError
from rigctl import config


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
    try:
        rig = config.load(rig_file)
    except config.ConfigError as error:
        raise ScenarioError(error.findings) from None
    if rig.simulation is None:
        raise ScenarioError(
            [f"{rig_file}: simulation: found nothing, allowed a section (it says what rig to simulate)"]
        )
    check_writable("--json", json)
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ScenarioError([f"--plots: {folder} cannot be made: {error.strerror}"]) from None
        check_writable("--plots", folder / plots.FIRST)
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
