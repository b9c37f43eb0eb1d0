"""The continuous recording: everything the rings carry, in parts that can each be read alone.

After a killed recorder the next one continues where the file ends, in a new part; the rings hold the data in between.
A separate thread writes to the disk. While the disk stalls, encoded data waits up to a limit, then the rings hold the
data, and slots they overwrite are counted as lost.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from rigctl import __version__
from rigctl.config import input_file
from rigctl.config.settings import RigSettings
from rigctl.ipc.runtime_folder import Runtime
from rigctl.recorder import part_seal, parts
from rigctl.recorder.appender import Appender
from rigctl.recorder.audit_log import Item
from rigctl.recorder.chain import ChainError, read_line
from rigctl.recorder.file_reader import RecordingError, progress_of, run_of
from rigctl.recorder.mcap_file import ATTACHED, slot_readers
from rigctl.recorder.part_file import PartFile
from rigctl.recorder.sources import AuditedRings
from rigctl.wire.schema import schema

BATCH_NS = 400_000_000  # a chunk: 200 KB before compression at 1 kHz
CHECK_NS = 1_000_000_000
PENDING_MAX = 8 << 20
STALLED_S = 5.0
END_LIMIT_S = 4.0
ROOM_AGAIN = 32 << 20  # additional free space needed before recording resumes
WRITTEN = "written"
PLACES = {"records": "records", "frames": "frames", "commands": "slots", "holds": "hold_slots"}
"""Names of the positions of the slots in a file; ``commands`` and ``holds`` are those of the same rings' texts."""
_AUDIT_TAIL = 1 << 20


@dataclass(frozen=True)
class Place:
    """Position of each ring in a part once ``size`` bytes of it are on the disk."""

    size: int
    read: dict[str, int]


class Continuous:
    """The recording of one daemon."""

    def __init__(self, runtime: Runtime, settings: RigSettings, run: int, wall_ns: int) -> None:
        """``run``: wall clock at the daemon's start. Continues where the last part of this run ends."""
        self._runtime, self._settings = runtime, settings
        self._run = run or wall_ns
        self.folder = settings.kept(settings.recording.folder)
        self._slots = slot_readers(runtime)
        self._audit: list[tuple[int, int, bytes]] = []
        self._audit_written = 0
        self._part: PartFile | None = None
        self._places: deque[Place] = deque()
        self._attached: dict[str, tuple[int, int]] = {}
        self._due_ns = self._check_ns = self._looked_ns = 0
        self._failed = 0  # failures of closed parts
        self.records = self.frames = 0
        self.why = ""
        """Why nothing is recorded now; empty while recording."""
        self.deleted: list[str] = []
        """Old parts that were deleted, for the audit log."""
        self.run_number, self._number, self._safe = self._left_off(settings.audit_log)
        self._words = AuditedRings(runtime, self._safe)
        self._go_back(self._safe)

    # -- resumption ---------------------------------------------------------------------------------------------
    def _left_off(self, audit_log: pathlib.Path) -> tuple[int, int, dict[str, int]]:
        """Number of this run and of its last part, 0 without a part, and the position of each ring in that."""
        found = parts.parts(self.folder, self._settings.rig)
        mine = [part for part in found if part.run and part.start == parts.stamp(self._run)]
        # A clock that starts in 1970 may have given another run the same start.
        run = next((part.run for part in reversed(mine) if run_of(part.path) == self._run), 0)
        mine = [part for part in mine if part.run == run]
        read: dict[str, int] = {}
        for part in reversed(mine):
            with contextlib.suppress(RecordingError):
                if read := progress_of(part.path):
                    break
        if read.get("audit"):
            self._audit_written = read["audit"]
            self.audit(_lines_after(audit_log, read["audit"]))
        return run, (mine[-1].number if mine else 0), read

    def _go_back(self, read: dict[str, int]) -> None:
        for topic, reader in self._slots.items():
            reader.cursor = min(read.get(PLACES[topic], 0), reader.head)
        self._words.go_back(read)

    def _position(self, audit: int) -> dict[str, int]:
        cursors = {PLACES[topic]: reader.cursor for topic, reader in self._slots.items()}
        return {**cursors, "audit": audit, **self._words.position}

    # -- input --------------------------------------------------------------------------------------------------
    def audit(self, lines: Sequence[bytes]) -> None:
        """Take lines that were written to the audit log."""
        for line in lines:
            with contextlib.suppress(ChainError):
                entry, _ = read_line(line)
                self._audit.append((entry.n, entry.t_ns, line.rstrip(b"\n")))

    def poll(self, now_ns: int, wall_ns: int, *, final: bool = False) -> None:
        """Write new data, if a batch is due."""
        if not final and now_ns < self._due_ns:
            return
        self._due_ns = now_ns + BATCH_NS
        self._check(now_ns, wall_ns)
        if self._part is not None and self._part.disk.pending < PENDING_MAX:
            self._write(self._part, now_ns)

    def close(self, now_ns: int, wall_ns: int) -> None:
        """Write the rest and end the part."""
        self.poll(now_ns, wall_ns, final=True)
        if (part := self._part) is not None:
            self._finish(part)
            if not part.disk.join(END_LIMIT_S):
                self.why = f"{part.disk.path} was not written to its end: {part.disk.error or 'no answer'}"

    # -- the part ----------------------------------------------------------------------------------------------
    def _check(self, now_ns: int, wall_ns: int) -> None:
        """Check the state of the part's file, close the part if it is over, and open a new one if none is open."""
        part = self._part
        if part is not None:
            disk = part.disk
            while self._places and self._places[0].size <= disk.synced:
                self._safe = self._places.popleft().read
            if disk.torn or not disk.in_place():
                self.why = f"{disk.path} cannot be written on: {disk.error or 'it is not there any more'}"
                self._abandon(part)
            elif disk.error:
                self.why = f"{disk.path} cannot be written: {disk.error}"
                return
            elif disk.stalled_s > STALLED_S:
                self.why = f"{disk.path} cannot be written: the disk has not answered for {disk.stalled_s:.0f} s"
                return
            else:
                self.why = ""
                if self._is_over(part, now_ns):
                    self._finish(part)
        if now_ns >= self._check_ns or (part is not None and self._part is None):
            self._check_ns = now_ns + CHECK_NS
            if self._has_room() and self._part is None:
                self._open(now_ns, wall_ns)

    def _is_over(self, part: PartFile, now_ns: int) -> bool:
        own = self._settings.recording
        return part.size >= own.part_mb * 1_000_000 or now_ns - part.opened_ns >= own.part_s * 1_000_000_000

    def _has_room(self) -> bool:
        """Delete parts beyond the limit; returns whether the disk has enough free space."""
        own, part = self._settings.recording, self._part
        least = max(own.free_mib, self._settings.preflight.disk_free_mib) << 20
        if part is None:
            least += ROOM_AGAIN
        room = own.part_mb * 1_000_000 if part is None else 0
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            current = part.disk.path if part is not None else None
            keep_bytes = own.keep_mb * 1_000_000 - room
            self.deleted += parts.delete_old(self.folder, self._settings.rig, self.run_number, current, keep_bytes)
            free = parts.free_bytes(self.folder)
        except OSError as error:
            self.why = f"{self.folder} cannot be written: {error.strerror}"
            return False
        if free >= least:
            return True
        self.why = f"not recorded: {free >> 20} MiB free for {self.folder}, expected {least >> 20} or more"
        if part is not None:
            self._finish(part)
        return False

    def _open(self, now_ns: int, wall_ns: int) -> None:
        rig, number = self._settings.rig, self._number + 1
        if number == 1:
            self.run_number = parts.next_run(parts.parts(self.folder, rig))
        try:
            disk = Appender(parts.path_of(self.folder, rig, self.run_number, self._run, f"{number:04d}"))
        except OSError as error:
            self._failed += 1
            self.why = f"{self.folder} cannot be written: {error.strerror}"
            if isinstance(error, FileExistsError):
                self._number = number
            return
        system = os.uname()
        words = {"rig": rig, "run": self._run, "part": number, "t_ns": now_ns, "version": __version__,
                 "host": system.nodename, "kernel": system.release, "machine": system.machine,
                 "rate_hz": self._settings.loop.rate_hz}  # fmt: skip
        self._part = PartFile(disk, wall_ns - now_ns, now_ns, words)
        self._number, self._attached, self.why = number, {}, ""
        self._part.attach("schema.json", msgspec.json.encode(schema(rig)), now_ns, 0)

    def _finish(self, part: PartFile) -> None:
        """Close a part."""
        part.finish(part_seal.sealer(self._settings))
        self._failed += part.disk.failures
        self._part = None
        self._places.clear()
        self._safe = self._position(self._safe.get("audit", 0))

    def _abandon(self, part: PartFile) -> None:
        """Give up a part; data that is not on the disk for certain is read again for the next part."""
        part.disk.end()
        self._failed += part.disk.failures + 1
        self._part = None
        self._places.clear()
        self._go_back(self._safe)
        self._audit_written = self._safe.get("audit", 0)
        self._audit.clear()
        self.audit(_lines_after(self._settings.audit_log, self._audit_written))

    # -- content -----------------------------------------------------------------------------------------------
    def _write(self, part: PartFile, now_ns: int) -> None:
        self._attach(part, now_ns)
        slots = {topic: reader.read() for topic, reader in self._slots.items()}
        said = [item for item in self._words.take_all(part.offset_ns) if item.source not in ("commands", "holds")]
        audit, self._audit = self._audit, []
        place = self._position(audit[-1][0] if audit else self._audit_written)
        self._audit_written = place["audit"]
        lost = {PLACES[topic]: reader.lost for topic, reader in self._slots.items()}
        said.append(Item(now_ns, now_ns + part.offset_ns, WRITTEN, "", details={"read": place, "lost": lost}))
        part.write(slots, said, audit)
        self._places.append(Place(part.size, place))
        self.records += len(slots["records"])
        self.frames += len(slots["frames"])

    def _attach(self, part: PartFile, now_ns: int) -> None:
        """Attach the documents that have changed since they were last attached.

        The age of one is by the wall clock, which may have been set since, but it is younger than the look before.
        """
        found = {name: self._runtime.directory / name for name in ATTACHED}
        if self._settings.ledger is not None:
            found["calibration_ledger.json"] = self._settings.ledger
        for name, path in found.items():
            with contextlib.suppress(OSError):
                status = path.stat()
                if self._attached.get(name) != (status.st_mtime_ns, status.st_ino):
                    of_daemon = path.parent == self._runtime.directory
                    data = (
                        msgspec.json.encode(self._runtime.known(name))
                        if of_daemon
                        else input_file.read(path, largest=PENDING_MAX, links=True)
                    )
                    age_ns = max(0, time.time_ns() - status.st_mtime_ns)
                    if self._looked_ns >= part.opened_ns:
                        age_ns = min(age_ns, now_ns - self._looked_ns)
                    part.attach(name, data, now_ns, age_ns)
                    self._attached[name] = (status.st_mtime_ns, status.st_ino)
        self._looked_ns = now_ns

    def as_dict(self) -> dict[str, Any]:
        """Figures for the state message: file, amount written, losses and failures."""
        part = self._part
        return {
            "folder": str(self.folder),
            "file": part.disk.path.name if part is not None else None,
            "part": self._number,
            "bytes": part.size if part is not None else 0,
            "pending_bytes": part.disk.pending if part is not None else 0,
            "records": self.records,
            "frames": self.frames,
            "records_lost": self._slots["records"].lost,
            "frames_lost": self._slots["frames"].lost,
            "failures": self.failures,
        }

    @property
    def failures(self) -> int:
        """Number of failed writes."""
        return self._failed + (self._part.disk.failures if self._part is not None else 0)


def _lines_after(audit_log: pathlib.Path, number: int) -> list[bytes]:
    """Lines of the audit log after an entry, from the last ``_AUDIT_TAIL`` bytes."""
    try:
        if not audit_log.is_file():
            return []
        with audit_log.open("rb") as stream:
            stream.seek(0, os.SEEK_END)
            stream.seek(max(0, stream.tell() - _AUDIT_TAIL))
            lines = stream.read().splitlines(keepends=True)
    except OSError:
        return []
    found = []
    for line in lines:
        with contextlib.suppress(ChainError):
            if read_line(line)[0].n > number:
                found.append(line)
    return found
