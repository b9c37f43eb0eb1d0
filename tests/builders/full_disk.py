"""A disk with too little room: files may not get longer than a limit, so a write is cut short, then fails.

Python writes the bytecode of a module it imports under the same limit, and keeps what was cut short: every later
import of that module fails. So no bytecode is written under the limit.
"""

from __future__ import annotations

import contextlib
import resource
import sys
from collections.abc import Iterator, Sequence


@contextlib.contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """In this process, no file gets longer than ``size`` bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    written, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = written


def rigctl_with_files_of_at_most(size: int, words: Sequence[str]) -> list[str]:
    """The command line of ``rigctl`` in a process of its own, under the same limit."""
    program = (
        "import resource, signal, sys; sys.dont_write_bytecode = True; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size})); from rigctl.cli.app import main; main()"
    )
    return [sys.executable, "-c", program, *words]
