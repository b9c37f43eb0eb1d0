"""What a daemon in miniature has put on record of messages and connections that were refused."""

from __future__ import annotations

from typing import Any

from rigctl.ipc.notes import note_message
from tests.builders.miniature import Daemon
from tests.builders.waiting import until


class Refused:
    """The notes of refusals of one daemon."""

    def __init__(self, daemon: Daemon) -> None:
        self._reader = daemon.runtime.notes.reader(from_start=True)
        self.found: list[dict[str, Any]] = []

    def read(self) -> list[str]:
        """Their texts so far."""
        self.found += [note_message(note, 0)[1] for note in self._reader.read()]
        return [one["text"] for one in self.found if one["kind"].endswith("_REFUSED")]

    def line(self, words: str) -> str:
        """The first text with these words, once there is one."""
        return str(until(lambda: next((one for one in self.read() if words in one), None), f"the line: {words}"))
