"""A stream's logic without I/O: received payloads go in, items in order come out, or a question for the daemon.

The plain and the asynchronous client differ only in how they wait and query; see `rigctl.client.stream` and
`rigctl.client.stream_async`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from rigctl.client.mailbox import Mailbox

Item_co = TypeVar("Item_co", covariant=True)


@dataclass(frozen=True)
class Question:
    """A query the daemon has to answer before the stream can continue.

    ``check``: raises MessageRefusedError for an answer without the shape of the daemon's.
    """

    selector: str
    check: Callable[[bytes], object]


class Source(Protocol[Item_co]):
    """A stream's logic; it reads from ``mailbox``."""

    mailbox: Mailbox

    def poll(self) -> Item_co | Question | None:
        """The next item; a question, until it is answered; or None while nothing waits."""

    def answer(self, payload: bytes | None) -> None:
        """Take the answer to the question; None for a refusal, or when no answer is expected any more."""
