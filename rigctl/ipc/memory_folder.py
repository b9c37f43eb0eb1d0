"""A folder in shared memory for the rings of one simulated or replayed run; it goes with the process that made it.

The process that makes a folder holds a lock on the file ``owner`` in it. The kernel frees the lock when the process
ends, however it ends, and all that it forked: a folder of this user whose lock is free belongs to no process, also of
another container, and the next run removes it.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import pathlib
import shutil
import stat
import tempfile
from collections.abc import Iterator

from rigctl.config import layout

_OWNER = "owner"
_MADE = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_FOUND = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


@contextlib.contextmanager
def memory_folder(prefix: str, base: pathlib.Path = layout.SHARED_MEMORY) -> Iterator[pathlib.Path]:
    """A new folder, removed afterwards; those of ``prefix`` that ended processes have left are removed first.

    ``base``: parent of the folder; where it does not exist, that of temporary files.

    Raises:
        OSError: it cannot be made.
    """
    parent = base if base.is_dir() else pathlib.Path(tempfile.gettempdir())
    _remove_left(parent, prefix)
    folder, maker = pathlib.Path(tempfile.mkdtemp(prefix=prefix, dir=parent)), os.getpid()
    try:
        lock = os.open(folder / f".{_OWNER}", _MADE, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            (folder / f".{_OWNER}").rename(folder / _OWNER)  # with the lock: no other run finds it free before
            yield folder
        finally:
            os.close(lock)
    finally:
        if os.getpid() == maker:  # a forked process leaves it to the one that goes on
            _free(folder)
            shutil.rmtree(folder, ignore_errors=True)


def _free(folder: pathlib.Path) -> None:
    """Free the memory of its files now: a file that is only removed keeps it until nothing maps it any more."""
    for file in folder.iterdir():
        with (
            contextlib.suppress(OSError, ValueError),  # no file, or an empty one
            file.open("r+b") as opened,
            mmap.mmap(opened.fileno(), 0) as memory,
        ):
            memory.madvise(mmap.MADV_REMOVE)


def _remove_left(parent: pathlib.Path, prefix: str) -> None:
    """Remove the folders of this user that no process holds. One without the file ``owner`` is just being made."""
    for folder in parent.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # held, another user's, or just being removed
            found = folder.lstat()
            if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid():
                continue
            lock = os.open(folder / _OWNER, _FOUND)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)
