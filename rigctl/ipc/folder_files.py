"""The small files of a daemon's run-time folder: where each is, and its content if seal and shape are right.

Their places are in `rigctl.ipc.folder_places`. The folder as a whole, which the daemon makes and its processes enter,
is `rigctl.ipc.runtime_folder.Runtime`.

A file that other processes read has a shape in ``SHAPES``; a file of another shape is not believed.
"""

from __future__ import annotations

import contextlib
from typing import Annotated, Any

import msgspec

from rigctl.config import input_file
from rigctl.config.built_type import built
from rigctl.ipc.folder_places import ACTIVE, DigestError, FolderPlaces

RECORDED = "recorder.json"
DESIGN = "design.json"
REFUSED = "refused.json"
"""Why the control process did not start, from it to the supervisor."""
WAITS = "waits.json"
"""What the start of the control process waits for, from it to the supervisor."""
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
    rig: str = ""
    trips: str = ""
    pid: _Count = 0
    audit_log: str = ""
    entries: _Count = 0
    head: str = ""
    trip_dump: str | None = None
    recording: _RecordingFile | None = None
    failures: _Count = 0
    changes: _Count = 0
    changed: str = ""
    warnings: list[str] = []
    t_ns: _Count = 0


@built
class _RefusedFile(msgspec.Struct):
    why: str = ""


@built
class _WaitsFile(msgspec.Struct):
    waits_for: str = ""


@built
class _DesignFile(msgspec.Struct):
    run_id: str
    design: _Object


SHAPES: dict[str, Any] = {
    ACTIVE: _ActiveFile,
    DESIGN: _DesignFile,
    "control.json": _ControlFile,
    RECORDED: _RecorderFile,
    REFUSED: _RefusedFile,
    WAITS: _WaitsFile,
}
"""Shapes of the files that the daemon's processes share; the readers of other files check these themselves."""


class FolderFiles(FolderPlaces):
    """The small files of one rig's run-time folder."""

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
            data = self.sealed(name)
        except FileNotFoundError:
            return {}
        except DigestError as error:
            raise msgspec.DecodeError(str(error)) from None
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
