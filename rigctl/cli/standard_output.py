"""Standard output and error that end no run: the reader may have gone, the disk may be full, there may be none.

A command goes on without whoever listened to it, because it has more to do than to talk: a rig to hold, processes to
end, files to write, an exit code to give. What could not be said is told at the end.
"""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO, cast

STDOUT, STDERR = 1, 2


class Outlet(io.FileIO):
    """A file descriptor that takes everything; ``failure`` is what became of the last write that failed."""

    failure: OSError | None = None

    def write(self, data: object) -> int:
        """Write; what cannot be written is gone."""
        try:
            return super().write(data)  # type: ignore[arg-type]
        except OSError as error:
            self.failure = error
            return len(memoryview(data))  # type: ignore[arg-type]


def guard() -> None:
    """Let this process write to ``Outlet``s from now on; a descriptor that is closed is opened on nothing.

    A standard output that is not the process's own, as under a test, stays as it is.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= STDERR:  # or a socket would become standard output
        pass
    os.close(descriptor)
    if sys.stdout is sys.__stdout__:
        sys.stdout = _guarded(STDOUT, sys.stdout)
    if sys.stderr is sys.__stderr__:
        sys.stderr = _guarded(STDERR, sys.stderr)


def nobody_reads() -> bool:
    """Whether standard output went to a reader that is gone."""
    return isinstance(_failure(), BrokenPipeError)


def complaint() -> str | None:
    """What is to be said about standard output once everything is written: a full disk, but no reader who left."""
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
        errors="backslashreplace",  # a name of a file may be no text, a terminal may know no Unicode
        line_buffering=own.line_buffering if own else True,
        write_through=own.write_through if own else False,
    )
