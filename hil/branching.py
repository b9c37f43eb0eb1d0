"""A run goes on several ways from one moment: each in a forked process, so that what came before is played once."""

from __future__ import annotations

import gc
import os
import pathlib
import pickle
from collections.abc import Callable
from typing import TypeVar

Found = TypeVar("Found")


class BranchError(RuntimeError):
    """The process of a branch ended without a result."""


class BranchPoint:
    """A run as it is now. The rings in its folder, which every process shares, are put back after each branch."""

    def __init__(self, folder: pathlib.Path) -> None:
        """``folder``: of the run's rings."""
        self._rings = {file: file.read_bytes() for file in folder.iterdir() if file.is_file()}

    def branch(self, go_on: Callable[[], Found]) -> Found:
        """What ``go_on`` returns, or raises, in a process of its own; either has to be picklable.

        Raises:
            BranchError: the process ended before it.
        """
        reading, writing = os.pipe()
        pid = os.fork()
        if not pid:
            status = 1
            gc.disable()  # it would walk through, and so copy, all that this process shares with the first
            try:
                os.close(reading)
                with os.fdopen(writing, "wb") as pipe:
                    pipe.write(_outcome(go_on))
                status = 0
            finally:
                os._exit(status)
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            found = pipe.read()
        _, status = os.waitpid(pid, 0)
        for file, content in self._rings.items():
            with file.open("r+b") as ring:
                ring.write(content)
        if status or not found:
            raise BranchError(f"the process of a branch ended with status {os.waitstatus_to_exitcode(status)}")
        result, error = pickle.loads(found)
        if error is not None:
            raise error
        return result  # type: ignore[no-any-return]


def _outcome(go_on: Callable[[], object]) -> bytes:
    try:
        return pickle.dumps((go_on(), None))
    except Exception as error:  # noqa: BLE001 - the caller gets it
        return pickle.dumps((None, error))
