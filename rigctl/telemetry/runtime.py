"""The running daemon's folder in memory: rings, the resolved configuration, and the lock that makes it the only one.

``/dev/shm/rigctl-<rig>/``: ``records events frames commands replies notes desk supervision`` (rings), ``active.json``
(what runs), ``recorder.json`` (what the recorder has kept),
``control.json`` (what the control process read back), ``calibration.json`` (the cell's zero, scale and due date in
force), ``stroke.json`` (the stroke last known when the control process started), ``lease.json`` (who may command),
``gateway.*`` (the gateway's own), ``lock`` (held by the supervisor, with its pid in it).
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pathlib
from typing import Any

import msgspec

from rigctl.config import RigSettings
from rigctl.telemetry import record
from rigctl.telemetry.ring import RingReader, RingWriter, create

ACTIVE = "active.json"
RECORDED = "recorder.json"
BASE = pathlib.Path("/dev/shm")
"""Where the folders of all daemons of this computer are."""
_SMALL_RING = 4096
_NOTES = 1024
_SHORTEST_FRAME_BITS = 47  # 11-bit identifier, no data, no stuffing, the gap to the next frame
_FASTEST_BIT_S = 1_000_000
_FILES = (
    "records", "events", "frames", "commands", "replies", "notes", "desk", "supervision", "active.json",
    "control.json", "recorder.json", "stroke.json", "calibration.json", "lease.json", "gateway.cursor", "gateway.sock",
    "gateway.sock.lock",
)  # fmt: skip


class AlreadyRunningError(RuntimeError):
    """Another daemon holds this rig."""


def frames_held(settings: RigSettings) -> int:
    """Frames a bus that is full all the time carries while the records' ring fills."""
    rate_hz = (settings.can.bitrate_bit_s or _FASTEST_BIT_S) // _SHORTEST_FRAME_BITS
    return rate_hz * settings.telemetry.history_s


def recorded() -> list[dict[str, Any]]:
    """What the recorders of this machine's daemons say; that of one which has ended is left out."""
    found = []
    for folder in sorted(BASE.glob("rigctl-*")):
        with contextlib.suppress(OSError, msgspec.MsgspecError):  # another user's, or going away
            runtime = Runtime(folder)
            runs = pathlib.Path(f"/proc/{runtime.read_json(ACTIVE).get('pid', 0)}").exists()
            if runs and (told := runtime.read_json(RECORDED)):
                found.append(told)
    return found


def daemons(base: pathlib.Path = BASE) -> list[tuple[str, int]]:
    """Rig and process of every daemon that runs on this computer, by the pid in its lock."""
    found = []
    for lock in sorted(base.glob("rigctl-*/lock")):
        with contextlib.suppress(OSError, ValueError):  # going away, or not written yet
            pid = int(lock.read_text())
            if _alive(pid):
                found.append((lock.parent.name.removeprefix("rigctl-"), pid))
    return found


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


class Runtime:
    """Paths of one rig's rings and files; every process of the daemon opens what it needs."""

    def __init__(self, directory: str | pathlib.Path) -> None:
        self.directory = pathlib.Path(directory)

    @classmethod
    def of(cls, rig: str) -> Runtime:
        """Where the daemon of ``rig`` keeps its folder."""
        return cls(BASE / f"rigctl-{rig}")

    def claim(self) -> int:
        """Become the only daemon of this rig; returns the lock's file descriptor, held until the process ends.

        Raises:
            AlreadyRunningError: naming the process that holds it.
        """
        self.directory.mkdir(mode=0o700, exist_ok=True)
        fd = os.open(self.directory / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            pid = os.read(fd, 20).decode(errors="replace").strip() or "unknown"
            os.close(fd)
            raise AlreadyRunningError(f"another daemon (process {pid}) already runs this rig") from None
        os.ftruncate(fd, 0)
        os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
        return fd

    def make_rings(self, settings: RigSettings) -> None:
        """Fresh, empty rings."""
        create(self.records, record.RECORD.dtype, settings.loop.rate_hz * settings.telemetry.history_s)
        create(self.events, record.EVENT.dtype, _SMALL_RING)
        create(self.commands, record.COMMAND.dtype, _SMALL_RING)
        create(self.replies, record.REPLY.dtype, _SMALL_RING)
        create(self.notes, record.NOTE.dtype, _NOTES)
        create(self.desk, record.DESK.dtype, _NOTES)
        create(self.supervision, record.NOTE.dtype, _NOTES)
        create(self.frames, record.FRAME.dtype, frames_held(settings))

    def remove(self) -> None:
        """Take the folder away; readers that still map a ring keep it until they let go."""
        for folder in self.directory.glob("warm-up-*"):
            Runtime(folder).remove()
        for file in (*_FILES, "lock"):
            with contextlib.suppress(FileNotFoundError):
                (self.directory / file).unlink()
        with contextlib.suppress(OSError):
            self.directory.rmdir()

    @property
    def records(self) -> pathlib.Path:
        """Ring of ``record.RECORD``, written by the control process."""
        return self.directory / "records"

    @property
    def events(self) -> pathlib.Path:
        """Ring of ``record.EVENT``, written by the control process."""
        return self.directory / "events"

    @property
    def commands(self) -> pathlib.Path:
        """Ring of ``record.COMMAND``, written by the gateway."""
        return self.directory / "commands"

    @property
    def replies(self) -> pathlib.Path:
        """Ring of ``record.REPLY``, written by the control process."""
        return self.directory / "replies"

    @property
    def notes(self) -> pathlib.Path:
        """Ring of ``record.NOTE``, written by the gateway."""
        return self.directory / "notes"

    @property
    def desk(self) -> pathlib.Path:
        """Ring of ``record.DESK``, written by the gateway."""
        return self.directory / "desk"

    @property
    def supervision(self) -> pathlib.Path:
        """Ring of ``record.NOTE``, written by the supervisor."""
        return self.directory / "supervision"

    @property
    def frames(self) -> pathlib.Path:
        """Ring of ``record.FRAME``, written by the control process."""
        return self.directory / "frames"

    @property
    def gateway_cursor(self) -> pathlib.Path:
        """How far the gateway has published, for the one that follows it."""
        return self.directory / "gateway.cursor"

    @property
    def gateway_socket(self) -> pathlib.Path:
        """Where the gateway's command session reaches its router."""
        return self.directory / "gateway.sock"

    def record_reader(self, *, from_start: bool = False) -> RingReader:
        """A reader of the records."""
        return RingReader(self.records, record.RECORD.dtype, from_start=from_start)

    def event_reader(self, *, from_start: bool = False) -> RingReader:
        """A reader of the events."""
        return RingReader(self.events, record.EVENT.dtype, from_start=from_start)

    def note_reader(self, *, from_start: bool = False) -> RingReader:
        """A reader of the notes."""
        return RingReader(self.notes, record.NOTE.dtype, from_start=from_start)

    def command_reader(self, *, from_start: bool = False) -> RingReader:
        """A reader of the commands given from now on, or still held."""
        return RingReader(self.commands, record.COMMAND.dtype, from_start=from_start)

    def reply_reader(self, *, from_start: bool = False) -> RingReader:
        """A reader of the replies given from now on, or still held."""
        return RingReader(self.replies, record.REPLY.dtype, from_start=from_start)

    def desk_reader(self) -> RingReader:
        """A reader of what was asked at the gateway's desk, from the oldest still held."""
        return RingReader(self.desk, record.DESK.dtype, from_start=True)

    def supervision_reader(self) -> RingReader:
        """A reader of what the supervisor did, from the oldest still held."""
        return RingReader(self.supervision, record.NOTE.dtype, from_start=True)

    def frame_reader(self) -> RingReader:
        """A reader of the frames, from the oldest still held."""
        return RingReader(self.frames, record.FRAME.dtype, from_start=True)

    def record_writer(self) -> RingWriter:
        """The writer of the records (control process)."""
        return RingWriter(self.records, record.RECORD.layout)

    def event_writer(self) -> RingWriter:
        """The writer of the events (control process)."""
        return RingWriter(self.events, record.EVENT.layout)

    def command_writer(self) -> RingWriter:
        """The writer of the commands (gateway)."""
        return RingWriter(self.commands, record.COMMAND.layout)

    def reply_writer(self) -> RingWriter:
        """The writer of the replies (control process)."""
        return RingWriter(self.replies, record.REPLY.layout)

    def note_writer(self) -> RingWriter:
        """The writer of the notes (gateway)."""
        return RingWriter(self.notes, record.NOTE.layout)

    def desk_writer(self) -> RingWriter:
        """The writer of what is asked at the desk (gateway)."""
        return RingWriter(self.desk, record.DESK.layout)

    def supervision_writer(self) -> RingWriter:
        """The writer of what is done about the processes (supervisor)."""
        return RingWriter(self.supervision, record.NOTE.layout)

    def frame_writer(self) -> RingWriter:
        """The writer of the frames (control process)."""
        return RingWriter(self.frames, record.FRAME.layout)

    def write_json(self, name: str, value: Any) -> None:
        """Replace ``name`` at once, so that a reader sees the old file or the new one."""
        part = self.directory / f"{name}.new"
        part.write_bytes(msgspec.json.encode(value))
        part.rename(self.directory / name)

    def read_json(self, name: str) -> dict[str, Any]:
        """``name``, or an empty dict while it is not there."""
        try:
            value = msgspec.json.decode((self.directory / name).read_bytes())
        except FileNotFoundError:
            return {}
        return value if isinstance(value, dict) else {}
