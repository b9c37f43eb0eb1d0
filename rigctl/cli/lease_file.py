"""The file in which the command line keeps a lease's id for the operator's next command.

There is one small file for each rig, endpoint and operator's name, in the user's runtime folder: the terminals of one
user on one machine share it, other users cannot read it. An unreadable file counts as absent.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pathlib
import stat
import tempfile

from rigctl.model.lease_acts import is_id

_LONGEST = 64


def folder() -> pathlib.Path:
    """``$XDG_RUNTIME_DIR/rigctl``, or ``/tmp/rigctl-UID`` without that variable."""
    given = os.environ.get("XDG_RUNTIME_DIR")
    if given and pathlib.Path(given).is_absolute():
        return pathlib.Path(given) / "rigctl"
    return pathlib.Path(tempfile.gettempdir()) / f"rigctl-{os.getuid()}"


def is_ours(path: pathlib.Path) -> bool:
    """Whether only this user owns and enters a folder; in ``/tmp`` anyone may have created it.

    Raises:
        OSError: there is none.
    """
    found = path.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077


class LeaseFile:
    """The id kept for one operator of one rig."""

    def __init__(self, rig: str, endpoint: str, operator: str) -> None:
        digest = hashlib.sha256(f"{endpoint}\n{operator}".encode()).hexdigest()[:16]
        self.path = folder() / f"{rig}-{digest}"

    def read(self) -> str | None:
        """The id; None without one, or if another user could have written it."""
        with contextlib.suppress(OSError):
            if is_ours(self.path.parent):
                fd = os.open(self.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
                with os.fdopen(fd, "rb") as file:
                    id_ = file.read(_LONGEST).decode(errors="replace").strip()
                    return id_ if is_id(id_) else None
        return None

    def write(self, id_: str) -> None:
        """Store ``id_``; if that fails, the next command has no lease to continue."""
        part = self.path.with_name(f"{self.path.name}.{os.getpid()}")
        with contextlib.suppress(OSError):
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if is_ours(self.path.parent):
                fd = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
                with os.fdopen(fd, "w") as file:
                    file.write(id_ + "\n")
                part.rename(self.path)

    def forget(self) -> None:
        """Delete the stored id."""
        with contextlib.suppress(OSError):
            self.path.unlink()
