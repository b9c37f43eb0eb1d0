"""Processes of the daemon without progress, for the warnings of the state."""

from __future__ import annotations

import time

from rigctl.ipc.progress import Stall, StallChange, progress_of, stalled_words
from rigctl.ipc.runtime_folder import Runtime
from rigctl.ipc.supervision import SUPERVISOR, Doing


class StalledProcesses:
    """What the supervisor has noted of the others, and what its own count shows of the supervisor."""

    def __init__(self, runtime: Runtime) -> None:
        self._runtime, self._notes = runtime, runtime.supervision.reader(from_start=True)
        self._stall, self._now = Stall(), dict[str, str]()

    def look(self) -> list[str]:
        """One line for each process without progress now."""
        for slot in self._notes.read():
            process = bytes(slot["other"]).decode(errors="replace")
            if int(slot["kind"]) == Doing.PROCESS_STALLED:
                self._now[process] = bytes(slot["reason"]).decode(errors="replace")
            elif int(slot["kind"]) in (Doing.PROCESS_RESUMED, Doing.PROCESS_STARTED, Doing.PROCESS_ENDED):
                self._now.pop(process, None)
        if (count := progress_of(self._runtime, SUPERVISOR)) is not None:
            match self._stall.look(time.monotonic(), count, None):
                case StallChange.STALLED:
                    self._now[SUPERVISOR] = stalled_words(None)
                case StallChange.RESUMED:
                    self._now.pop(SUPERVISOR, None)
        return [f"{process} process: {words}" for process, words in self._now.items()]
