"""Where the small files of a daemon's run-time folder are, whose daemon runs in it, and a file's content by its seal.

It loads no msgspec, neither rings nor numpy: the way of ``rigctl hold`` costs little more than the interpreter's start.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pathlib

from rigctl.config import input_file, layout
from rigctl.ipc import writers

ACTIVE = "active.json"
PUBLIC = "public.json"
"""The public file, by which a client finds the daemon of an endpoint, and its name in the version before."""
GATEWAY_SOCKET, COMMAND_SOCKET = "gateway.sock", "command.sock"
LOCK = "lock"
LONGEST_LOCK, _LARGEST_PID = 20, 1 << 22


class DigestError(ValueError):
    """The content of a file does not give the SHA-256 on its last line."""


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


class FolderPlaces:
    """Places in one rig's run-time folder."""

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

    def sealed(self, name: str) -> bytes:
        """Content of ``name`` without its seal.

        Raises:
            OSError: it cannot be read, or is no file.
            DigestError: its checksum is wrong.
        """
        data, _, seal = input_file.read(self.place(name)).rstrip(b"\n").rpartition(b"\n")
        if seal != digest(data):
            raise DigestError("its content does not give its SHA-256")
        return data
