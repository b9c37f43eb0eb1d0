"""Replaces a file whole or not at all, so that a reader finds the old content or the new."""

from __future__ import annotations

import contextlib
import os
import pathlib
import stat

NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
"""Flags that make a file anew, in place of nothing that somebody else could have put there."""


def replace(path: pathlib.Path, data: bytes, *, mode: int, sync: bool = True) -> None:
    """Replace ``path``, with its folder if need be.

    ``sync``: wait until it is on the disk; without it a power cut may leave an older file.

    Raises:
        OSError: the file could not be written and is unchanged.
    """
    part = path.with_name(f"{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, NEW, mode), "wb") as file:
            file.write(data)
            file.flush()
            if sync:
                os.fsync(file.fileno())
        part.replace(path)
        if sync:
            sync_folder(path.parent)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def over(path: pathlib.Path, data: bytes) -> bool:
    """Write over a file in the memory that it has, the rest filled with line ends; False where that is too little."""
    with contextlib.suppress(OSError):
        fd = os.open(path, os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            found = os.fstat(fd)
            if stat.S_ISREG(found.st_mode) and found.st_nlink == 1 and len(data) <= found.st_blocks * 512:
                os.pwrite(fd, data.ljust(found.st_size, b"\n"), 0)
                return True
        finally:
            os.close(fd)
    return False


def sync_folder(folder: pathlib.Path) -> None:
    """Write a folder to disk: without this a power cut may lose a new name in it."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
