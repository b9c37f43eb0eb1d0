"""The last known stroke, kept across the daemon's restarts in a file beside the ledger.

Only the recorder writes the file, whole or not at all (new file, fsync, rename); the supervisor reads it before it
starts a loop. With an invalid file the stroke is unknown and an operator has to confirm it.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec

from rigctl.config import input_file
from rigctl.config.built_type import built
from rigctl.config.one_line import printable
from rigctl.config.settings import RigSettings
from rigctl.control.homed import LastStroke
from rigctl.ipc import whole_file
from rigctl.ipc.ledger import utc
from rigctl.ipc.record import Flag
from rigctl.ipc.runtime_folder import Runtime

IN_FORCE = "stroke.json"  # in the runtime folder
KEPT_MM = 0.02  # a stroke that differs by less is not written again
_LARGEST_MM = 1e4
_LARGEST_BYTES = 4096


@built
class _StrokeFile(msgspec.Struct, forbid_unknown_fields=True):
    rig: str
    stroke_mm: float
    when: str


def read(settings: RigSettings) -> LastStroke:
    """The file's content; a damaged file gives the reason why the stroke is unknown."""
    path = settings.last_stroke
    try:
        found: _StrokeFile = input_file.decoded(input_file.read(path, largest=_LARGEST_BYTES, links=True), _StrokeFile)
    except FileNotFoundError:
        return LastStroke()
    except OSError as error:
        return LastStroke(None, f"{path.name} cannot be read: {error.strerror}")
    except msgspec.MsgspecError:
        return LastStroke(None, f"{path.name} is damaged")
    if found.rig != settings.rig:
        return LastStroke(None, f"{path.name} is of {printable(found.rig)[:32]}")
    if not abs(found.stroke_mm) <= _LARGEST_MM:
        return LastStroke(None, f"{path.name} is damaged")
    return LastStroke(found.stroke_mm)


def write(settings: RigSettings, stroke_mm: float, wall_ns: int, *, sync: bool = True) -> None:
    """Replace the file. ``sync``: wait until it is on the disk; without it a power cut may leave an older file.

    Raises:
        OSError: the file could not be written and is unchanged.
    """
    data = msgspec.json.encode(_StrokeFile(settings.rig, round(stroke_mm, 4), utc(wall_ns))) + b"\n"
    whole_file.replace(settings.last_stroke, data, mode=0o640, sync=sync)


def of_record(record: Any) -> float | None:
    """A record's stroke, None while it awaits confirmation: it must not replace the stroke it differs from."""
    if record is None or record["drive_quality"] or int(record["flags"]) & Flag.STROKE_UNCONFIRMED:
        return None
    stroke_mm = float(record["stroke_mm"])
    return stroke_mm if math.isfinite(stroke_mm) else None


def in_force(runtime: Runtime) -> LastStroke:
    """The stroke that the supervisor has read."""
    try:
        return msgspec.convert(runtime.read_json(IN_FORCE), LastStroke)
    except (OSError, msgspec.MsgspecError):
        return LastStroke(None, f"{IN_FORCE} cannot be read")
