"""The recorded runs that a command means: of a rig file, of the running daemon, or by a name in place of a file."""

from __future__ import annotations

import os
import pathlib
from typing import TYPE_CHECKING

from rigctl.cli.options import BAD, USAGE, end, load_rig_file

if TYPE_CHECKING:
    from rigctl.recorder.runs import RecordedRun


def files_named(given: pathlib.Path) -> tuple[pathlib.Path, ...]:
    """A file as given, or those of the run that it names; the command ends where there is no such run."""
    from rigctl.recorder.runs import NAME, named

    if not NAME.fullmatch(str(given)) or given.exists():
        return (given,)
    run = named(of_daemon(), str(given))
    if run is None:
        end(USAGE, f"found {str(given)!r}, expected a file, or a run that rigctl runs lists")
    return run.files


def of_rig(file: pathlib.Path) -> list[RecordedRun]:
    """Runs and dumps in the folders of a rig file."""
    from rigctl.recorder.runs import recorded

    settings = load_rig_file(file)
    recordings, trips = settings.kept(settings.recording.folder), settings.kept(settings.audit.trips)
    return recorded(_readable(recordings), _readable(trips), settings.rig, settings.audit_log)


def of_daemon() -> list[RecordedRun]:
    """Those of the daemon that runs on this computer, of the rig in ``RIGCTL_RIG`` where that is set."""
    from rigctl.ipc import runtime_folder
    from rigctl.recorder.runs import recorded

    wanted = os.environ.get("RIGCTL_RIG")
    found = [one for one in runtime_folder.recorded() if "rig" in one and wanted in (None, "", one["rig"])]
    if len(found) != 1:
        many = "no daemon" if not found else f"{len(found)} daemons"
        end(USAGE, f"found {many} on this computer, expected one (or a file, which rigctl runs RIGFILE names)")
    (status,) = found
    folder = (status.get("recording") or {}).get("folder")
    recordings = _readable(pathlib.Path(folder)) if folder else None
    return recorded(
        recordings, _readable(pathlib.Path(status["trips"])), status["rig"], pathlib.Path(status["audit_log"])
    )


def _readable(folder: pathlib.Path) -> pathlib.Path:
    """A folder that this user may read, or that is not there; the command ends where another's is."""
    if not os.access(folder, os.R_OK | os.X_OK) and _is_there(folder):
        end(BAD, f"{folder} cannot be read: it is another user's; as root it can")
    return folder


def _is_there(folder: pathlib.Path) -> bool:
    try:
        return folder.exists()
    except PermissionError:  # of a folder above it
        return True
