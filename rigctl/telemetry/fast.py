"""Subscriber's side of the fast stream: every record once, in order; what was missed is asked for again.

A gap appears when the connection was down (gateway restarted) or this process was too slow. As long as the ring still
holds the records (10 s and more) the gateway gives them again; only what it does not hold any more counts as lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import zenoh

from rigctl.telemetry.block import Block, BlockError, decode
from rigctl.telemetry.client import Client, NoDaemonError

CHANNEL_BLOCKS = 2048  # 40 s at 50 Hz
_RETRIES = 3


@dataclass
class Count:
    """Figures of a subscription; ``received`` includes ``recovered``."""

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


class FastReader:
    """Blocks of the fast stream without gaps or repetitions, and their count."""

    def __init__(self, client: Client, *, recover: bool = True) -> None:
        """``recover``: ask for missed records again; without, a gap is counted as lost at once."""
        self.count = Count()
        self._client, self._recover = client, recover
        self._stream = 0
        self._subscriber = client.session.declare_subscriber(
            client.keys.fast, zenoh.handlers.RingChannel(CHANNEL_BLOCKS)
        )

    def read(self) -> Iterator[Block]:
        """Blocks that have come since; returns when there are no more."""
        while (sample := self._subscriber.try_recv()) is not None:
            try:
                found = decode(bytes(sample.payload))
            except BlockError:
                self.count.malformed += 1
                continue
            yield from self._in_order(found)

    def _in_order(self, found: Block) -> Iterator[Block]:
        count = self.count
        count.blocks += 1
        if found.stream != self._stream:  # first block, or the daemon was started anew
            self._stream = found.stream
            count.streams += 1
            count.first_seq, count.last_seq = found.first_seq, found.first_seq - 1
        if found.first_seq > count.last_seq + 1 and self._recover:
            yield from self._missed(found.first_seq - 1)
        count.lost += max(0, found.first_seq - 1 - count.last_seq)
        count.produced += max(0, found.first_seq - 1 - count.last_seq)
        new = found.part(max(found.first_seq, count.last_seq + 1), found.last_seq)
        count.repeated += found.count - new.count
        if new.count:
            yield self._taken(new)

    def _taken(self, block: Block) -> Block:
        self.count.received += block.count
        self.count.produced += block.count
        self.count.last_seq = block.last_seq
        return block

    def _missed(self, last_seq: int) -> Iterator[Block]:
        """Ask for the records after the last one, up to ``last_seq``."""
        count, failures = self.count, 0
        while count.last_seq < last_seq and failures < _RETRIES:
            try:
                answered, payload = self._client.ask(f"{self._client.keys.fast}?after={count.last_seq}")
                found = decode(payload) if answered else None
            except (NoDaemonError, BlockError, zenoh.ZError):
                found = None
            if found is None:
                failures += 1
                continue
            part = found.part(count.last_seq + 1, last_seq)
            if found.stream != self._stream or not part.count:
                return
            gone = part.first_seq - 1 - count.last_seq
            count.lost += gone
            count.produced += gone
            count.recovered += part.count
            yield self._taken(part)
