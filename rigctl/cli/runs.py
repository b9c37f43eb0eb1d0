"""``rigctl runs``: the runs and trip dumps of a rig; and which files a run's name stands for, for other commands."""

from __future__ import annotations

import os
import pathlib
from typing import TYPE_CHECKING, Annotated

import typer

from rigctl.cli.completion import rig_files
from rigctl.cli.options import DONE, USAGE, Json, end, load_rig_file, say, say_json
from rigctl.model import quantity

if TYPE_CHECKING:
    from rigctl.recorder.runs import RecordedRun

File = Annotated[
    pathlib.Path | None,
    typer.Argument(metavar="[FILE]", help="Rig file [the running daemon's].", autocompletion=rig_files),
]


def runs(file: File = None, json: Json = False) -> None:
    """List the runs that are recorded and the trip dumps: number, start, duration, trips, notes.

    report, info, replay and export take such a name in place of a file: last, 12, trip (the newest dump), trip-3.
    """
    found = _of_rig(file) if file is not None else _of_daemon()
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


def files_named(given: pathlib.Path) -> tuple[pathlib.Path, ...]:
    """A file as given, or those of the run that it names; the command ends where there is no such run."""
    from rigctl.recorder.runs import NAME, named

    if not NAME.fullmatch(str(given)) or given.exists():
        return (given,)
    run = named(_of_daemon(), str(given))
    if run is None:
        end(USAGE, f"found {str(given)!r}, expected a file, or a run that rigctl runs lists")
    return run.files


def _of_rig(file: pathlib.Path) -> list[RecordedRun]:
    from rigctl.recorder.runs import recorded

    settings = load_rig_file(file)
    folders = settings.kept(settings.recording.folder), settings.kept(settings.audit.trips)
    return recorded(*folders, settings.rig, settings.audit_log)


def _of_daemon() -> list[RecordedRun]:
    from rigctl.ipc import runtime_folder
    from rigctl.recorder.runs import recorded

    wanted = os.environ.get("RIGCTL_RIG")
    found = [one for one in runtime_folder.recorded() if "rig" in one and wanted in (None, "", one["rig"])]
    if len(found) != 1:
        many = "no daemon" if not found else f"{len(found)} daemons"
        end(USAGE, f"found {many} on this computer, expected one (or a file, which rigctl runs RIGFILE names)")
    (status,) = found
    folder = (status.get("recording") or {}).get("folder")
    recordings = pathlib.Path(folder) if folder else None
    return recorded(recordings, pathlib.Path(status["trips"]), status["rig"], pathlib.Path(status["audit_log"]))


def _duration(seconds: float) -> str:
    minutes, hours = seconds / 60.0, seconds / 3600.0
    return f"{seconds:.0f} s" if seconds < 120 else f"{minutes:.0f} min" if minutes < 120 else f"{hours:.1f} h"
