"""Run-time folders on this computer whose files this user may believe.

In ``/dev/shm`` anyone can make a folder of any name, so only a folder of this user is believed. In ``/run/rigctl``,
which the service manager makes for the installed service, a folder of the service's user is believed too. A folder
that others may write to, or a link, is believed nowhere.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import stat
from collections.abc import Iterator

from rigctl.config import layout


def entered_folders(*, of_others: bool = False) -> Iterator[tuple[pathlib.Path, int]]:
    """Every run-time folder that this user may believe and enter, in the order of their names, and its owner.

    ``of_others``: those that he may enter without believing them. Nobody but the owner writes to these either.
    """
    for base in (layout.RUN, layout.SHARED_MEMORY):
        with contextlib.suppress(OSError):
            owners = _owners(base)
            for folder in sorted(base.glob("rigctl-*")):
                with contextlib.suppress(OSError):
                    found = folder.lstat()
                    wanted = {found.st_uid} - owners if of_others else owners
                    if _is_trusted(found, wanted) and os.access(folder, os.X_OK):
                        yield folder, found.st_uid


def opened(folder: pathlib.Path) -> int | None:
    """A descriptor of a run-time folder, by which nobody can put another in its place; None if it is not believed."""
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        if _is_trusted(os.fstat(fd), _owners(folder.parent)):
            return fd
        os.close(fd)
    return None


def _owners(base: pathlib.Path) -> set[int]:
    return {os.geteuid()} | (_service_owners(base) if base == layout.RUN else set())


def _service_owners(base: pathlib.Path) -> set[int]:
    """Owners besides this user whose folders in the service's ``base`` are believed: none if anyone may make one."""
    found = base.lstat()
    closed = stat.S_ISDIR(found.st_mode) and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    parent = base.parent.lstat()
    of_root = parent.st_uid == 0 and not parent.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return {found.st_uid} if closed and of_root else set()


def _is_trusted(found: os.stat_result, owners: set[int]) -> bool:
    closed = not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(found.st_mode) and found.st_uid in owners and closed
