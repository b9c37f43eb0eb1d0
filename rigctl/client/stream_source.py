"""A stream's logic without input and output: received payloads go in, items in order come out, or a query is needed.

`rigctl.client.stream` waits and queries.
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


class StreamSource(Protocol[Item_co]):
    """A stream's logic; it reads from ``mailbox``."""

    mailbox: Mailbox

    def poll(self) -> Item_co | Question | None:
        """The next item; a question, until it is answered; or None while nothing waits."""

    def answer(self, payload: bytes | None) -> None:
        """Take the answer to the question; None for a refusal, or when no answer is expected any more."""
