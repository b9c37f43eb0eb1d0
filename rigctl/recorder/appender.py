"""A file that only grows, written by one thread and synced by another, so that a stalled disk stalls only those.

Data is written at once, so that it survives the end of this process, and synced twice a second against a power loss.
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
    """Writes and syncs bytes in order; a failed write is tried again.

    ``error`` says why nothing can be written now, "" if all is well; ``failures`` counts failed attempts; ``pending``
    bytes wait; ``synced`` bytes are on the disk for certain. After a failed sync, or when a failed write cannot be
    truncated away, the file is ``torn``: nothing more is written to it.
    """

    def __init__(self, path: pathlib.Path) -> None:
        """Create ``path``.

        Raises:
            OSError: it exists already or cannot be created.
        """
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o640)
        self._inode = os.fstat(self._fd).st_ino
        self._waiting: deque[bytes] = deque()
        self._awake = threading.Condition()
        self._ending = self._all_written = False
        self.error, self.failures, self.pending, self.torn = "", 0, 0, False
        self.written = self.synced = 0
        self._since: dict[str, float] = {}  # running operation: its start
        self._threads = [threading.Thread(target=run, name=path.name, daemon=True) for run in (self._write, self._sync)]
        for thread in self._threads:
            thread.start()

    def append(self, data: bytes) -> None:
        """Queue ``data`` to be written; returns at once."""
        if data:
            with self._awake:
                self._waiting.append(data)
                self.pending += len(data)
                self._awake.notify_all()

    @property
    def stalled_s(self) -> float:
        """How long the oldest running operation on the disk has taken."""
        return time.monotonic() - min(self._since.copy().values(), default=time.monotonic())

    def in_place(self) -> bool:
        """Whether the file still exists under its name."""
        try:
            return self.path.stat().st_ino == self._inode
        except OSError:
            return False

    def end(self) -> None:
        """End the threads once all is on the disk, or at the first failure; nothing may be queued after it."""
        with self._awake:
            self._ending = True
            self._awake.notify_all()

    def join(self, limit_s: float) -> bool:
        """Wait until all is on the disk, ``limit_s`` at most; returns whether it is."""
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
        """Truncate the file to its state before a failed write and queue ``data`` first again."""
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
                    self.torn = True  # after a failed fsync the kernel may have dropped the data and never retries it
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
