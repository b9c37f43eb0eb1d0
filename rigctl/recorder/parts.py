"""The parts of recordings in a folder: names, deletion of old ones, free space."""

from __future__ import annotations

import contextlib
import pathlib
import re
import shutil
from dataclasses import dataclass

from rigctl.recorder.audit_log import moment

_NAME = re.compile(r"(?P<rig>[a-z][a-z0-9_]*)-(?P<start>\d{8}T\d{6}\.\d{3}Z)-(?P<number>\d{4,9})\.mcap")


@dataclass(frozen=True, order=True)
class RecordingPart:
    """One file; sorts by the start of its run, then by its number."""

    start: str
    number: int
    path: pathlib.Path


def path_of(folder: pathlib.Path, rig: str, run_wall_ns: int, number: int) -> pathlib.Path:
    """A part's file: ``RIG-START-NUMBER.mcap``; START is the start of its run, UTC."""
    stamp = moment(run_wall_ns).replace("-", "").replace(":", "")
    return folder / f"{rig}-{stamp}-{number:04d}.mcap"


def parts(folder: pathlib.Path, rig: str) -> list[RecordingPart]:
    """Parts of one rig in a folder, oldest first; empty without the folder."""
    found = []
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            name = _NAME.fullmatch(path.name)
            if name and name["rig"] == rig:
                found.append(RecordingPart(name["start"], int(name["number"]), path))
    return sorted(found)


def of_same_run(path: pathlib.Path) -> list[pathlib.Path]:
    """Parts of the run ``path`` belongs to, in order; ``path`` alone if its name is not that of a part."""
    name = _NAME.fullmatch(path.name)
    if not name:
        return [path]
    return [part.path for part in parts(path.parent, name["rig"]) if part.start == name["start"]] or [path]


def free_bytes(folder: pathlib.Path) -> int:
    """Free space on the disk of a folder, without the blocks reserved for root."""
    return shutil.disk_usage(folder).free


def delete_old(folder: pathlib.Path, rig: str, keep: pathlib.Path | None, keep_bytes: int) -> list[str]:
    """Delete the oldest parts until all together take at most ``keep_bytes``; returns the deleted names.

    ``keep``: the part being written. A part that cannot be deleted stays.
    """
    found = [part.path for part in parts(folder, rig) if part.path != keep]
    sizes = {path: _size(path) for path in found}
    total = sum(sizes.values()) + (_size(keep) if keep is not None else 0)
    deleted = []
    for path in found:
        if total <= keep_bytes:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            total -= sizes[path]
            deleted.append(path.name)
    return deleted


def _size(path: pathlib.Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
