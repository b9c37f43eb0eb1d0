"""A stream without input or output of its own: what came goes in, what is in order comes out, or a question.

The plain and the asynchronous client differ only in how they wait and how they ask; see `rigctl.client.stream` and
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
    """Something to be asked of the daemon before the stream can go on.

    ``check``: raises MessageRefusedError for an answer that is none of our daemon's.
    """

    selector: str
    check: Callable[[bytes], object]


class Source(Protocol[Item_co]):
    """A stream's logic; ``mailbox`` is what it takes from."""

    mailbox: Mailbox

    def poll(self) -> Item_co | Question | None:
        """The next item; or a question, until it is answered; or None while there is nothing."""

    def answer(self, payload: bytes | None) -> None:
        """What was answered to the question; None for a refusal, or for no answer that would still come."""
