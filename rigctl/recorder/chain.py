"""The chain of an audit log: one line for each entry, which carries the hash of the line before and its own.

A line is the entry as canonical JSON (keys sorted, no spaces) with its own hash as the last key: the SHA-256 of the
line without that key. A line that is changed, removed, inserted or moved breaks the chain after it. A chain computed
anew, or cut off at its end, is detected by a head hash noted elsewhere.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from rigctl.config.built_type import built

ORIGIN = "0" * 64
"""The hash that the first entry gives as its previous one."""
_END = re.compile(rb',"hash":"([0-9a-f]{64})"\}\Z')
_END_SIZE = len(',"hash":"') + 64 + len('"}')


class ChainError(ValueError):
    """A line that breaks the chain; ``str()`` says why."""


@built
class AuditEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One line without its hash.

    ``n`` counts from 1. ``wall`` is ISO 8601 UTC, ``t_ns`` the same moment on the daemon's CLOCK_MONOTONIC. ``seq`` is
    its number in the ring ``source``, 0 for an entry of the recorder itself. ``read``: how far each ring is in the log.
    """

    n: int
    rig: str
    wall: str
    t_ns: int
    what: str
    who: str
    text: str
    details: dict[str, Any]
    source: str
    seq: int
    read: dict[str, int]
    previous: str


def canonical(value: Any) -> bytes:
    """Canonical JSON of a value: keys sorted, no spaces, NaN as null."""
    return msgspec.json.encode(value, order="sorted")


def line_of(entry: AuditEntry) -> tuple[bytes, str]:
    """The line with its line end, and its hash."""
    body = canonical(entry)
    own = hashlib.sha256(body).hexdigest()
    return body[:-1] + b',"hash":"' + own.encode() + b'"}\n', own


def read_line(line: bytes) -> tuple[AuditEntry, str]:
    """The entry of a line, with its hash.

    Raises:
        ChainError: the line is cut off, is not an entry, or was changed after it was written.
    """
    if not line.endswith(b"\n"):
        raise ChainError("truncated: it has no end")
    line = line[:-1]
    found = _END.search(line)
    if found is None:
        raise ChainError("edited: no entry with its hash")
    body, own = line[:-_END_SIZE] + b"}", found[1].decode()
    if hashlib.sha256(body).hexdigest() != own:
        raise ChainError("edited: its content is not what its hash says")
    try:
        entry = msgspec.json.decode(body, type=AuditEntry)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ChainError(f"edited: {' '.join(str(error).split())}") from None
    if canonical(entry) != body:
        raise ChainError("edited: not in canonical form")
    return entry, own


@dataclass(frozen=True)
class Verification:
    """Result of a verification: figures of the intact entries and, if the chain breaks, where and why."""

    entries: int
    rig: str = ""
    first: str = ""
    last: str = ""
    head: str = ORIGIN
    line: int = 0  # the first that breaks the chain, 0 for none
    why: str = ""
    head_line: int = 0  # line with the head hash that was looked for

    @property
    def good(self) -> bool:
        """The chain holds."""
        return not self.why


def _misplaced(entry: AuditEntry, due: int, previous: str) -> str:
    """Why an entry does not follow the one before; empty if it does."""
    if entry.n > due:
        gone = f"entry {due} is" if entry.n == due + 1 else f"entries {due} to {entry.n - 1} are"
        return f"removed or reordered: {gone} missing before entry {entry.n}"
    if entry.n < due:
        return f"reordered or repeated: found entry {entry.n} where entry {due} is due"
    if entry.previous != previous:
        return "edited: the line before it is not the one it was written after"
    return ""


def verify(lines: Iterable[bytes], head: str | None = None) -> Verification:
    """Follow the chain from the first line; ``head``: a hash that was once at its end."""
    report = Verification(0)
    for number, line in enumerate(lines, 1):
        try:
            entry, own = read_line(line)
            why = _misplaced(entry, report.entries + 1, report.head)
            if not why and number > 1 and entry.rig != report.rig:
                why = f"edited: an entry of {entry.rig!r} in the log of {report.rig!r}"
        except ChainError as error:
            why = str(error)
        if why:
            return replace(report, line=number, why=why)
        head_line = number if own == head else report.head_line
        report = Verification(number, entry.rig, report.first or entry.wall, entry.wall, own, head_line=head_line)
    if head is not None and not report.head_line and head != ORIGIN:
        return replace(report, line=report.entries + 1, why=f"truncated: the head {head[:16]}... is not in it")
    return report
