"""The folders that a rig writes to, and the room on their disks."""

from __future__ import annotations

import os
import pathlib
from dataclasses import dataclass

from rigctl.config import layout
from rigctl.config.settings import RigSettings

MIB = 1 << 20


@dataclass(frozen=True)
class Folder:
    """A folder the rig writes to, its free space (None: unknown), and whether this process may write there."""

    path: pathlib.Path
    free_mib: int | None
    writable: bool = True


def folders(settings: RigSettings) -> list[Folder]:
    """Folders the rig file has written to: one for each disk, and each folder this process may not write to."""
    file = settings.ledger
    # In the installed service only the ledger is this process's to write; the recorder reports what it cannot.
    apart = layout.is_installed(settings.directory)
    places = [*([file.parent] if file else []), settings.audit_log.parent, settings.kept(settings.audit.trips)]
    found: dict[int, Folder] = {}
    for place in places:
        there = next((path for path in (place, *place.parents) if path.is_dir()), pathlib.Path("/"))
        try:
            free = os.statvfs(there)
            judged = not apart or (file is not None and place == file.parent)
            writable = not judged or os.access(there, os.W_OK | os.X_OK, effective_ids=True)
            disk = there.stat().st_dev if writable else -len(found) - 1
            found.setdefault(disk, Folder(place, free.f_bavail * free.f_frsize // MIB, writable))
        except OSError:
            found.setdefault(-len(found) - 1, Folder(place, None))
    return list(found.values())
