"""Unwanted ends of recorder and gateway, from the supervisor's notes: alarms, which the gateway puts on record.

The gateway that follows one that has died notes the death of its predecessor, at the time of it.
"""

from __future__ import annotations

from dataclasses import dataclass

from rigctl.ipc.notes import Note
from rigctl.ipc.runtime_folder import Runtime
from rigctl.ipc.supervision import Doing

WATCHED = ("recorder", "gateway")
_KINDS = {int(Doing.PROCESS_ENDED): Note.PROCESS_LOST, int(Doing.PROCESS_STARTED): Note.PROCESS_BACK}


@dataclass(frozen=True)
class ProcessNote:
    """What became of a process: PROCESS_LOST or PROCESS_BACK, at ``t_ns``; ``reason``: how it ended."""

    t_ns: int
    kind: Note
    process: str
    reason: str = ""


class EndedProcesses:
    """What the supervisor has noted of the processes, less what gateways before this one have put on record."""

    def __init__(self, runtime: Runtime) -> None:
        self._supervision = runtime.supervision.reader(from_start=True)
        self._newest = {name: ProcessNote(0, Note.PROCESS_BACK, name) for name in WATCHED}
        for slot in runtime.notes.reader(from_start=True).read():
            kind, process = int(slot["kind"]), bytes(slot["other"]).decode(errors="replace")
            if kind in _KINDS.values() and process in WATCHED:
                reason = bytes(slot["reason"]).decode(errors="replace")
                self._newest[process] = ProcessNote(int(slot["t_ns"]), Note(kind), process, reason)

    def look(self) -> list[ProcessNote]:
        """What is to be put on record now."""
        found = []
        for slot in self._supervision.read():
            process, kind = bytes(slot["other"]).decode(errors="replace"), _KINDS.get(int(slot["kind"]))
            before = self._newest.get(process)
            if (
                kind is None
                or before is None
                or int(slot["t_ns"]) <= before.t_ns
                or kind is before.kind is Note.PROCESS_BACK
            ):
                continue
            reason = bytes(slot["reason"]).decode(errors="replace") if kind is Note.PROCESS_LOST else ""
            self._newest[process] = note = ProcessNote(int(slot["t_ns"]), kind, process, reason)
            if not (
                kind is Note.PROCESS_LOST and before.reason and before.kind is Note.PROCESS_BACK
            ):  # one that it has announced
                found.append(note)
        return found
