"""``rigctl audit``: verifies the audit log and shows its entries."""

from __future__ import annotations

import os
import pathlib
import re
from collections import deque
from collections.abc import Iterator
from datetime import UTC, datetime
from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer

from rigctl.cli.options import BAD, DONE, USAGE, end, load_rig_file, number_option, say, say_json
from rigctl.config.typed_number import TypedNumber
from rigctl.model.quantity import count

if TYPE_CHECKING:
    from rigctl.config.settings import RigSettings
    from rigctl.recorder.chain import AuditEntry, Verification

LINE_BYTES = 1 << 17  # the recorder writes no longer line
_RIG_FILES = (".yaml", ".yml")
_HASH = re.compile("[0-9a-f]{64}")


class AuditTask(Enum):
    """What to do with the log."""

    VERIFY = "verify"
    SHOW = "show"


What = Annotated[AuditTask, typer.Argument(metavar="verify|show", help="What to do.")]
Log = Annotated[
    pathlib.Path | None,
    typer.Argument(metavar="[FILE]", help="Audit log, or the rig file it belongs to [the running daemon's]."),
]
Head = Annotated[
    str | None, typer.Option(metavar="HASH", help="verify: a head hash noted before; the log must still have it.")
]
Last = Annotated[
    int | None,
    number_option(
        TypedNumber("entries", least=1, whole=True), "--last", metavar="N", help="show: only the last N that fit."
    ),
]
Since = Annotated[str | None, typer.Option(metavar="TIME", help="show: only from then on, ISO 8601 (local time).")]
Named = Annotated[
    str | None, typer.Option("--what", metavar="TEXT", help="show: only what is called so (a part of it).")
]
By = Annotated[str | None, typer.Option("--who", metavar="NAME", help="show: only what this operator did.")]
AsJson = Annotated[bool, typer.Option("--json", help="verify: print JSON; show: one JSON object in each line.")]


def audit(
    act: What,
    file: Log = None,
    head: Head = None,
    last: Last = None,
    since: Since = None,
    what: Named = None,
    who: By = None,
    json: AsJson = False,
) -> None:
    """Verify the audit log's chain of hashes, or show what is in it.

    Lines that were edited, removed, swapped or inserted break the chain. Lines cut off at the end are found out with
    --head (note the hash that verify prints, or take it from a trip dump or from rigctl status --json), or with the
    rig file instead of the log: then the head that the recorder has sealed is looked for.
    """
    if act is AuditTask.SHOW and head is not None:
        end(USAGE, "found --head, expected with verify alone")
    if act is AuditTask.VERIFY and (last, since, what, who) != (None, None, None, None):
        end(USAGE, "found a choice of entries, expected with show alone: the chain is verified as a whole")
    if head is not None and not _HASH.fullmatch(head):
        end(USAGE, f"--head: found {head[:80]!r}, expected 64 letters 0-9 a-f")
    settings = load_rig_file(file) if file is not None and file.suffix in _RIG_FILES else None
    path = settings.audit_log if settings is not None else file or _of_daemon()
    if act is AuditTask.VERIFY:
        _verify(path, head, json, settings)
    else:
        _show(path, last, _moment(since), what, who, json)


def _of_daemon() -> pathlib.Path:
    from rigctl.ipc import runtime_folder as runtime

    found = sorted({str(status["audit_log"]) for status in runtime.recorded() if "audit_log" in status})
    if len(found) != 1:
        many = "no daemon" if not found else f"{len(found)} daemons"
        end(USAGE, f"found {many} on this machine, expected one, or the name of an audit log or rig file")
    return pathlib.Path(found[0])


def _lines(path: pathlib.Path) -> Iterator[bytes]:
    """The lines of a log up to its end at the time of the call; it may grow meanwhile."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(fd, "rb") as stream:
            if not path.is_file():
                end(USAGE, f"{path} cannot be read: not a file")
            left = os.fstat(stream.fileno()).st_size
            while left > 0 and (line := stream.readline(min(left, LINE_BYTES))):
                left -= len(line)
                yield line
    except OSError as error:
        end(USAGE, f"{path} cannot be read: {error.strerror}")


def _verify(path: pathlib.Path, head: str | None, json: bool, settings: RigSettings | None) -> None:
    """Verify the chain, up to the head given, else the one that is sealed beside the log of a rig file."""
    from rigctl.ipc.seal import SealError
    from rigctl.recorder import chain, sealed_head

    if head is None and settings is not None:
        try:
            head = sealed_head.read(settings)
        except SealError as error:
            end(BAD, str(error))
    report = chain.verify(_lines(path), head)
    if json:
        say_json({"file": str(path), "ok": report.good, "entries": report.entries, "rig": report.rig,
                  "first": report.first, "last": report.last, "head": report.head,
                  "line": report.line or None, "why": report.why or None})  # fmt: skip
    elif report.good:
        say(f"{path}: {_figures(report)}{_since_head(report, head)}")
    end(DONE if report.good else BAD, None if report.good or json else f"{path}:{report.line}: {report.why}")


def _figures(report: Verification) -> str:
    if not report.entries:
        return "intact: no entries"
    return f"intact: {count(report.entries, 'entry', 'entries')}, {report.first} to {report.last}, head {report.head}"


def _since_head(report: Verification, head: str | None) -> str:
    if head is None:
        return ""
    return f"; {count(report.entries - report.head_line, 'entry', 'entries')} since the head given or sealed"


def _moment(since: str | None) -> str:
    """``--since`` in the log's format of a time, in which text order is time order."""
    if since is None:
        return ""
    try:
        return f"{datetime.fromisoformat(since).astimezone(UTC):%Y-%m-%dT%H:%M:%S.%f}"[:23]
    except (ValueError, OverflowError, OSError):
        end(USAGE, f"--since: found {since[:80]!r}, expected ISO 8601, as 2025-01-31 or 2025-01-31T14:00")


def _show(
    path: pathlib.Path, last: int | None, since: str, what: str | None, who: str | None, json: bool
) -> None:  # fmt: skip
    from rigctl.recorder.chain import ChainError, read_line

    kept: deque[str | dict[str, object]] = deque(maxlen=last)
    broken = ""
    for number, line in enumerate(_lines(path), 1):
        try:
            entry, own = read_line(line)
        except ChainError as error:
            broken = broken or f"{path}:{number}: {error}"
            continue
        if entry.wall >= since and (what or "") in entry.what and who in (None, entry.who):
            kept.append(_as_dict(entry, own) if json else _words(entry))
    for found in kept:
        if json:
            say_json(found)
        else:
            say(str(found))
    end(BAD if broken else DONE, broken or None)


def _as_dict(entry: AuditEntry, own: str) -> dict[str, object]:
    import msgspec

    return {**msgspec.structs.asdict(entry), "hash": own}


def _words(entry: AuditEntry) -> str:
    by = f"{entry.who}: " if entry.who else ""
    line = f"{entry.wall}  {entry.what:<18} {by}{entry.text}"
    return "".join(letter if letter.isprintable() else "?" for letter in line)
