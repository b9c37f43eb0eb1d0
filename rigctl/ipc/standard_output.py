"""Standard output and error whose failure ends no run: the reader may be gone, the disk full, the descriptor closed.

A command continues without its reader, because it has a rig to hold, processes to end, files to write and an exit code
to give. Lost output is reported at the end.

A process of the daemon, and a served rig, do not wait for a reader either (`never_wait`): what a full pipe or a
terminal that is stopped (Ctrl-S) does not take is lost, and counted in the line that the reader gets next.
"""

from __future__ import annotations

import contextlib
import io
import os
import select
import stat
import sys
from typing import TextIO, cast

STDOUT, STDERR = 1, 2


class Outlet(io.FileIO):
    """A file descriptor whose writes never raise; ``failure`` is the error of the last write that failed."""

    failure: OSError | None = None
    waits = True
    _lost = 0  # bytes since the reader last got any

    def write(self, data: object) -> int:
        """Write; data that cannot be written is lost."""
        size = len(memoryview(data))  # type: ignore[arg-type]
        try:
            if self.waits:
                return super().write(data)  # type: ignore[arg-type]
            if self._lost and self._at_once(f"(rigctl: {self._lost} bytes of output were lost: not read)\n".encode()):
                self._lost = 0
            if not self._lost and (written := self._at_once(data)):
                return written
        except OSError as error:
            self.failure = error
            return size
        self._lost += size
        return size

    def _at_once(self, data: object) -> int:
        """Bytes that are taken without waiting; polled, because not every descriptor could be opened anew."""
        poll = select.poll()
        poll.register(self, select.POLLOUT)
        return (super().write(data) or 0) if poll.poll(0) else 0  # type: ignore[arg-type]


def guard() -> None:
    """Redirect this process's output to ``Outlet``s; a closed standard descriptor is opened on /dev/null.

    A standard output that is not the process's own, as under a test, is left alone.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= STDERR:  # else a socket could become standard output
        pass
    os.close(descriptor)
    if sys.stdout is sys.__stdout__:
        sys.stdout = _guarded(STDOUT, sys.stdout)
    if sys.stderr is sys.__stderr__:
        sys.stderr = _guarded(STDERR, sys.stderr)


def never_wait() -> None:
    """As `guard`, and never wait for a reader from now on.

    Pipe or terminal is opened anew, because O_NONBLOCK is a flag of the open file, which the shell and other programs
    share. What cannot be opened anew, a socket or another user's terminal, is written to while it has room.
    """
    guard()
    for stream in (sys.stdout, sys.stderr):
        outlet = getattr(getattr(stream, "buffer", None), "raw", None)
        if not isinstance(outlet, Outlet) or not outlet.waits:
            continue
        outlet.waits = False
        descriptor = outlet.fileno()
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISFIFO(mode) or (stat.S_ISCHR(mode) and os.isatty(descriptor)):
            with contextlib.suppress(OSError):
                own = os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
                os.dup2(own, descriptor)
                os.close(own)


def nobody_reads() -> bool:
    """Whether the reader of standard output is gone."""
    return isinstance(_failure(), BrokenPipeError)


def complaint() -> str | None:
    """The error of standard output once everything is written, such as a full disk; None if only the reader left."""
    failure = _failure()
    if failure is None or isinstance(failure, BrokenPipeError):
        return None
    return f"standard output cannot be written: {failure.strerror}"


def _failure() -> OSError | None:
    sys.stdout.flush()
    outlet = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    return outlet.failure if isinstance(outlet, Outlet) else None


def _guarded(descriptor: int, stream: TextIO | None) -> TextIO:
    outlet = io.BufferedWriter(cast(io.RawIOBase, Outlet(descriptor, "wb", closefd=False)))
    own = cast(io.TextIOWrapper | None, stream)
    return io.TextIOWrapper(
        outlet,
        encoding=own.encoding if own else "utf-8",
        errors="backslashreplace",  # a file's name may not be valid text, and the terminal may not have Unicode
        line_buffering=own.line_buffering or own.write_through if own else True,  # standard error is not buffered
    )
