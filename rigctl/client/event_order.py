"""Events in order: each once; events missed while the connection was down are queried.

The loop's events and the gateway's notes each have a sequence of their own. At a restart of the daemon both begin at 1
again and ``stream`` changes.
"""

from __future__ import annotations

from collections import deque

from rigctl.client import shapes
from rigctl.client.mailbox import Mailbox
from rigctl.client.shapes import Message, MessageRefusedError
from rigctl.client.stream import Query, Stream
from rigctl.client.stream_source import Question
from rigctl.wire.keys import Keys

_UNKNOWN = -1
_HEADS = {"loop": "event_seq", "gateway": "note_seq"}


class EventSource:
    """Events from now on, or from the oldest that the rings hold."""

    def __init__(self, mailbox: Mailbox, keys: Keys, *, past: bool = False) -> None:
        """``past``: begin with the oldest events held."""
        self.mailbox = mailbox
        self._keys = keys
        self._ready: deque[Message] = deque()
        self._held: Message | None = None
        self._stream: int | None = None
        self._last: dict[str, int] = dict.fromkeys(_HEADS, 0)
        self._given: set[str] = set()  # sources with at least one event passed on
        self._begun, self._past = False, past
        self._restarted = False

    def restart(self) -> None:
        """Forget the waiting events and begin with the next one that arrives; may be called from any thread."""
        self.mailbox.clear()
        self._restarted = True  # the rest is up to the thread that polls

    def poll(self) -> Message | Question | None:
        """See `rigctl.client.stream_source.StreamSource`."""
        if self._restarted:
            self._ready.clear()
            self._given.clear()
            self._held, self._begun, self._past, self._restarted = None, False, False, False
        while True:
            if self._ready:
                return self._ready.popleft()
            if not self._begun and not self._past:
                # The state carries both sequence numbers, so that a gap before the first event is noticed.
                return Question(self._keys.state, shapes.state)
            if not self._begun or self._held is not None:
                return self._past_question()
            payload = self.mailbox.take()
            if payload is None:
                return None
            try:
                self._put(shapes.event(payload))
            except MessageRefusedError as error:
                self.mailbox.refuse(error)

    def _past_question(self) -> Question:
        anew = self._held is not None and self._held.get("stream") != self._stream
        after = dict.fromkeys(_HEADS, 0) if anew else self._last
        selector = f"{self._keys.events_past}?after={after['loop']};after_note={after['gateway']}"
        return Question(selector, shapes.past_events)

    def _put(self, found: Message) -> None:
        source, stream = found["source"], found.get("stream")
        if self._stream is None:
            self._stream = stream
        if stream != self._stream:  # a restarted daemon or a forged event: a query decides
            self._held = found
            return
        if source not in self._given and (self._last[source] == _UNKNOWN or found["seq"] <= self._last[source]):
            self._last[source] = found["seq"] - 1  # published after the subscription, so it counts whatever its number
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
        """See `rigctl.client.stream_source.StreamSource`."""
        if self._restarted:
            return
        if not self._begun and not self._past:
            self._begin(shapes.state(payload) if payload is not None else {})
            return
        self._begun = True
        held, self._held = self._held, None
        past = shapes.past_events(payload) if payload is not None else None
        if held is not None and past is not None and not any(_is_after(message, held) for message in past):
            self.mailbox.refuse("an event the daemon knows nothing of")
            return
        if held is not None and held.get("stream") != self._stream:
            self._stream, self._last = held.get("stream"), dict.fromkeys(_HEADS, 0)
        for message in past or []:
            if held is None or message.get("stream") == self._stream:
                self._stream = message.get("stream")
                self._give(message)
        if held is not None:
            self._give(held)

    def _begin(self, state: Message) -> None:
        """Begin after the sequence numbers of a state."""
        self._begun = True
        self._stream = state.get("stream")
        heads = {source: state.get(name) for source, name in _HEADS.items()}
        self._last = {source: head if isinstance(head, int) else _UNKNOWN for source, head in heads.items()}


def _is_after(message: Message, held: Message) -> bool:
    """Whether a message is the one held or a later one of its sequence."""
    same = all(message.get(name) == held.get(name) for name in ("source", "stream"))
    return same and bool(message["seq"] >= held["seq"])


class Events(Stream[Message]):
    """Events of a rig; ``restart`` begins with the next one that arrives."""

    def __init__(self, query: Query, source: EventSource) -> None:
        super().__init__(query, source)
        self.restart = source.restart
