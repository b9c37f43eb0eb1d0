"""Trip dumps: everything from 10 s before a trip to 2 s after it, in a file of its own.

A dump is made from the rings once its time is over, so the next recorder makes it if this one is killed before. Trips
within 2 s of the first share a file.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO, Any

import msgspec
import numpy as np
import numpy.typing as npt

from rigctl import __version__
from rigctl.config.settings import RigSettings
from rigctl.diagnosis.diagnose import diagnose
from rigctl.diagnosis.window import around
from rigctl.diagnosis.window import trips as first_trips
from rigctl.ipc import whole_file
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.loop_event import LoopEvent
from rigctl.model.states import Event, Mode
from rigctl.recorder import part_seal, parts
from rigctl.recorder.mcap_file import ATTACHED, FORMAT, McapFile, slot_readers
from rigctl.recorder.sources import AuditedRings
from rigctl.wire.schema import schema

BEFORE_NS, AFTER_NS = 10_000_000_000, 2_000_000_000


@dataclass(frozen=True)
class Trigger:
    """An event that needs a dump."""

    seq: int
    t_ns: int
    fault: str


@dataclass(frozen=True)
class Group:
    """Triggers that share a dump."""

    triggers: tuple[Trigger, ...]

    @property
    def start_ns(self) -> int:
        """Start of the dump."""
        return self.triggers[0].t_ns - BEFORE_NS

    @property
    def end_ns(self) -> int:
        """End of the dump."""
        return self.triggers[-1].t_ns + AFTER_NS

    @property
    def last_seq(self) -> int:
        """Number of the last trigger's event."""
        return self.triggers[-1].seq

    @property
    def fault(self) -> str:
        """The fault that tripped first."""
        return next((trigger.fault for trigger in self.triggers if trigger.fault), Fault.LOOP_EXCEPTION.name)


def triggers(events: npt.NDArray[np.void]) -> list[Trigger]:
    """Trips, and their changes to FAULT, because an exception in the loop leads to FAULT without a trip."""
    found = []
    for event in LoopEvent.of_slots(events):
        fields = event.fields
        if event.kind is Kind.TRIP:
            fault = fields["fault"]
            name = fault.name if isinstance(fault, Fault) else f"FAULT_{fault}"
            found.append(Trigger(event.seq, event.t_ns, name))
        elif event.kind is Kind.MODE and fields["to"] == Mode.FAULT and fields["why"] == Event.TRIP:
            found.append(Trigger(event.seq, event.t_ns, ""))
    return found


def first_group(pending: Sequence[Trigger]) -> Group:
    """The oldest trigger and those within ``AFTER_NS`` of it."""
    until_ns = pending[0].t_ns + AFTER_NS
    return Group(tuple(trigger for trigger in pending if trigger.t_ns <= until_ns))


@dataclass(frozen=True)
class Dump:
    """A file that was written, and the older files deleted after it."""

    path: pathlib.Path
    group: Group
    records: int
    frames: int
    deleted: tuple[str, ...]


class Trips:
    """Watches the events for trips and writes their dumps."""

    def __init__(self, runtime: Runtime, settings: RigSettings, dumped: int) -> None:
        """``dumped``: number of the last event whose trip has a file."""
        self._runtime, self._settings = runtime, settings
        self._events = runtime.events.reader()
        self._events.cursor = min(dumped, self._events.head)
        self._pending: list[Trigger] = []
        self.folder = settings.kept(settings.audit.trips)

    def due(self, now_ns: int, *, final: bool = False) -> Group | None:
        """A group whose time is over; ``final``: also one whose time is not, as no more data will come."""
        self._pending += triggers(self._events.read())
        if not self._pending:
            return None
        group = first_group(self._pending)
        return group if final or now_ns >= group.end_ns else None

    def missed(self, group: Group, now_ns: int) -> bool:
        """Whether the rings no longer hold its data."""
        return now_ns - group.triggers[-1].t_ns > self._settings.telemetry.history_s * 1_000_000_000

    def done(self, group: Group) -> None:
        """Forget its triggers."""
        self._pending = [trigger for trigger in self._pending if trigger.seq > group.last_seq]

    def write(self, group: Group, wall_offset_ns: int, audit: dict[str, Any]) -> Dump:
        """Write its file, whole or not at all. ``audit``: the audit log's path and position.

        Raises:
            OSError: it could not be written; no part of it is left.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        number, wall_ns = parts.next_run(self.dumps()), group.triggers[0].t_ns + wall_offset_ns
        path = parts.path_of(self.folder, self._settings.rig, number, wall_ns, group.fault)
        part = path.with_name(f".{path.name}.part")
        try:
            part.unlink(missing_ok=True)
            with os.fdopen(os.open(part, whole_file.NEW, 0o640), "wb") as stream:
                records, frames = self._fill(stream, group, wall_offset_ns, audit)
                stream.flush()
                os.fsync(stream.fileno())
            part.rename(path)
            whole_file.sync_folder(self.folder)
        except OSError:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
            raise
        return Dump(path, group, records, frames, self._delete_old(path))

    def _fill(self, stream: IO[bytes], group: Group, offset_ns: int, audit: dict[str, Any]) -> tuple[int, int]:
        runtime, wall_ns = self._runtime, group.triggers[0].t_ns + offset_ns
        file = McapFile(stream, offset_ns)
        slots = {topic: _window(reader, group) for topic, reader in slot_readers(runtime).items()}
        said = [
            item
            for item in AuditedRings(runtime, {}).take_all(offset_ns)
            if item.seq and item.source not in ("commands", "holds") and group.start_ns <= item.t_ns <= group.end_ns
        ]
        active = runtime.known(ACTIVE)
        file.describe("culprit", self._culprit(group, slots["records"]))
        file.describe(
            "rigctl",
            {
                "rig": self._settings.rig,
                "version": __version__,
                "format": FORMAT,
                "fault": group.fault,
                "t_ns": group.triggers[0].t_ns,
                "trips": " ".join(trigger.fault for trigger in group.triggers if trigger.fault),
                "wall_offset_ns": offset_ns,
                "records": len(slots["records"]),
                "frames": len(slots["frames"]),
                "started_wall_ns": active.get("started_wall_ns", 0),
                "host": os.uname().nodename,
                "kernel": os.uname().release,
            },
        )
        file.describe("audit", audit)
        for name in ATTACHED:
            file.attach(name, msgspec.json.encode(runtime.known(name)), wall_ns)
        file.attach("schema.json", msgspec.json.encode(schema(self._settings.rig)), wall_ns)
        if (ledger_file := self._settings.ledger) is not None and ledger_file.is_file():
            file.attach("calibration_ledger.json", ledger_file.read_bytes(), wall_ns)
        messages = [
            *(message for topic, found in slots.items() for message in file.slots(topic, found)),
            *file.said(said),
        ]
        file.add(sorted(messages, key=lambda message: message.wall_ns))
        file.finish(part_seal.sealer(self._settings))
        return len(slots["records"]), len(slots["frames"])

    def _culprit(self, group: Group, records: npt.NDArray[np.void]) -> dict[str, str]:
        """The part that the first trip is about, as the running rig names it; empty for one whose event is lost."""
        events = self._runtime.events.reader(from_start=True)
        events.seek(group.start_ns)
        known = LoopEvent.of_slots(events.read())
        trip = next((trip for trip in first_trips(known) if trip.t_ns >= group.triggers[0].t_ns), None)
        if trip is None or trip.t_ns > group.end_ns:
            return {}
        try:
            found = diagnose(around(trip, self._settings, known, records))
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:  # the dump is kept without a name
            return {"text": f"not known: {type(error).__name__}: {error}"}
        return {"parts": " or ".join(found.parts), "text": found.text, "question": found.question,
                "first": found.first, "follows": " ".join(found.follows)}  # fmt: skip

    def dumps(self) -> list[parts.RecordingPart]:
        """Dumps of this rig in the folder, oldest first."""
        return parts.dumps(self.folder, self._settings.rig)

    def _delete_old(self, written: pathlib.Path) -> tuple[str, ...]:
        """Delete all but the newest ``trips_kept`` dumps, and never the one just written; others may have to stay."""
        old = [dump.path for dump in self.dumps() if dump.path != written]
        deleted = []
        for path in old[: max(0, len(old) + 1 - self._settings.audit.trips_kept)]:
            with contextlib.suppress(OSError):
                path.unlink()
                deleted.append(path.name)
        return tuple(deleted)

    def sweep(self) -> None:
        """Delete unfinished files of a killed recorder."""
        with contextlib.suppress(OSError):
            for part in self.folder.glob(f".{self._settings.rig}-[0-9]*.mcap.part"):
                part.unlink()


def _window(reader: RingReader, group: Group) -> npt.NDArray[np.void]:
    reader.seek(group.start_ns)
    slots = reader.read()
    return slots[(slots["t_ns"] >= group.start_ns) & (slots["t_ns"] <= group.end_ns)]
