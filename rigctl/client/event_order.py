"""Events in order: each once; what was missed while the connection was down is asked for again.

The loop's events and the gateway's notes each have a sequence of their own; both begin at 1 again, and ``stream``
changes, when the daemon is started anew.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import msgspec

from rigctl.client.mailbox import Mailbox
from rigctl.client.source import Question
from rigctl.telemetry.keys import Keys

Message = dict[str, Any]
_UNKNOWN = -1
_HEADS = {"loop": "event_seq", "gateway": "note_seq"}


class EventSource:
    """Events from now on, or from the oldest that is still held."""

    def __init__(self, mailbox: Mailbox, keys: Keys, *, past: bool = False) -> None:
        """``past``: begin with those still held."""
        self.mailbox = mailbox
        self._keys = keys
        self._ready: deque[Message] = deque()
        self._held: Message | None = None
        self._stream: int | None = None
        self._last: dict[str, int] = dict.fromkeys(_HEADS, 0)
        self._given: set[str] = set()  # sources of which something has been given
        self._begun, self._past = False, past

    def restart(self) -> None:
        """Forget what has come and was not taken, and begin with what comes next."""
        self.mailbox.clear()
        self._ready.clear()
        self._given.clear()
        self._held, self._begun, self._past = None, False, False

    def poll(self) -> Message | Question | None:
        """See `rigctl.client.source.Source`."""
        while True:
            if self._ready:
                return self._ready.popleft()
            if not self._begun and not self._past:
                return Question(self._keys.state)  # says where the sequences are: the first gap counts too
            if not self._begun or self._held is not None:
                return Question(
                    f"{self._keys.events_past}?after={self._last['loop']};after_note={self._last['gateway']}"
                )
            payload = self.mailbox.take()
            if payload is None:
                return None
            if (found := _message(payload)) is not None:
                self._put(found)

    def _put(self, found: Message) -> None:
        if found.get("stream") != self._stream:  # the daemon was started anew
            self._stream = found.get("stream")
            self._last = dict.fromkeys(_HEADS, 0)
        source = found["source"]
        if source not in self._given and (self._last[source] == _UNKNOWN or found["seq"] <= self._last[source]):
            self._last[source] = found["seq"] - 1  # published since we listen, however early
        if found["seq"] > self._last[source] + 1:
            self._held = found
        else:
            self._give(found)

    def _give(self, found: Message) -> None:
        if found["seq"] > self._last[found["source"]]:
            self._last[found["source"]] = found["seq"]
            self._given.add(found["source"])
            self._ready.append(found)

    def answer(self, payload: bytes | None) -> None:
        """See `rigctl.client.source.Source`."""
        value = _decoded(payload)
        if not self._begun and not self._past:
            self._begin(value if isinstance(value, dict) else {})
            return
        self._begun = True
        held, self._held = self._held, None
        for message in value if isinstance(value, list) else []:
            if _is_event(message) and (held is None or message.get("stream") == self._stream):
                self._stream = message.get("stream")
                self._give(message)
        if held is not None:
            self._give(held)

    def _begin(self, state: Message) -> None:
        """From where the sequences are."""
        self._begun = True
        self._stream = state.get("stream")
        heads = {source: state.get(name) for source, name in _HEADS.items()}
        self._last = {source: head if isinstance(head, int) else _UNKNOWN for source, head in heads.items()}


def _decoded(payload: bytes | None) -> Any:
    try:
        return msgspec.json.decode(payload) if payload is not None else None
    except msgspec.MsgspecError:
        return None


def _message(payload: bytes) -> Message | None:
    found = _decoded(payload)
    return found if _is_event(found) else None


def _is_event(found: Any) -> bool:
    return isinstance(found, dict) and found.get("source") in _HEADS and isinstance(found.get("seq"), int)
