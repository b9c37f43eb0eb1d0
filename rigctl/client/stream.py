"""A stream with blocking iteration: ``for item in stream``."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Generic, Self, TypeVar

from rigctl.client.connection import Client
from rigctl.client.enquiry import AGAIN_S, Enquiry
from rigctl.client.source import Question, Source

Item = TypeVar("Item")


class Stream(Generic[Item]):
    """Items in order. Iteration waits for the next one and ends when the stream or its rig is closed."""

    def __init__(self, client: Client, source: Source[Item]) -> None:
        self._enquiry, self._source = Enquiry(client), source

    def read(self, timeout_s: float | None = None) -> Item | None:
        """The next item; None after ``timeout_s``, or once closed. A time-out loses nothing."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        mailbox = self._source.mailbox
        while not mailbox.closed:
            found = self._source.poll()
            left_s = None if until is None else until - time.monotonic()
            if isinstance(found, Question):
                if self._enquiry.settle(self._source, found):
                    continue
                if left_s is not None and left_s <= 0:
                    return None
                time.sleep(AGAIN_S if left_s is None else min(AGAIN_S, left_s))
            elif found is not None:
                return found
            elif left_s is not None and left_s <= 0:
                return None
            else:
                mailbox.wait(left_s)
        return None

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

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()
