"""Which process writes what in the run-time folder of the installed service, where each has a user of its own.

The supervisor makes the folder. What another process writes has that process's group, which only its user and the
supervisor's are members of, so that the kernel refuses everyone else. All of them are in the group of the supervisor's
user, which reads. A checkout's daemon is of one user, and its folder has no folders in it.
"""

from __future__ import annotations

import grp
import os
from typing import NamedTuple

RINGS = "rings"
"""Folder of all rings: only the daemon's processes enter it."""
OPERATORS = "rigctl-operator"
"""Group whose members command the installed service."""
VIEWERS = "rigctl-viewer"
"""Group whose members read it."""


class Writer(NamedTuple):
    """``group``: of its user; ``rings``, ``files``: names of what it writes, the files in a folder of its name."""

    group: str
    rings: tuple[str, ...] = ()
    files: tuple[str, ...] = ()


WRITERS = {
    "recorder": Writer("rigctl-recorder", files=("recorder.json",)),
    "gateway": Writer(
        "rigctl-gateway",
        rings=("commands", "notes", "desk"),
        files=(
            "gateway.cursor", "gateway.sock", "command.sock", "public.json", "public_key.json", "lease.json",
            "calibration.json", "design.json",
        ),
    ),
}  # fmt: skip
"""The processes that are services of their own, in the order of their start."""
FOLDER_OF = {
    file: name for name, writer in WRITERS.items() for file in (*writer.files, f"{name}.pid.json", f"{name}.progress")
}
GROUP_OF = {ring: writer.group for writer in WRITERS.values() for ring in writer.rings}


def group_number(name: str) -> int:
    """A group of this computer; -1 without one."""
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        return -1


def group_id(name: str) -> int:
    """A group that this process may give its files to; -1 without one."""
    found = group_number(name)
    return found if os.geteuid() == 0 or found in (os.getegid(), *os.getgroups()) else -1
