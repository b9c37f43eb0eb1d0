"""The runs and trip dumps of a rig: what their folders and the audit log hold, without opening a recording."""

from __future__ import annotations

import contextlib
import itertools
import pathlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from rigctl.ipc.notes import Note
from rigctl.model.quantity import count
from rigctl.recorder import parts
from rigctl.recorder.chain import ChainError, read_line
from rigctl.recorder.parts import RecordingPart

LAST, TRIP = "last", "trip"
_NOTE = f'"what":"{Note.OPERATOR_NOTE.name.lower()}"'.encode()
NAME = re.compile(rf"{LAST}|{TRIP}|(?:{TRIP}-)?[0-9]{{1,18}}")
"""What a run or a dump may be called: ``last``, ``12``, ``trip`` (the newest dump), ``trip-3``."""


@dataclass(frozen=True)
class RecordedRun:
    """A run, or a trip dump, whose ``fault`` is that of the trip.

    ``number``: 0 for one that was written before names had a number. ``ended``: when its newest part was last written.
    ``trips``: faults of the dumps that were written within a run. ``notes``: words of operators within it.
    """

    number: int
    began: datetime
    ended: datetime
    files: tuple[pathlib.Path, ...]
    size: int
    fault: str = ""
    trips: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """By which `report` and its like find it; "" without a number."""
        if not self.number:
            return ""
        return f"{TRIP}-{self.number}" if self.fault else str(self.number)

    @property
    def outcome(self) -> str:
        """The fault of a dump; the trips of a run."""
        return self.fault or (f"{count(len(self.trips), 'trip')}: {', '.join(self.trips)}" if self.trips else "no trip")

    def as_dict(self) -> dict[str, Any]:
        """As JSON values; times in s since 1970."""
        return {
            "name": self.name, "kind": TRIP if self.fault else "run", "number": self.number,
            "began_s": self.began.timestamp(), "duration_s": self.duration_s, "bytes": self.size,
            "fault": self.fault or None, "trips": list(self.trips), "notes": list(self.notes),
            "files": [str(file) for file in self.files],
        }  # fmt: skip

    @property
    def duration_s(self) -> float:
        """By the wall clock, which may have been set meanwhile; never below 0."""
        return max(0.0, (self.ended - self.began).total_seconds())


def recorded(
    recordings: pathlib.Path | None, trips: pathlib.Path | None, rig: str, audit_log: pathlib.Path | None = None
) -> list[RecordedRun]:
    """Runs, then dumps, of one rig, each oldest first; a folder of None, or that is not there, has none."""
    notes = list(_notes(audit_log)) if audit_log is not None else []
    dumps = [_one([dump], _fault_of(dump.path)) for dump in (parts.dumps(trips, rig) if trips is not None else ())]
    found = parts.parts(recordings, rig) if recordings is not None else []
    runs = []
    for _, of_run in itertools.groupby(found, key=lambda part: (part.run, part.start)):
        run = _one(list(of_run), "")
        within = tuple(dump.fault for dump in dumps if run.began <= dump.began <= run.ended)
        words = tuple(text for at, text in notes if run.began <= at <= run.ended)
        runs.append(replace(run, trips=within, notes=words))
    return [*runs, *dumps]


def _notes(audit_log: pathlib.Path) -> Iterator[tuple[datetime, str]]:
    """When operators wrote notes, and their words; lines that are no entries have none."""
    with contextlib.suppress(OSError), audit_log.open("rb") as lines:
        for line in lines:
            if _NOTE in line:
                with contextlib.suppress(ChainError):
                    entry, _ = read_line(line)
                    if entry.what == Note.OPERATOR_NOTE.name.lower():
                        yield datetime.fromisoformat(entry.wall), entry.text


def named(found: Sequence[RecordedRun], name: str) -> RecordedRun | None:
    """The run or dump of a name (`NAME`); None where there is none."""
    if name in (LAST, TRIP):
        return next((run for run in reversed(found) if bool(run.fault) is (name == TRIP)), None)
    return next((run for run in found if run.name == f"{name}"), None)


def _one(found: list[RecordingPart], fault: str) -> RecordedRun:
    began = datetime.strptime(found[0].start, "%Y%m%dT%H%M%S.%fZ").replace(tzinfo=UTC)
    looks = [part.path.stat() for part in found if part.path.exists()]
    ended = datetime.fromtimestamp(max((look.st_mtime for look in looks), default=began.timestamp()), UTC)
    files = tuple(part.path for part in found)
    return RecordedRun(found[0].run, began, ended, files, sum(look.st_size for look in looks), fault)


def _fault_of(dump: pathlib.Path) -> str:
    return dump.stem.rsplit("-", 1)[1]
