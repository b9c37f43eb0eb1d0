"""Blocks of the fast stream without decoding them, for programs that count or pass them on."""

from __future__ import annotations

from collections.abc import Iterator

from rigctl.client.connection import Client
from rigctl.client.enquiry import Enquiry
from rigctl.client.mailbox import Mailbox
from rigctl.client.ordering import BlockSource, Count
from rigctl.client.shapes import LONGEST_BLOCK
from rigctl.client.source import Question
from rigctl.wire.block import Block

DEPTH_BLOCKS = 2048  # 40 s at 50 Hz


class FastReader:
    """Blocks of the fast stream without gaps or repetitions, and their count."""

    def __init__(self, client: Client, *, recover: bool = True, depth: int = DEPTH_BLOCKS) -> None:
        """``recover``: query missed records; False: a gap counts as lost at once.

        ``depth``: blocks that may wait to be read; beyond it the oldest are dropped (and queried again).
        """
        self._enquiry = Enquiry(client)
        self._mailbox = Mailbox(client.session, client.keys.fast, depth, client.refusals, LONGEST_BLOCK)
        self._source = BlockSource(self._mailbox, client.keys.fast, recover=recover)

    @property
    def count(self) -> Count:
        """Figures so far."""
        return self._source.count

    def wait(self, timeout_s: float) -> bool:
        """Wait for a block, ``timeout_s`` at most; returns whether one has come."""
        return self._mailbox.wait(timeout_s)

    def read(self) -> Iterator[Block]:
        """Blocks that have come since the last call; ends when there are no more or the daemon does not answer."""
        while (found := self._source.poll()) is not None:
            if not isinstance(found, Question):
                yield found
            elif not self._enquiry.settle(self._source, found):
                return

    def finish(self) -> Iterator[Block]:
        """As `read`, for the last time: missing records that cannot be queried now count as lost."""
        while (found := self._source.poll()) is not None:
            if not isinstance(found, Question):
                yield found
            elif not self._enquiry.settle(self._source, found):
                self._source.answer(None)
