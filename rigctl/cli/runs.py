"""``rigctl runs``: the runs and trip dumps of a rig."""

from __future__ import annotations

import pathlib
from typing import Annotated

import typer

from rigctl.cli.completion import rig_files
from rigctl.cli.options import DONE, Json, end, say, say_json
from rigctl.cli.recorded_runs import of_daemon, of_rig
from rigctl.model import quantity

File = Annotated[
    pathlib.Path | None,
    typer.Argument(metavar="[FILE]", help="Rig file [the running daemon's].", autocompletion=rig_files),
]


def runs(file: File = None, json: Json = False) -> None:
    """List the runs that are recorded and the trip dumps: number, start, duration, trips, notes.

    report, info, replay and export take such a name in place of a file: last, 12, trip (the newest dump), trip-3.
    """
    found = of_rig(file) if file is not None else of_daemon()
    if json:
        say_json([run.as_dict() for run in found])
    for run in [] if json else found:
        words = f"{quantity.count(len(run.files), 'part')}, {run.size / 1e6:.1f} MB" if not run.fault else "dump"
        began = f"{run.began.astimezone():%Y-%m-%d %H:%M:%S}"
        say(f"{run.name or '-':>9}  {began}  {_duration(run.duration_s):>10}  {words:>18}  {run.outcome}")
        for words in run.notes:
            say(f"{'':>11}{words}")
    if not (found or json):
        say("nothing is recorded")
    end(DONE)


def _duration(seconds: float) -> str:
    minutes, hours = seconds / 60.0, seconds / 3600.0
    return f"{seconds:.0f} s" if seconds < 120 else f"{minutes:.0f} min" if minutes < 120 else f"{hours:.1f} h"
