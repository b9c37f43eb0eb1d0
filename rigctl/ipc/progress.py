"""Progress of the daemon's processes: each counts its turns in shared memory, and others see that one has stopped.

A process that hangs is one without progress whose main thread sleeps, is stopped, or has used more than half of a
processor. One that waits for a processor or a disk does not: a computer that is stalled or busy has no process hang.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import struct
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

from rigctl.ipc import whole_file
from rigctl.ipc.folder_files import FolderFiles
from rigctl.ipc.service_manager import Watchdog

REPORTED_S = 1.0
HUNG_S = 5.0
_TURN_MAX_S = 0.5  # a longer turn of the observer says that it was stalled itself, as the computer may have been
_COUNT = struct.Struct("<Q")
_SPINS = 0.5  # of a processor
_DISK = "D"  # proc(5)


def progress_file(name: str) -> str:
    """Name of the file with the count of a process."""
    return f"{name}.progress"


class Progress:
    """The count of this process, and its service's watchdog."""

    def __init__(self, folder: FolderFiles, name: str, *, feeds: bool = True) -> None:
        """Begin to count. ``feeds``: its progress feeds its service's watchdog.

        Raises:
            OSError: the file cannot be made.
        """
        place = folder.place(progress_file(name))
        if not whole_file.over(place, _COUNT.pack(0)):  # the memory of the process before: other may not be free
            place.unlink(missing_ok=True)
            os.close(os.open(place, whole_file.NEW, 0o640 if folder.is_shared else 0o600))
        self._file = os.open(place, os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        self._count = 0
        self._watchdog = Watchdog() if feeds else None

    def step(self) -> None:
        """A turn of the main thread's loop is done."""
        self._count += 1
        with contextlib.suppress(OSError):
            os.pwrite(self._file, _COUNT.pack(self._count), 0)
        if self._watchdog is not None:
            self._watchdog.feed()


def progress_of(folder: FolderFiles, name: str) -> int | None:
    """The count of a process; None where it shows none."""
    with contextlib.suppress(OSError, struct.error):
        file = os.open(folder.place(progress_file(name)), os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            return int(_COUNT.unpack(os.pread(file, _COUNT.size, 0))[0])
        finally:
            os.close(file)
    return None


class Thread(NamedTuple):
    """State of a process's main thread as in proc(5), and for how long it has run and waited for a processor."""

    state: str
    ran_ns: int
    waited_ns: int


def main_thread(pid: int) -> Thread | None:
    """None for a process that this one may not see, as a service of another user."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        task = pathlib.Path(f"/proc/{pid}/task/{pid}")
        ran_ns, waited_ns, _slices = (task / "schedstat").read_text().split()
        return Thread((task / "stat").read_text().rpartition(")")[2].split()[0], int(ran_ns), int(waited_ns))
    return None


class StallChange(Enum):
    """What is found of a process."""

    STALLED = auto()  # no progress for REPORTED_S
    RESUMED = auto()
    HUNG = auto()  # no progress for HUNG_S, for which no computer is the reason: to be replaced


@dataclass
class Stall:
    """How long one process has shown no progress: a fold over the observer's turns."""

    grace_s: float = 0.0
    """After its start: until the first progress it may take this long."""
    lasted_s: float = 0.0
    """When it has resumed: how long it had lasted."""
    _silent_s: float = 0.0
    _hangs_s: float = 0.0
    _count: int | None = None
    _thread: Thread | None = None
    _now_s: float | None = None
    _reported = False

    def look(self, now_s: float, count: int | None, thread: Thread | None) -> StallChange | None:
        """The next turn; ``now_s``: monotonic, ``count``: of the process, ``thread``: its main thread, if seen."""
        turn_s = 0.0 if self._now_s is None else now_s - self._now_s
        passed_s, before, self._now_s = min(turn_s, _TURN_MAX_S), self._count, now_s
        hangs, self._thread = _hangs(self._thread, thread, turn_s), thread
        if count != before and count is not None:
            resumed, self._reported = self._reported, False
            if before is not None:
                self.grace_s = 0.0
            self._count, self._hangs_s, self.lasted_s, self._silent_s = count, 0.0, self._silent_s, 0.0
            return StallChange.RESUMED if resumed else None
        if self.grace_s > 0.0:
            self.grace_s -= passed_s
            return None
        self._silent_s += passed_s
        self._hangs_s = self._hangs_s + passed_s if hangs else 0.0
        if self._hangs_s >= HUNG_S:
            return StallChange.HUNG
        if self._silent_s >= REPORTED_S and not self._reported:
            self._reported = True
            return StallChange.STALLED
        return None


def _hangs(before: Thread | None, now: Thread | None, turn_s: float) -> bool:
    """Whether a thread slept, was stopped, or used more than half of a processor between two turns."""
    if before is None or now is None or now.state == _DISK:
        return False
    ran_ns, waits = now.ran_ns - before.ran_ns, now.state == "R" or now.waited_ns > before.waited_ns
    return ran_ns > _SPINS * turn_s * 1e9 or (ran_ns == 0 and not waits)


_WORDS = {
    "R": ", has or waits for a processor",
    "D": ", waits for a disk",
    "T": ", stopped by a signal",
    "t": ", traced",
}


def stalled_words(thread: Thread | None) -> str:
    """No progress, in words."""
    return f"no progress for {REPORTED_S:g} s{_WORDS.get(thread.state, '') if thread is not None else ''}"
