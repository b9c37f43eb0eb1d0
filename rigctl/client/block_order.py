"""Blocks of the fast stream put in order: every record once; missed records are queried.

A gap appears when the connection was down (gateway restarted) or this process was too slow. The gateway sends the
records again while the ring holds them (16 s and more); only records it no longer holds count as lost.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from rigctl.client.mailbox import Mailbox
from rigctl.client.shapes import MessageRefusedError
from rigctl.client.stream_source import Question
from rigctl.wire.block import Block, FastBlockError, decode

DEPTH_BLOCKS = 2048  # 40 s at 50 Hz


def block(payload: bytes) -> Block:
    """A block of the fast stream.

    Raises:
        MessageRefusedError: the payload is not a block.
    """
    try:
        return decode(payload)
    except FastBlockError as error:
        raise MessageRefusedError(str(error)) from None


@dataclass
class Count:
    """Figures of a subscription, in records; ``received`` includes ``recovered``.

    ``produced = received + lost``. ``repeated``: came again and were left out. ``malformed``: payloads that are not a
    block. ``streams``: starts of the daemon seen; numbers begin at 1 again with each.
    """

    first_seq: int = 0
    last_seq: int = 0
    produced: int = 0
    received: int = 0
    lost: int = 0
    recovered: int = 0
    repeated: int = 0
    malformed: int = 0
    blocks: int = 0
    streams: int = 0


class BlockSource:
    """Blocks without gaps or repetitions."""

    def __init__(self, mailbox: Mailbox, key: str, *, recover: bool = True, past: bool = False) -> None:
        """``recover``: query missed records; False: a gap counts as lost at once.

        ``past``: begin with the oldest record that the daemon's ring holds.
        """
        self.mailbox = mailbox
        self.count = Count()
        self._key, self._recover, self._past = key, recover, past
        self._stream = 0
        self._ready: deque[Block] = deque()
        self._held: Block | None = None  # came after a gap and waits for the missing records

    def poll(self) -> Block | Question | None:
        """See `rigctl.client.stream_source.StreamSource`."""
        while True:
            if self._ready:
                return self._ready.popleft()
            if self._past or self._held is not None:
                after = self.count.last_seq if self._held is None or self._held.stream == self._stream else 0
                return Question(f"{self._key}?after={after}", block)
            payload = self.mailbox.take()
            if payload is None:
                return None
            self._put(payload)

    def put_back(self, block: Block) -> None:
        """Put a block back at the front; it is already counted."""
        self._ready.appendleft(block)

    def _put(self, payload: bytes) -> None:
        count = self.count
        try:
            found = block(payload)
        except MessageRefusedError as error:
            count.malformed += 1
            self.mailbox.refuse(error)
            return
        count.blocks += 1
        if not count.streams:
            self._begin(found.stream, found.first_seq)
        anew = found.stream != self._stream  # a restarted daemon or a forged block: a query decides
        if anew or (found.first_seq > count.last_seq + 1 and self._recover):
            self._held = found
        else:
            self._pass(found)

    def _begin(self, stream: int, first_seq: int = 1) -> None:
        self._stream = stream
        self.count.streams += 1
        self.count.first_seq, self.count.last_seq = first_seq, first_seq - 1

    def _pass(self, found: Block) -> None:
        """Pass on the new records of a block; records missing before it count as lost."""
        count = self.count
        gone = max(0, found.first_seq - 1 - count.last_seq)
        count.lost += gone
        count.produced += gone
        new = found.part(max(found.first_seq, count.last_seq + 1), found.last_seq)
        count.repeated += found.count - new.count
        self._give(new)

    def _give(self, block: Block) -> None:
        if block.count:
            self.count.received += block.count
            self.count.produced += block.count
            self.count.last_seq = block.last_seq
            self._ready.append(block)

    def answer(self, payload: bytes | None) -> None:
        """See `rigctl.client.stream_source.StreamSource`."""
        held, count = self._held, self.count
        found = block(payload) if payload is not None else None
        if held is None:
            self._take_past(found)
            return
        if found is not None and not self._is_known(held, found):
            self._held = None
            count.malformed += 1
            self.mailbox.refuse("records the daemon knows nothing of")
            return
        if held.stream != self._stream:
            self._begin(held.stream)
        if found is not None and found.stream == self._stream:
            part = found.part(count.last_seq + 1, held.first_seq - 1)
            if part.count:
                gone = part.first_seq - 1 - count.last_seq
                count.lost += gone
                count.produced += gone
                count.recovered += part.count
                self._give(part)
                if count.last_seq < held.first_seq - 1:
                    return
        self._held = None
        self._pass(held)

    def _take_past(self, found: Block | None) -> None:
        """Pass on records that the ring held before this subscription, until the newest of them."""
        self._past = False
        if found is None or not found.count or found.last_seq <= self.count.last_seq:
            return
        if not self.count.streams:
            self._begin(found.stream, found.first_seq)
        if found.stream == self._stream:  # else the daemon was restarted, which its next publication shows
            self._pass(found)
            self._past = found.last_seq < found.head_seq

    def _is_known(self, held: Block, answer: Block) -> bool:
        """Whether the block held is genuine: the answering daemon, or the one before it, can have written it."""
        if answer.stream == held.stream:
            return answer.head_seq >= held.last_seq
        return held.stream == self._stream
