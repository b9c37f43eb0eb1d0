"""The fast stream: as numpy structured arrays, decoded by the schema the daemon serves, or as undecoded blocks."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from rigctl.client.block_order import BlockSource, Count
from rigctl.client.decoding import SampleLayout, layout_of, usable_schema
from rigctl.client.stream import Query, Stream
from rigctl.client.stream_source import Question
from rigctl.wire.block import Block


class Blocks(Stream[Block]):
    """The fast stream in undecoded blocks, for programs that count or pass them on: each record once and in order."""

    def __init__(self, query: Query, source: BlockSource) -> None:
        super().__init__(query, source)
        self.count: Count = source.count
        """Records received, lost, recovered so far."""


class Samples(Stream[npt.NDArray[Any]]):
    """The fast stream: numpy structured arrays of shape ``(count,)``, each record once and in order.

    Its names, units and meanings are in ``rig.fields``; ``seq`` counts the records without a gap, ``t_ns`` is
    CLOCK_MONOTONIC of the rig's computer. After an interruption the missed records are queried again; those that the
    ring no longer holds are in ``count.lost``.
    """

    def __init__(self, query: Query, blocks: BlockSource, layout: SampleLayout, schema_key: str) -> None:
        super().__init__(query, SampleSource(blocks, layout, schema_key))
        self.count: Count = blocks.count
        """Records received, lost, recovered so far."""


class SampleSource:
    """Every record once, in order. A restarted daemon may be another version, so its schema is queried again."""

    def __init__(self, blocks: BlockSource, layout: SampleLayout, schema_key: str) -> None:
        self.mailbox = blocks.mailbox
        self.layout = layout
        self._blocks, self._schema_key = blocks, schema_key
        self._stream: int | None = None
        self._undecoded: Block | None = None  # waits for its schema

    def poll(self) -> npt.NDArray[Any] | Question | None:
        """See `rigctl.client.stream_source.StreamSource`.

        Raises:
            SchemaError: the daemon was replaced by one whose schema this client does not know.
        """
        if self._undecoded is not None:
            return Question(self._schema_key, usable_schema)
        found = self._blocks.poll()
        if not isinstance(found, Block):
            return found
        if self._stream not in (None, found.stream) or found.record_size != self.layout.dtype.itemsize:
            self._undecoded = found
            return Question(self._schema_key, usable_schema)
        self._stream = found.stream
        return self.layout.decode(found)

    def answer(self, payload: bytes | None) -> None:
        """See `rigctl.client.stream_source.StreamSource`."""
        if self._undecoded is None:
            self._blocks.answer(payload)
        elif payload is not None:
            self.layout, found = layout_of(usable_schema(payload)), self._undecoded
            self.layout.decode(found)  # raises here if the layout does not fit
            self._stream, self._undecoded = found.stream, None
            self._blocks.put_back(found)
