"""Reads recordings and trip dumps as numpy arrays and lists, whole or cut off anywhere.

A file is read up to its last whole chunk and without its index, since a killed recorder wrote none.
"""

from __future__ import annotations

import hashlib
import pathlib
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from rigctl.ipc.record import Slot
from rigctl.recorder import parts
from rigctl.recorder.file_reader import RECORDER, SLOTS, AttachedDocument, FileReader, ReadFile, RecordingError, Said

__all__ = ["SLOTS", "Gap", "Recording", "RecordingError", "Said", "parts_of", "read"]


@dataclass(frozen=True)
class Gap:
    """Slots ``after`` + 1 to ``upto`` of a ring are missing; ``t_ns``: time of the slot before, 0 at the beginning."""

    ring: str
    after: int
    upto: int
    t_ns: int

    @property
    def count(self) -> int:
        """Number of missing slots."""
        return self.upto - self.after


@dataclass(frozen=True)
class Recording:
    """Content of one or several parts of a run; arrays in the order of ``seq``, each slot once.

    ``records``: ``RECORD`` slots; signals have the precision of the file's floats (32 bits; trip dumps: 64), all else
    is exact. ``frames``: ``FRAME`` slots, ``commands``: ``COMMAND`` slots, ``holds``: ``HOLD`` slots without the
    operator; all exact. ``said``: by topic. ``sha256``: of the file; of several the hash of their hashes, one a line.
    """

    files: tuple[ReadFile, ...]
    rig: str
    run: str
    sha256: str
    wall_offset_ns: int
    metadata: dict[str, dict[str, str]]
    records: npt.NDArray[np.void]
    frames: npt.NDArray[np.void]
    commands: npt.NDArray[np.void]
    holds: npt.NDArray[np.void]
    said: dict[str, list[Said]]
    generations: list[AttachedDocument]
    gaps: list[Gap]

    @property
    def release(self) -> str:
        """Version of rigctl that wrote it; empty where it does not say."""
        return self.metadata.get("versions", {}).get("rigctl") or self.metadata.get("rigctl", {}).get("version", "")

    @property
    def complete(self) -> bool:
        """Whether every file has its end and is undamaged."""
        return all(file.complete for file in self.files)

    @property
    def start_ns(self) -> int:
        """Time of the first record, CLOCK_MONOTONIC; 0 without one."""
        return int(self.records["t_ns"][0]) if len(self.records) else 0

    @property
    def end_ns(self) -> int:
        """Time of the last record, CLOCK_MONOTONIC; 0 without one."""
        return int(self.records["t_ns"][-1]) if len(self.records) else 0

    @property
    def control_starts(self) -> list[int]:
        """Time of the first record of each control process; each starts its tick count again."""
        if not len(self.records):
            return []
        again = np.flatnonzero(np.diff(self.records["tick"].astype(np.int64)) < 0) + 1
        return [int(self.records["t_ns"][at]) for at in (0, *again.tolist())]

    @property
    def events(self) -> list[Said]:
        """The loop's events."""
        return self.said.get("events", [])

    @property
    def replies(self) -> list[Said]:
        """The loop's replies to commands."""
        return self.said.get("replies", [])

    @property
    def audit(self) -> list[Said]:
        """Entries of the audit log."""
        return self.said.get("audit", [])

    @property
    def attachments(self) -> dict[str, bytes]:
        """The newest version of each document."""
        return {attachment.name: attachment.data for attachment in self.generations}

    def in_force(self, name: str, t_ns: int) -> bytes | None:
        """The version of a document in force at a time, for an earlier time the first; None without the document."""
        known = [attachment for attachment in self.generations if attachment.name == name]
        before = [attachment for attachment in known if attachment.t_ns <= t_ns]
        found = before[-1:] or known[:1]
        return found[0].data if found else None

    def table(self, name: str, t_ns: int) -> dict[str, Any] | None:
        """The keys of the document in force at a time; None without it, or if it cannot be read."""
        try:
            found = msgspec.json.decode(self.in_force(name, t_ns) or b"")
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return None
        return found if isinstance(found, dict) else None


def parts_of(path: str | pathlib.Path) -> tuple[pathlib.Path, ...]:
    """Every part of the run of ``path``, in its folder; ``path`` alone if it is not a part."""
    return tuple(parts.of_same_run(pathlib.Path(path)))


def read(*paths: str | pathlib.Path, frames: bool = True) -> Recording:
    """Read a file, or several parts of one run.

    Args:
        paths: the files, in any order.
        frames: whether to read the frames; reading is faster without them.

    Raises:
        RecordingError: a file is not a recording, or the files are not of one run of one rig.
    """
    if not paths:
        raise RecordingError("found no file, expected one or more")
    found = [FileReader(pathlib.Path(path), frames) for path in paths]
    first = found[0]
    for other in found[1:]:
        if (other.rig, other.run) != (first.rig, first.run):
            raise RecordingError(f"{other.path}: found a recording of another run than {first.path}")
    found.sort(key=lambda part: part.number)
    first = found[0]
    slots = {name: _joined([part.slots[name] for part in found], SLOTS[name], first.path) for name in SLOTS}
    said, gaps = _said(found)
    for name, array in slots.items():
        if name != "frames" or frames:
            gaps += _gaps(name, array["seq"], array["t_ns"])
    files = tuple(part.file for part in found)
    digest = files[0].sha256
    if len(files) > 1:
        digest = hashlib.sha256("\n".join(file.sha256 for file in files).encode()).hexdigest()
    return Recording(
        files, first.rig, first.run, digest, first.offset_ns, first.metadata, **slots, said=said,
        generations=_generations(found), gaps=gaps,
    )  # fmt: skip


def _joined(arrays: list[npt.NDArray[np.void]], slot: Slot, path: pathlib.Path) -> npt.NDArray[np.void]:
    """All slots once, in order of their numbers."""
    present = [array for array in arrays if len(array)]
    if not present:
        return np.empty(0, slot.dtype)
    if any(array.dtype != present[0].dtype for array in present):
        raise RecordingError(f"{path}: its parts were written by different versions")
    whole = present[0] if len(present) == 1 else np.concatenate(present)
    if np.any(np.diff(whole["seq"].astype(np.int64)) <= 0):
        _, index = np.unique(whole["seq"], return_index=True)
        whole = whole[index]
    return whole


def _gaps(ring: str, numbers: npt.NDArray[Any], times: npt.NDArray[Any]) -> list[Gap]:
    """Gaps between the slots present; slots before the first one need not belong to the file."""
    breaks = np.flatnonzero(np.diff(numbers.astype(np.int64)) > 1)
    return [Gap(ring, int(numbers[at]), int(numbers[at + 1]) - 1, int(times[at])) for at in breaks.tolist()]


def _said(found: list[FileReader]) -> tuple[dict[str, list[Said]], list[Gap]]:
    said: dict[str, dict[tuple[int, int, str], Said]] = {}
    for part in found:
        for topic, items in part.said.items():
            own = said.setdefault(topic, {})
            for item in items:
                own.setdefault((item.seq, 0, "") if item.seq else (0, item.t_ns, item.what + item.text), item)
    ordered = {topic: list(items.values()) for topic, items in said.items()}
    gaps = []
    for topic, items in ordered.items():
        if topic != RECORDER:
            items.sort(key=lambda item: item.seq)
            gaps += _gaps(topic, np.array([i.seq for i in items]), np.array([i.t_ns for i in items]))
    return ordered, gaps


def _generations(found: list[FileReader]) -> list[AttachedDocument]:
    """Each content once, with the time it came into force; a part begins with a copy of the content before it.

    Their order is that of the files: the date of a copy is by the wall clock, which may have been set since.
    """
    last: dict[str, bytes] = {}
    generations = []
    for item in (item for part in found for item in part.documents):
        if last.get(item.name) != item.data:
            generations.append(item)
            last[item.name] = item.data
    return generations
