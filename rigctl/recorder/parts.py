"""The parts of recordings and the trip dumps in a folder: names, order, deletion of old ones, free space.

The order of writing is that of a number in the name, one more than the highest found: the wall clock may be set back or
ahead at any time, or start in 1970.
"""

from __future__ import annotations

import contextlib
import pathlib
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

from rigctl.ipc.wall_clock import CLOCKS_DIFFER
from rigctl.recorder.audit_log import moment

_STEM = r"(?P<rig>[a-z][a-z0-9_]*)-(?:(?P<run>\d{6,18})-)?(?P<start>\d{8}T\d{6}\.\d{3}Z)-"
_PART = re.compile(_STEM + r"(?P<number>\d{4,9})\.mcap")
_DUMP = re.compile(_STEM + r"[A-Z][A-Z0-9_]*\.mcap")
_CLOCKS_DIFFER_NS = CLOCKS_DIFFER // timedelta(microseconds=1) * 1000


@dataclass(frozen=True, order=True)
class RecordingPart:
    """A part, or a trip dump, whose ``number`` is 0; sorts by the order of writing.

    ``run``: number of the run, or of the dump; 0 for a name without one, which is older than any with one. ``start``:
    wall clock in the name.
    """

    run: int
    start: str
    number: int
    path: pathlib.Path

    @property
    def stem(self) -> str:
        """What the parts of its run share in their names; the whole name of a dump."""
        return self.path.name.rsplit("-", 1)[0] if self.number else self.path.name


def stamp(wall_ns: int) -> str:
    """A wall-clock time as names have it, UTC."""
    return moment(wall_ns).replace("-", "").replace(":", "")


def path_of(folder: pathlib.Path, rig: str, run: int, wall_ns: int, last: str) -> pathlib.Path:
    """The file ``RIG-RUN-START-LAST.mcap``; START is UTC.

    ``run``, ``wall_ns``: number and start of a part's run, or number and time of a dump. ``last``: number of a part, or
    fault of a dump.
    """
    return folder / f"{rig}-{run:06d}-{stamp(wall_ns)}-{last}.mcap"


def parts(folder: pathlib.Path, rig: str) -> list[RecordingPart]:
    """Parts of one rig in a folder, oldest first; empty without the folder."""
    return _found(folder, rig, _PART)


def dumps(folder: pathlib.Path, rig: str) -> list[RecordingPart]:
    """Trip dumps of one rig in a folder, oldest first; empty without the folder."""
    return _found(folder, rig, _DUMP)


def _found(folder: pathlib.Path, rig: str, form: re.Pattern[str]) -> list[RecordingPart]:
    found = []
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            name = form.fullmatch(path.name)
            if name and name["rig"] == rig:
                number = int(name.groupdict().get("number", 0))
                found.append(RecordingPart(int(name["run"] or 0), name["start"], number, path))
    return sorted(found)


def next_run(found: Sequence[RecordingPart]) -> int:
    """The number of a new run, or dump: one more than the highest found."""
    return found[-1].run + 1 if found else 1


def of_same_run(path: pathlib.Path) -> list[pathlib.Path]:
    """Parts of the run ``path`` belongs to, in order; ``path`` alone if its name is not that of a part."""
    name = _PART.fullmatch(path.name)
    if not name:
        return [path]
    run = int(name["run"] or 0), name["start"]
    return [part.path for part in parts(path.parent, name["rig"]) if (part.run, part.start) == run] or [path]


def misordered(found: Sequence[RecordingPart], wall_ns: int, run: int = 0) -> dict[str, str]:
    """Words on files whose name contradicts the wall clock, or the number of the running ``run``; of each the newest.

    The key is what the files of its run share in their names.
    """
    latest = stamp(wall_ns + _CLOCKS_DIFFER_NS)
    words = {}
    if ahead := [part for part in found if part.start > latest]:
        words[ahead[-1].stem] = (
            f"{ahead[-1].path.name} is dated after the computer's clock, which reads {moment(wall_ns)[:10]} (such "
            f"files: {len(ahead)}); files are deleted in the order of their numbers; set the clock"
        )
    if run and found and found[-1].run > run:
        words[found[-1].stem] = (
            f"{found[-1].path.name} is of run {found[-1].run}, the running one is {run}: the file was put there since; "
            "the running run's parts are deleted last; move the file away"
        )
    return words


def free_bytes(folder: pathlib.Path) -> int:
    """Free space on the disk of a folder, without the blocks reserved for root."""
    return shutil.disk_usage(folder).free


def delete_old(folder: pathlib.Path, rig: str, run: int, keep: pathlib.Path | None, keep_bytes: int) -> list[str]:
    """Delete the oldest parts until all together take at most ``keep_bytes``; returns the deleted names.

    ``run``: the running one, 0 for none, whose parts are deleted last. ``keep``: the part being written. A part that
    cannot be deleted stays.
    """
    found = sorted(parts(folder, rig), key=lambda part: part.run == run > 0)
    old = [part.path for part in found if part.path != keep]
    sizes = {path: _size(path) for path in old}
    total = sum(sizes.values()) + (_size(keep) if keep is not None else 0)
    deleted = []
    for path in old:
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
