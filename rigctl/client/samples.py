"""The fast stream as numpy structured arrays, decoded by the schema the daemon serves."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from rigctl.client.decoding import Layout, layout_of, usable_schema
from rigctl.client.ordering import BlockSource, Count
from rigctl.client.source import Question
from rigctl.wire.block import Block


class SampleSource:
    """Every record once, in order. A restarted daemon may be another version, so its schema is queried again."""

    def __init__(self, blocks: BlockSource, layout: Layout, schema_key: str) -> None:
        self.mailbox = blocks.mailbox
        self.layout = layout
        self._blocks, self._schema_key = blocks, schema_key
        self._stream: int | None = None
        self._undecoded: Block | None = None  # waits for its schema

    @property
    def count(self) -> Count:
        """Figures so far."""
        return self._blocks.count

    def poll(self) -> npt.NDArray[Any] | Question | None:
        """See `rigctl.client.source.Source`.

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
        """See `rigctl.client.source.Source`."""
        if self._undecoded is None:
            self._blocks.answer(payload)
        elif payload is not None:
            self.layout, found = layout_of(usable_schema(payload)), self._undecoded
            self.layout.decode(found)  # raises here if the layout does not fit
            self._stream, self._undecoded = found.stream, None
            self._blocks.put_back(found)
