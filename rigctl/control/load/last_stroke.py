"""The last known stroke, and whether the brake is known not to hold: kept across the daemon's restarts in one file.

The file is beside the ledger, and is written whole or not at all (new file, fsync, rename): by the recorder, and by the
supervisor where there is no recorder. The supervisor reads it before it starts a loop. With an invalid file the stroke
is unknown and an operator has to confirm it, and the brake counts as one that does not hold until it is tested.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import msgspec

from rigctl.config import input_file
from rigctl.config.built_type import built
from rigctl.config.one_line import printable
from rigctl.config.settings import RigSettings
from rigctl.control.load.brake_flag import KeptBrake
from rigctl.control.load.homed import LastStroke
from rigctl.ipc import whole_file
from rigctl.ipc.ledger import utc
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Flag

IN_FORCE = "stroke.json"  # in the runtime folder
KEPT_MM, KEPT_N = 0.02, 1.0  # a stroke, or a load of a slip, that differs by less is not written again
_LARGEST_MM, _LARGEST_N = 1e4, 1e6
_LARGEST_BYTES = 4096


@built
@dataclass(frozen=True)
class KeptValues:
    """What a loop takes over from the one before it."""

    stroke: LastStroke
    brake: KeptBrake


@built
class _StrokeFile(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """Without the flag it is the file of a version that keeps none; such a version refuses a file with the flag."""

    rig: str
    stroke_mm: float | None
    when: str
    brake_fails: bool = False
    slipped_n: float | None = None

    @property
    def is_credible(self) -> bool:
        """Values that `write` writes."""
        load_n = self.slipped_n
        if load_n is not None and not (self.brake_fails and 0.0 <= load_n <= _LARGEST_N):
            return False
        return self.stroke_mm is None or abs(self.stroke_mm) <= _LARGEST_MM


def read(settings: RigSettings) -> KeptValues:
    """The file's content; a damaged file gives the reason why stroke and brake are unknown."""
    path = settings.last_stroke
    try:
        found: _StrokeFile = input_file.decoded(input_file.read(path, largest=_LARGEST_BYTES, links=True), _StrokeFile)
    except FileNotFoundError:
        return KeptValues(LastStroke(), KeptBrake())
    except OSError as error:
        return _unknown(f"{path.name} cannot be read: {error.strerror}")
    except msgspec.MsgspecError:
        return _unknown(f"{path.name} is damaged")
    if found.rig != settings.rig:
        return _unknown(f"{path.name} is of {printable(found.rig)[:32]}")
    if not found.is_credible:
        return _unknown(f"{path.name} is damaged")
    stroke = LastStroke(found.stroke_mm, "" if found.stroke_mm is not None else f"{path.name} has no stroke")
    return KeptValues(stroke, KeptBrake(found.brake_fails, found.slipped_n))


def _unknown(why: str) -> KeptValues:
    return KeptValues(LastStroke(None, why), KeptBrake(fails=True, why=why))


def write(settings: RigSettings, kept: KeptValues, wall_ns: int, *, sync: bool = True) -> None:
    """Replace the file. ``sync``: wait until it is on the disk; without it a power cut may leave an older file.

    Raises:
        OSError: the file could not be written and is unchanged.
    """
    mm, load_n = kept.stroke.mm, kept.brake.slipped_n
    content = _StrokeFile(
        settings.rig,
        None if mm is None else round(mm, 4),
        utc(wall_ns),
        kept.brake.fails,
        None if load_n is None else round(load_n, 1),
    )
    whole_file.replace(settings.last_stroke, msgspec.json.encode(content) + b"\n", mode=0o640, sync=sync)


def of_record(record: Any) -> float | None:
    """A record's stroke, None while it awaits confirmation: it must not replace the stroke it differs from."""
    if record is None or record["drive_quality"] or int(record["flags"]) & Flag.STROKE_UNCONFIRMED:
        return None
    stroke_mm = float(record["stroke_mm"])
    return stroke_mm if math.isfinite(stroke_mm) else None


def brake_of(record: Any) -> KeptBrake:
    """A record's flag, with the load at which the brake slipped."""
    fails, load_n = bool(int(record["flags"]) & Flag.BRAKE_FAILS), float(record["slipped_n"])
    return KeptBrake(fails, load_n if fails and math.isfinite(load_n) else None)


def differ(one: KeptBrake, other: KeptBrake) -> bool:
    """Whether the flags differ, or the loads by more than is written again."""
    if one.fails is not other.fails or (one.slipped_n is None) is not (other.slipped_n is None):
        return True
    return abs((one.slipped_n or 0.0) - (other.slipped_n or 0.0)) >= KEPT_N


def shown_by(settings: RigSettings, record: Any) -> KeptValues:
    """What the newest record of a run shows; the file, for a stroke that it does not, and where there is no record."""
    stroke_mm = of_record(record)
    if stroke_mm is not None:
        return KeptValues(LastStroke(stroke_mm), brake_of(record))
    kept = read(settings)
    return kept if record is None else KeptValues(kept.stroke, brake_of(record))


def in_force(runtime: Runtime) -> KeptValues:
    """What the supervisor has read."""
    try:
        return msgspec.convert(runtime.read_json(IN_FORCE), KeptValues)
    except (OSError, msgspec.MsgspecError):
        return _unknown(f"{IN_FORCE} cannot be read")
