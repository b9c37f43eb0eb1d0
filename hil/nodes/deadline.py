"""Supervision of silence: consumer heartbeat (0x1016), RPDO deadline (0x1400:05) and SYNC (0x1006) of CiA 301."""

from __future__ import annotations


class Deadline:
    """Expires after a time without a message; the first message arms it, also after it has expired."""

    __slots__ = ("_armed", "_limit_ns", "_silence_ns", "overdue")

    def __init__(self) -> None:
        self._limit_ns = 0
        self._silence_ns = 0
        self._armed = False
        self.overdue = False

    def set_limit_ms(self, limit_ms: int) -> None:
        """Longest silence allowed; 0 turns the deadline off. Starts afresh."""
        self.set_limit_ns(limit_ms * 1_000_000)

    def set_limit_ns(self, limit_ns: int) -> None:
        """The same in nanoseconds."""
        self._limit_ns = limit_ns
        self.restart()

    def renew(self) -> None:
        """The awaited message has come."""
        self._silence_ns = 0
        self._armed = self._limit_ns > 0
        self.overdue = False

    def restart(self) -> None:
        """Disarm until the next message."""
        self._armed = False
        self.overdue = False

    def runs_out(self, elapsed_ns: int) -> bool:
        """Add ``elapsed_ns`` to the silence; returns whether the deadline expired just now."""
        if not self._armed:
            return False
        self._silence_ns += elapsed_ns
        if self._silence_ns <= self._limit_ns:
            return False
        self._armed = False
        self.overdue = True
        return True
