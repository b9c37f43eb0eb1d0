"""The supervisor's notes for the audit log: a ring of ``NOTE`` slots that only the supervisor writes."""

from __future__ import annotations

import contextlib
from enum import IntEnum

from rigctl.ipc.ring import RingWriter


class Doing(IntEnum):
    """Kind of a note of the supervisor; ``other`` is the process, ``reason`` the words."""

    DAEMON_STARTED = 1
    DAEMON_DESIGNED = 2  # reason: the verdict on gains and margins
    DAEMON_REFUSED = 3  # reason: cause of the refusal
    DAEMON_STOPPED = 4  # reason: state of the rig at the end
    PROCESS_STARTED = 5  # reason: its process id
    PROCESS_ENDED = 6  # reason: how it ended, and when it restarts
    PROCESS_STALLED = 7  # reason: no progress, and what it waits for
    PROCESS_RESUMED = 8  # reason: after how long
    FOLDER_LOST = 60  # reason: how the runtime folder was lost


OVER = frozenset({Doing.DAEMON_REFUSED, Doing.DAEMON_STOPPED})
"""The last notes of a run: nothing is recorded after them."""


SUPERVISOR = "supervisor"


class Supervision:
    """Writer of the supervisor's notes."""

    def __init__(self, writer: RingWriter) -> None:
        self._writer = writer

    def note(self, t_ns: int, kind: Doing, *, process: str = "", reason: str = "") -> None:
        """Write one note."""
        self._writer.write(t_ns, int(kind), b"", process.encode(), reason.encode()[:480])


def worded(kind: int, process: str, reason: str) -> tuple[str, str]:
    """Name and one line of a note."""
    with contextlib.suppress(ValueError):
        known = Doing(kind)
        what = f"{process} process" if process else "runtime folder" if known is Doing.FOLDER_LOST else "daemon"
        return known.name.lower(), f"{what} {known.name.split('_')[1].lower()}{f': {reason}' if reason else ''}"
    return str(kind), f"{process} {reason}"
