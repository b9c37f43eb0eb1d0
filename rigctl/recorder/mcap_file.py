"""Data of the rings as an MCAP file that Foxglove, Lichtblick and PlotJuggler open.

Records and frames are protobuf (JSON has no NaN, and takes too much space at 1 kHz), the rest is JSON with its schema.
Times are those of the wall clock; every message has CLOCK_MONOTONIC as ``t_ns``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import IO, Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType, Writer

from rigctl import __version__
from rigctl.ipc.record import COMMAND, FRAME, HOLD, RECORD
from rigctl.recorder.audit_log import Item
from rigctl.recorder.protobuf import Encoding, numbers_of

CHUNK_BYTES = 1 << 18
DUMPED = MappingProxyType({
    "records": Encoding(RECORD), "frames": Encoding(FRAME), "commands": Encoding(COMMAND),
    "holds": Encoding(numbers_of(HOLD)),
})  # fmt: skip
_LATEST_NS = 2**63 - 1
SAID_SCHEMA = {
    "title": "rigctl.Said",
    "type": "object",
    "properties": {
        "seq": {"type": "integer", "description": "number in its ring"},
        "t_ns": {"type": "integer", "description": "CLOCK_MONOTONIC"},
        "what": {"type": "string"},
        "who": {"type": "string", "description": "operator, empty for none"},
        "text": {"type": "string"},
        "details": {"type": "object"},
    },
}


class Message(NamedTuple):
    """One message, ready to be written."""

    wall_ns: int
    channel: int
    seq: int
    data: bytes


class McapFile:
    """An MCAP file being written: channels for slots of the rings and for texts."""

    def __init__(self, stream: IO[bytes], wall_offset_ns: int, slots: Mapping[str, Encoding] = DUMPED) -> None:
        """``wall_offset_ns``: wall clock less CLOCK_MONOTONIC, the same for the whole file; ``slots``: by topic."""
        self._offset_ns = wall_offset_ns
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"rigctl {__version__}")
        self._slots = slots
        self._channels = {
            topic: self._channel(topic, "protobuf", encoding.name, "protobuf", encoding.descriptor())
            for topic, encoding in self._slots.items()
        }
        schema = msgspec.json.encode(SAID_SCHEMA)
        self._said = self._writer.register_schema("rigctl.Said", "jsonschema", schema)

    def _channel(self, topic: str, message: str, name: str, encoding: str, schema: bytes) -> int:
        schema_id = self._writer.register_schema(name, encoding, schema)
        return self._writer.register_channel(f"/{topic}", message, schema_id)

    def channel(self, topic: str, message: str, name: str, encoding: str, schema: bytes) -> int:
        """Add a channel; returns its number."""
        self._channels[topic] = self._channel(topic, message, name, encoding, schema)
        return self._channels[topic]

    def slots(self, topic: str, slots: npt.NDArray[np.void]) -> list[Message]:
        """Slots of a topic as messages."""
        channel = self._channels[topic]
        walls = (slots["t_ns"] + self._offset_ns).tolist()
        numbers = slots["seq"].tolist()
        encoded = self._slots[topic].encode(slots)
        return [Message(*found) for found in zip(walls, [channel] * len(slots), numbers, encoded, strict=True)]

    def said(self, items: Iterable[Item]) -> list[Message]:
        """Items of the other rings as messages, each ring on a topic of its own."""
        found = []
        for item in items:
            if item.source not in self._channels:
                channel = self._writer.register_channel(f"/{item.source}", "json", self._said)
                self._channels[item.source] = channel
            data = msgspec.json.encode(
                {"seq": item.seq, "t_ns": item.t_ns, "what": item.what, "who": item.who, "text": item.text,
                 "details": item.details}
            )  # fmt: skip
            found.append(Message(item.t_ns + self._offset_ns, self._channels[item.source], item.seq, data))
        return found

    def write(self, messages: Sequence[Message]) -> None:
        """Write messages in order of time."""
        self.add(sorted(messages, key=lambda message: message.wall_ns))

    def add(self, messages: Iterable[Message]) -> None:
        """Write messages in the order given."""
        add = self._writer.add_message
        for wall_ns, channel, seq, data in messages:
            time_ns = _storable(wall_ns)
            add(channel, time_ns, data, time_ns, seq & 0xFFFFFFFF)

    def attach(self, name: str, data: bytes, wall_ns: int, written_ns: int | None = None) -> None:
        """Add a JSON document; ``written_ns``: wall clock when it was written, if not at ``wall_ns``."""
        created_ns = wall_ns if written_ns is None else written_ns
        self._writer.add_attachment(_storable(created_ns), _storable(wall_ns), name, "application/json", data)

    def describe(self, name: str, values: dict[str, Any]) -> None:
        """Add metadata: a table of texts."""
        self._writer.add_metadata(name, {key: str(value) for key, value in values.items()})

    def flush(self) -> None:
        """Close the chunk, so that everything written so far is in the stream and can be read."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Write the index; the caller closes the stream."""
        self._writer.finish()  # type: ignore[no-untyped-call]


def _storable(wall_ns: int) -> int:
    """A time within the range of the format: a clock that was never set may give one before 1970."""
    return min(max(wall_ns, 0), _LATEST_NS)
