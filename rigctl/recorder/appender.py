"""A file that only grows, written by one thread and synced by another: a disk that stalls stalls nobody else.

Written at once, so that the end of this process loses nothing; synced twice a second, for the end of the machine.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import threading
import time
from collections import deque

RETRY_S = 1.0
SYNC_S = 0.5


class Appender:
    """Takes bytes, and writes and syncs them in order; what cannot be written waits and is tried again.

    ``error`` says why nothing can be written at the moment, "" if all is well; ``failures`` counts the attempts that
    failed; ``pending`` bytes wait, ``synced`` are known to be on the disk. A file of which that cannot be known, or
    that cannot be put back to where a failed write began, is ``torn``: nothing more is written to it.
    """

    def __init__(self, path: pathlib.Path) -> None:
        """Create ``path``.

        Raises:
            OSError: it is there already, or cannot be made.
        """
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o640)
        self._inode = os.fstat(self._fd).st_ino
        self._waiting: deque[bytes] = deque()
        self._awake = threading.Condition()
        self._ending = self._all_written = False
        self.error, self.failures, self.pending, self.torn = "", 0, 0, False
        self.written = self.synced = 0
        self._since: dict[str, float] = {}  # what is being done, since when
        self._threads = [threading.Thread(target=run, name=path.name, daemon=True) for run in (self._write, self._sync)]
        for thread in self._threads:
            thread.start()

    def append(self, data: bytes) -> None:
        """Write ``data`` after what was given before; returns at once."""
        if data:
            with self._awake:
                self._waiting.append(data)
                self.pending += len(data)
                self._awake.notify_all()

    @property
    def stalled_s(self) -> float:
        """For how long the disk has not answered."""
        return time.monotonic() - min(self._since.copy().values(), default=time.monotonic())

    def in_place(self) -> bool:
        """Whether the file is still there under its name."""
        try:
            return self.path.stat().st_ino == self._inode
        except OSError:
            return False

    def end(self) -> None:
        """No more is given: the threads end once all is on the disk, or at the first failure."""
        with self._awake:
            self._ending = True
            self._awake.notify_all()

    def join(self, limit_s: float) -> bool:
        """Wait until all is on the disk; whether it is."""
        until = time.monotonic() + limit_s
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))
        over = not any(thread.is_alive() for thread in self._threads)
        return over and not self.pending and not self.torn and self.synced == self.written

    # -- threads -------------------------------------------------------------------------------------------------
    def _write(self) -> None:
        while True:
            with self._awake:
                self._awake.wait_for(lambda: self._waiting or self._ending or self.torn)
                if not self._waiting or self.torn:
                    break
                data = b"".join(self._waiting)
                self._waiting.clear()
            self._since["write"] = time.monotonic()
            try:
                view = memoryview(data)
                while view:
                    view = view[os.write(self._fd, view) :]
            except OSError as error:
                self._failed(error)
                self._put_back(data)
                if self._ending:
                    break
            else:
                self.pending -= len(data)
                self.written += len(data)
                self.error = ""
            self._since.pop("write", None)
            with self._awake:
                self._awake.notify_all()
                if self.error:
                    self._awake.wait_for(lambda: self._ending, RETRY_S)
        self._since.pop("write", None)
        with self._awake:
            self._all_written = True
            self._awake.notify_all()

    def _put_back(self, data: bytes) -> None:
        """The file as it was before, and ``data`` as the next to be written."""
        with self._awake:
            self._waiting.appendleft(data)
        try:
            os.ftruncate(self._fd, self.written)
            os.lseek(self._fd, self.written, os.SEEK_SET)
        except OSError:
            self.torn = True

    def _sync(self) -> None:
        while not self.torn:
            with self._awake:
                self._awake.wait_for(lambda: self.written > self.synced or self._all_written)
                if self.written == self.synced:
                    break
            upto = self.written
            self._since["sync"] = time.monotonic()
            try:
                os.fsync(self._fd)
            except OSError as error:
                self._failed(error)
                with self._awake:
                    self.torn = True  # what the system had not written yet may be gone, and is not tried again
                    self._awake.notify_all()
            else:
                self.synced = upto
            self._since.pop("sync", None)
            with self._awake:
                self._awake.wait_for(lambda: self._all_written, SYNC_S)
        with self._awake:
            self._awake.wait_for(lambda: self._all_written)
        with contextlib.suppress(OSError):
            os.close(self._fd)

    def _failed(self, error: OSError) -> None:
        self.error = error.strerror or str(error)
        self.failures += 1
