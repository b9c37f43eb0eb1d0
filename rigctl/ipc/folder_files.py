"""The small files of a daemon's run-time folder: where each is, and its content if seal and shape are right.

It loads neither rings nor numpy, so that ``rigctl hold`` finds its daemon in milliseconds. The folder as a whole, which
the daemon makes and its processes enter, is `rigctl.ipc.runtime_folder.Runtime`.

A file that other processes read has a shape in ``SHAPES``; a file of another shape is not believed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pathlib
from typing import Annotated, Any

import msgspec

from rigctl.config import input_file, layout
from rigctl.config.built_type import built
from rigctl.ipc import writers

ACTIVE = "active.json"
RECORDED = "recorder.json"
DESIGN = "design.json"
LOCK = "lock"
LONGEST_LOCK, _LARGEST_PID = 20, 1 << 22
_Count = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
_Object = dict[str, Any]


@built
class _ActiveFile(msgspec.Struct):
    settings: _Object = {}
    version: str = ""
    started_wall_ns: _Count = 0
    pid: _Count = 0
    run_id: str = ""
    design: _Object = {}


@built
class _AppliedEntry(msgspec.Struct):
    name: str
    in_force: str
    ok: bool
    warning: str = ""


class _StopSetting(msgspec.Struct):
    object: str
    name: str
    wanted: Any
    found: Any
    ok: bool
    why: str = ""


@built
class _ControlFile(msgspec.Struct):
    pid: _Count = 0
    host_checks: _Count = 0
    realtime: list[_AppliedEntry] = []
    warnings: list[str] = []
    supervision: list[_StopSetting] = []


class _RecordingFile(msgspec.Struct):
    folder: str
    file: str | None


@built
class _RecorderFile(msgspec.Struct):
    run: _Count = 0
    pid: _Count = 0
    audit_log: str = ""
    entries: _Count = 0
    head: str = ""
    trip_dump: str | None = None
    recording: _RecordingFile | None = None
    failures: _Count = 0
    warnings: list[str] = []
    t_ns: _Count = 0


@built
class _DesignFile(msgspec.Struct):
    run_id: str
    design: _Object


SHAPES: dict[str, Any] = {
    ACTIVE: _ActiveFile,
    DESIGN: _DesignFile,
    "control.json": _ControlFile,
    RECORDED: _RecorderFile,
}
"""Shapes of the files that the daemon's processes share; the readers of other files check these themselves."""


def daemon_pid(folder: pathlib.Path) -> int:
    """Process of the daemon that runs in a folder, by its lock; 0 without one."""
    with contextlib.suppress(OSError, ValueError):  # just being deleted, or not written yet
        pid = int(input_file.read(folder / LOCK, largest=LONGEST_LOCK))
        if 0 < pid < _LARGEST_PID and _alive(pid):
            return pid
    return 0


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def digest(data: bytes) -> bytes:
    """The seal of a file: its SHA-256 as hexadecimal text."""
    return hashlib.sha256(data).hexdigest().encode()


class FolderFiles:
    """The small files of one rig's run-time folder."""

    def __init__(self, directory: str | pathlib.Path, *, shared: bool | None = None) -> None:
        """``shared``: whether it is the installed service's, which its place shows otherwise."""
        self.directory = folder = pathlib.Path(directory)
        self._shared = folder.parent == layout.RUN if shared is None else shared

    @property
    def is_shared(self) -> bool:
        """Whether it is the installed service's, whose processes are of several users."""
        return self._shared

    def place(self, name: str) -> pathlib.Path:
        """Where a file of this name is: in the folder, or in that of the process that writes it."""
        folder = writers.FOLDER_OF.get(name) if self._shared else None
        return self.directory / name if folder is None else self.directory / folder / name

    @property
    def hold_socket(self) -> pathlib.Path:
        """Socket on which the hold service takes HOLD from processes of this computer."""
        return self.place("hold.sock")

    def mark(self, name: str) -> tuple[int, ...]:
        """Changes whenever `read_json` of ``name`` may give something else.

        Raises:
            OSError: there is no such file.
        """
        found = self.place(name).stat()
        marks: tuple[int, ...] = (found.st_ino, found.st_mtime_ns)
        if name == ACTIVE:
            with contextlib.suppress(OSError):
                design = self.place(DESIGN).stat()
                marks += (design.st_ino, design.st_mtime_ns)
        return marks

    def read_json(self, name: str) -> dict[str, Any]:
        """``name``, or an empty dict while it is not there; the active configuration has the design in force in it.

        Raises:
            OSError: it cannot be read, or is no file.
            msgspec.MsgspecError: its checksum is wrong, it is no JSON object, or has another shape than in ``SHAPES``.
        """
        try:
            data, _, seal = input_file.read(self.place(name)).rstrip(b"\n").rpartition(b"\n")
        except FileNotFoundError:
            return {}
        if seal != digest(data):
            raise msgspec.DecodeError("its content does not give its SHA-256")
        value: dict[str, Any] = input_file.decoded(data, dict[str, Any])
        if (shape := SHAPES.get(name)) is not None:
            msgspec.convert(value, shape)
        if name == ACTIVE and (exchanged := self.read_json(DESIGN)) and exchanged["run_id"] == value.get("run_id"):
            value["design"] = exchanged["design"]
        return value

    def known(self, name: str) -> dict[str, Any]:
        """As `read_json`, but empty where the file is unreadable or invalid, so that recording goes on without it."""
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            return self.read_json(name)
        return {}
