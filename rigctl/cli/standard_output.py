"""Standard output and error whose failure ends no run: the reader may be gone, the disk full, the descriptor closed.

A command continues without its reader, because it has a rig to hold, processes to end, files to write and an exit code
to give. Lost output is reported at the end.
"""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO, cast

STDOUT, STDERR = 1, 2


class Outlet(io.FileIO):
    """A file descriptor whose writes never raise; ``failure`` is the error of the last write that failed."""

    failure: OSError | None = None

    def write(self, data: object) -> int:
        """Write; data that cannot be written is lost."""
        try:
            return super().write(data)  # type: ignore[arg-type]
        except OSError as error:
            self.failure = error
            return len(memoryview(data))  # type: ignore[arg-type]


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
        line_buffering=own.line_buffering if own else True,
        write_through=own.write_through if own else False,
    )
