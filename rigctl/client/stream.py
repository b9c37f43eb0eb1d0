"""A stream: items in order, taken one by one or iterated over; a daemon that is away for a moment is queried again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Generic, Self, TypeVar

from rigctl.client.stream_source import Question, StreamSource

AGAIN_S = 0.1
PATIENCE_S = 20.0  # after it a ring of default size has been overwritten

Item = TypeVar("Item")
Query = Callable[[Question], tuple[bool, bytes] | None]
"""Asks the daemon; returns whether it answered (else refused) with the answer's bytes, or None without an answer."""


class Stream(Generic[Item]):
    """Items in order. Iteration waits for the next one and ends when the stream or its connection is closed."""

    def __init__(self, query: Query, source: StreamSource[Item]) -> None:
        self._query, self._source = query, source
        self._away_since: float | None = None
        self._again_at = 0.0
        self.on_arrival = source.mailbox.on_arrival

    @property
    def closed(self) -> bool:
        """Whether nothing arrives any more."""
        return self._source.mailbox.closed

    @property
    def unanswered(self) -> bool:
        """Whether a query has to be repeated, ``AGAIN_S`` later, before the next item."""
        return self._away_since is not None

    def take(self) -> Item | None:
        """The next item that has arrived, or None; does not wait for one, but queries what was missed before it."""
        while isinstance(found := self._source.poll(), Question):
            if not self._settle(found):
                return None
        return found

    def arrived(self) -> Iterator[Item]:
        """Items that have arrived, oldest first."""
        while (found := self.take()) is not None:
            yield found

    def rest(self) -> Iterator[Item]:
        """As `arrived`, for the last time: what cannot be queried now counts as lost."""
        while (found := self._source.poll()) is not None:
            if not isinstance(found, Question):
                yield found
            elif not self._settle(found):
                self._source.answer(None)

    def newest(self) -> Item | None:
        """The last item that has arrived, or None; those before it are skipped."""
        last = None
        for item in self.arrived():
            last = item
        return last

    def read(self, timeout_s: float | None = None) -> Item | None:
        """The next item; None after ``timeout_s``, or once closed. A time-out loses nothing."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        while not self.closed:
            if (found := self.take()) is not None:
                return found
            left_s = None if until is None else until - time.monotonic()
            if left_s is not None and left_s <= 0:
                break
            if self.unanswered:
                time.sleep(AGAIN_S if left_s is None else min(AGAIN_S, left_s))
            else:
                self.wait(left_s)
        return None

    def wait(self, timeout_s: float | None) -> bool:
        """Wait for a payload, ``timeout_s`` at most; returns whether one has come."""
        return self._source.mailbox.wait(timeout_s)

    def _settle(self, question: Question) -> bool:
        """Query the daemon and pass the answer to the source; False: no answer, call again ``AGAIN_S`` later.

        A call before that does nothing. A refusal counts as an answer, and so do ``PATIENCE_S`` without one.
        """
        if time.monotonic() < self._again_at:
            return False
        answer = self._query(question)
        if answer is None:
            now = time.monotonic()
            self._away_since = now if self._away_since is None else self._away_since
            if now - self._away_since < PATIENCE_S and not self.closed:
                self._again_at = now + AGAIN_S
                return False
        self._away_since, self._again_at = None, 0.0
        self._source.answer(answer[1] if answer is not None and answer[0] else None)
        return True

    def close(self) -> None:
        """End the subscription; may be called from another thread, and ends an iteration that waits."""
        self._source.mailbox.close()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Item:
        found = self.read()
        if found is None:
            raise StopIteration
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
