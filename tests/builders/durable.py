"""What has been brought to the disk: every fsync and every rename of this process, in their order."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable

import pytest


class Disk:
    """Notes from its making on, by inode: the size that was synced, and the names that were given."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._events: list[tuple[str, int, int]] = []
        sync = os.fsync

        def fsync(fd: int) -> None:
            status = os.fstat(fd)
            self._events.append(("sync", status.st_ino, status.st_size))
            sync(fd)

        patch.setattr(os, "fsync", fsync)
        for name in ("rename", "replace"):
            patch.setattr(os, name, self._noting(getattr(os, name)))

    def _noting(self, move: Callable[..., None]) -> Callable[..., None]:
        def moved(source: str, target: str) -> None:
            self._events.append(("name", os.stat(source).st_ino, 0))  # noqa: PTH116 - as it is called
            move(source, target)

        return moved

    def holds(self, path: pathlib.Path) -> bool:
        """Whether all of a file has been synced, after its last growth."""
        status = path.stat()
        return ("sync", status.st_ino, status.st_size) in self._events

    def replaced(self, path: pathlib.Path) -> bool:
        """Whether a file would be whole under its name after a power cut: content, then name, then folder."""
        status, folder = path.stat(), path.parent.stat()
        wanted = [("sync", status.st_ino, status.st_size), ("name", status.st_ino, 0)]
        if wanted[1] not in self._events:
            return False
        named = self._events.index(wanted[1])
        after = [(what, inode) for what, inode, _ in self._events[named:]]
        return wanted[0] in self._events[:named] and ("sync", folder.st_ino) in after
