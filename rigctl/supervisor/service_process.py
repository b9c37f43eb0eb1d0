"""A process of the run that the service manager starts, as another user: the supervisor sees it, and has it end."""

from __future__ import annotations

import contextlib
import os
import time

import msgspec

from rigctl.ipc.joining import has_ended, presence, presence_file
from rigctl.ipc.runtime_folder import Runtime
from rigctl.ipc.supervision import Doing

_LOOK_S = 0.1
_END_POLL_S = 0.01


class ServiceProcess:
    """One such process. ``pid``: 0 while there is none."""

    def __init__(self, runtime: Runtime, name: str, run_id: str) -> None:
        self.name = name
        self.pid = 0
        self._runtime, self._run_id = runtime, run_id
        self._process = -1  # descriptor of the process
        self._seen: tuple[int, ...] = ()
        self._look_at = 0.0

    def look(self, now: float) -> Doing | None:
        """What has happened to it since the last call, at most one thing; ``now``: monotonic, s."""
        if self.pid and has_ended(self._process):
            os.close(self._process)
            self.pid, self._process = 0, -1
            return Doing.PROCESS_ENDED
        if self.pid or now < self._look_at:
            return None
        self._look_at = now + _LOOK_S
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            if (mark := self._runtime.mark(presence_file(self.name))) == self._seen:
                return None
            pid = presence(self._runtime, self.name, self._run_id)
            self._seen = mark
            if pid:
                self._process = os.pidfd_open(pid)
                self.pid = pid
                return Doing.PROCESS_STARTED
        return None

    def end(self, limit_s: float) -> bool:
        """Have it end; returns whether it has, within ``limit_s``."""
        with contextlib.suppress(OSError):  # the folder is lost: it ends with the supervisor
            self._runtime.end(self.name)
        until = time.monotonic() + limit_s
        while self.pid and not has_ended(self._process):
            if time.monotonic() > until:
                return False
            time.sleep(_END_POLL_S)
        return True
