"""Payloads of a subscription that wait to be read. One thread fills the mailbox, Zenoh's or a socket's, and one reader
empties it."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable

import zenoh

from rigctl.client.shapes import LONGEST_MESSAGE, Refusals


class Mailbox:
    """Payloads in order of arrival; when more than ``depth`` wait, the oldest are dropped."""

    def __init__(
        self, session: zenoh.Session | None, key: str, depth: int, refusals: Refusals | None = None,
        longest: int = LONGEST_MESSAGE,
    ) -> None:  # fmt: skip
        """``refusals``: counter of refused payloads; ``longest``: payloads of more bytes are refused unread.

        ``session``: subscribes to ``key`` there; None: it is filled by `put`.
        """
        self.refusals = refusals if refusals is not None else Refusals()
        self._key, self._longest = key, longest
        self.closed = False
        self._waiting: deque[bytes] = deque(maxlen=depth)
        self._come = threading.Event()
        self._wake: Callable[[], None] | None = None
        self._lock = threading.Lock()
        self._end: Callable[[], object] | None = None
        if session is not None:
            subscriber = session.declare_subscriber(self._key, self._take)
            self._end = subscriber.undeclare

    def on_close(self, end: Callable[[], object] | None) -> None:
        """Have `close` call ``end``; if it is closed already, at once."""
        with self._lock:
            self._end = end
            if not self.closed:
                return
        self._call_end()

    def _call_end(self) -> None:
        end, self._end = self._end, None
        if end is not None:
            with contextlib.suppress(zenoh.ZError):  # the session may be closed already
                end()

    def _take(self, sample: zenoh.Sample) -> None:
        if len(sample.payload) > self._longest:
            self.refuse(f"found {len(sample.payload)} bytes, expected at most {self._longest}")
            return
        if "*" in str(sample.key_expr):  # a message on many keys passes rules for one: see rigctl.wire.access_control
            self.refuse("a message on more than one key")
            return
        self.put(bytes(sample.payload))

    def put(self, payload: bytes) -> None:
        """Take a payload."""
        self._waiting.append(payload)
        self._ring()

    def refuse(self, why: object) -> None:
        """Count a payload that does not have the shape of the daemon's."""
        self.refusals.add(self._key, why)

    def _ring(self) -> None:
        self._come.set()
        if (wake := self._wake) is not None:
            wake()

    def on_arrival(self, wake: Callable[[], None]) -> None:
        """Call ``wake`` from Zenoh's thread at every arrival; it must not wait."""
        self._wake = wake

    def take(self) -> bytes | None:
        """The oldest payload, or None."""
        return self._waiting.popleft() if self._waiting else None

    def wait(self, timeout_s: float | None) -> bool:
        """Wait until a payload is there or the mailbox is closed; returns whether one is there."""
        self._come.clear()
        if not self._waiting and not self.closed:
            self._come.wait(timeout_s)
        return bool(self._waiting)

    def clear(self) -> None:
        """Forget the waiting payloads."""
        self._waiting.clear()

    def close(self) -> None:
        """End the subscription and wake a waiting reader."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
        self._call_end()
        self._ring()
