"""The audit log's file, which only grows. A line left incomplete by a crash or a full disk is cut off and reported.

One recorder writes it and checks it again before each write, and at intervals: if it was removed, replaced or cut short
while the daemon ran, an entry says so.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from rigctl.config import input_file
from rigctl.recorder.chain import ORIGIN, AuditEntry, ChainError, line_of, read_line

TAIL_BYTES = 1 << 16  # no line is longer
KEPT_OF_TORN = 400


class AuditError(RuntimeError):
    """The log cannot be used; ``str()`` is one line."""


@dataclass(frozen=True)
class Item:
    """An entry to be written, without its place in the chain. ``wall_ns``: wall clock at ``t_ns``."""

    t_ns: int
    wall_ns: int
    what: str
    text: str
    who: str = ""
    details: dict[str, Any] = field(default_factory=dict)
    source: str = "recorder"
    seq: int = 0


def moment(wall_ns: int) -> str:
    """A wall-clock time in the log's format."""
    seconds, rest_ns = divmod(wall_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest_ns // 1_000_000:03d}Z"


class AuditLog:
    """One rig's log, open for appending; ``entries``: number of entries, ``head``: hash of the last."""

    def __init__(self, path: pathlib.Path, rig: str, at_least: int = 0) -> None:
        """``at_least``: number of entries known to have been written."""
        self.path, self._rig, self._at_least = path, rig, at_least
        self._fd = -1
        self._size = self._inode = 0
        self.entries, self.head = 0, ORIGIN
        self.read: dict[str, int] = {}  # of the last line
        self.changes: list[str] = []
        """How others have changed the log while this one was open, in words."""
        self._found: list[tuple[str, str, dict[str, Any]]] = []  # findings to be written before anything else

    @property
    def _torn(self) -> pathlib.Path:
        """File that keeps an incomplete line from its removal until the entry about it is written."""
        return self.path.with_name(f"{self.path.name}.torn")

    def open(self) -> None:
        """Open or create the log and cut off an incomplete last line.

        Raises:
            AuditError: it belongs to another rig, or its last line is not an entry.
            OSError: it cannot be read or written.
        """
        how = self.changed()
        self.close()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # A link is not followed: as root it could lead to any file.
        fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC, 0o640)
        try:
            self._take_up(fd, how)
        except BaseException:
            os.close(fd)
            raise
        self._fd = fd

    def _take_up(self, fd: int, how: str) -> None:
        status = os.fstat(fd)
        found, own, whole, torn = last_line(fd, self.path, self._rig)
        if torn:
            self._keep(torn)
            os.ftruncate(fd, whole)
            os.fsync(fd)
        known, has = self.entries, found.n if found else 0
        if (known and own != self.head) or has < self._at_least:
            details = {"entries": max(known, self._at_least), "head": self.head, "found": has, "found_head": own}
            self.changes.append(how or "was changed or taken away")
            self._found.append(("tampered", f"the log {self.changes[-1]} while the daemon ran", details))
        self._at_least = 0
        if self._torn.exists():
            part = input_file.read(self._torn, largest=64 * TAIL_BYTES)
            details = {"bytes": len(part), "sha256": hashlib.sha256(part).hexdigest(),
                       "begins": part[:KEPT_OF_TORN].decode("ascii", "backslashreplace")}  # fmt: skip
            if not any(what == "repaired" for what, _, _ in self._found):
                self._found.append(("repaired", "half a line at the end of the log was cut off", details))
        self._size, self._inode = whole, status.st_ino
        self.entries, self.head = has, own
        if not known:
            self.read = dict(found.read) if found else {}

    def _keep(self, torn: bytes) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NONBLOCK | os.O_CLOEXEC  # opens a pipe without waiting
        with open(os.open(self._torn, flags | os.O_NOFOLLOW, 0o640), "ab") as file:  # noqa: PTH123 - a descriptor
            file.write(torn)
            file.flush()
            os.fsync(file.fileno())

    def close(self) -> None:
        """Close the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def append(
        self, items: Sequence[Item], read: Sequence[dict[str, int]], t_ns: int = 0, wall_ns: int = 0
    ) -> list[bytes]:
        """Write entries and wait until they are on the disk; all or none. ``read``: positions of the rings in each.

        Returns their lines. Without ``items`` it writes what was found of the log itself, at ``t_ns`` and ``wall_ns``.

        Raises:
            AuditError: see `open`.
            OSError: the write failed; the log is unchanged and the call may be repeated.
        """
        if self._fd < 0 or self.changed():
            self.open()
        t_ns, wall_ns = (items[0].t_ns, items[0].wall_ns) if items else (t_ns, wall_ns)
        said = [Item(t_ns, wall_ns, what, text, details=details) for what, text, details in self._found]
        lines, n, head = [], self.entries, self.head
        for item, state in zip([*said, *items], [*([self.read] * len(said)), *read], strict=True):
            n += 1
            line, head = line_of(
                AuditEntry(n, self._rig, moment(item.wall_ns), item.t_ns, item.what, item.who, item.text, item.details,
                      item.source, item.seq, state, head)
            )  # fmt: skip
            lines.append(line)
        data = b"".join(lines)
        try:
            _write(self._fd, data)
            os.fsync(self._fd)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, self._size)
            self.close()  # the next write opens and checks the file again
            raise
        self._size += len(data)
        self.entries, self.head, self.read = n, head, dict(read[-1]) if read else self.read
        if self._found:
            self._found.clear()
            with contextlib.suppress(OSError):
                self._torn.unlink(missing_ok=True)
        return lines

    def changed(self) -> str:
        """How the file is no longer the one that the last write left, in words; "" while it is, or is not open."""
        if self._fd < 0:
            return ""
        try:
            status = self.path.stat()
        except FileNotFoundError:
            return "was renamed or deleted"
        if status.st_ino != self._inode:
            return "was replaced by another file"
        if status.st_size < self._size:
            return f"was cut from {self._size} to {status.st_size} bytes"
        return "was written to by another program" if status.st_size > self._size else ""


def _write(fd: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]


def last_line(fd: int, path: pathlib.Path, rig: str) -> tuple[AuditEntry | None, str, int, bytes]:
    """The last whole entry (None in an empty log), its hash, the offset of its end, and an incomplete line after it.

    Raises:
        AuditError: the file is another rig's log or not a log.
    """
    size = os.fstat(fd).st_size
    start = max(0, size - 2 * TAIL_BYTES)
    tail = os.pread(fd, size - start, start)
    end = tail.rfind(b"\n") + 1
    if not end and start:
        raise AuditError(f"{path}: no audit log: it does not end in lines")
    torn, tail = tail[end:], tail[:end]
    if not tail:
        return None, ORIGIN, 0, torn
    line = tail[tail.rfind(b"\n", 0, -1) + 1 :]
    try:
        entry, own = read_line(line)
    except ChainError as error:
        raise AuditError(f"{path}: no audit log, or broken: its last line: {error}") from None
    if entry.rig != rig:
        raise AuditError(f"{path}: found the audit log of {entry.rig!r}, expected that of {rig!r}")
    return entry, own, start + end, torn


def check(path: pathlib.Path, rig: str) -> None:
    """Refuse a log that cannot be continued; a missing log, or an incomplete last line, is accepted.

    Raises:
        AuditError: the message is one line.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return
    except OSError as error:
        raise AuditError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        if not path.is_file():
            raise AuditError(f"{path}: cannot be read: not a file")
        last_line(fd, path, rig)
    except OSError as error:
        raise AuditError(f"{path}: cannot be read: {error.strerror}") from None
    finally:
        os.close(fd)
