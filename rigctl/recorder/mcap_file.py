"""Data of the rings as an MCAP file that Foxglove, Lichtblick and PlotJuggler open.

Records and frames are protobuf (JSON has no NaN, and takes too much space at 1 kHz), the rest is JSON with its schema.
Times are those of the wall clock; every message has CLOCK_MONOTONIC as ``t_ns``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Container, Iterable
from typing import IO, Any, NamedTuple, cast

import msgspec
import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType, Writer

from rigctl import __version__
from rigctl.ipc.record import COMMAND, HOLD, RECORD
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.recorder import frame_block
from rigctl.recorder.audit_log import Item
from rigctl.recorder.protobuf import Encoding, numbers_of

FORMAT = "2"
"""Of recordings and trip dumps; another one where a number in them has another meaning, such as a bit of a cause."""
CHUNK_BYTES = 1 << 18
ATTACHED = (ACTIVE, "control.json", "calibration.json")
"""Documents of the runtime folder that go into every file; not lease.json, which has the id."""
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


def slot_readers(runtime: Runtime) -> dict[str, RingReader]:
    """Readers of the rings that are recorded as slots, by topic."""
    return {
        "records": runtime.records.reader(from_start=True),
        "frames": runtime.frames.reader(from_start=True),
        "commands": runtime.commands.reader(from_start=True),
        "holds": runtime.holds.reader(from_start=True),
    }


SEAL = "seal"
"""Name of the metadata with the seal of a file, see `rigctl.recorder.part_seal`."""


class _Hashed:
    """A stream that keeps the SHA-256 of what is written."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self.digest = stream, hashlib.sha256()

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        return self._stream.write(data)

    def tell(self) -> int:
        return self._stream.tell()

    def flush(self) -> None:
        self._stream.flush()


class McapFile:
    """An MCAP file being written: channels for slots of the rings and for texts."""

    def __init__(self, stream: IO[bytes], wall_offset_ns: int, exact: Container[str] | None = None) -> None:
        """``wall_offset_ns``: wall clock less CLOCK_MONOTONIC, for the whole file; ``exact``: see `Encoding`."""
        self._offset_ns = wall_offset_ns
        self._stream = _Hashed(stream)
        self._writer = Writer(cast("IO[bytes]", self._stream), chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"rigctl {__version__}")
        self._encodings = {
            "records": Encoding(RECORD, exact), "commands": Encoding(COMMAND), "holds": Encoding(numbers_of(HOLD)),
        }  # fmt: skip
        self._channels: dict[str, int] = {}
        for topic, encoding in self._encodings.items():
            self._protobuf(topic, encoding.name, encoding.descriptor())
        schema = msgspec.json.encode(SAID_SCHEMA)
        self._said = self._writer.register_schema("rigctl.Said", "jsonschema", schema)
        self._protobuf("frames", frame_block.NAME, frame_block.descriptor())

    def _protobuf(self, topic: str, name: str, schema: bytes) -> None:
        number = self._writer.register_schema(name, "protobuf", schema)
        self._channels[topic] = self._writer.register_channel(f"/{topic}", "protobuf", number)

    def json_channel(self, topic: str, schema: dict[str, Any]) -> int:
        """Add a channel for JSON; returns its number."""
        number = self._writer.register_schema(schema["title"], "jsonschema", msgspec.json.encode(schema))
        return self._writer.register_channel(f"/{topic}", "json", number)

    def slots(self, topic: str, slots: npt.NDArray[np.void]) -> list[Message]:
        """Slots of a topic as messages: one for each slot, frames in blocks."""
        channel, offset_ns = self._channels[topic], self._offset_ns
        if topic == "frames":
            return [Message(t_ns + offset_ns, channel, seq, data) for seq, t_ns, data in frame_block.encode(slots)]
        walls, numbers = (slots["t_ns"] + offset_ns).tolist(), slots["seq"].tolist()
        encoded = self._encodings[topic].encode(slots)
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

    def finish(self, sealer: Callable[[str], str] | None = None) -> None:
        """Write the seal and the index; the caller closes the stream. ``sealer``: seals a SHA-256, "" if it cannot."""
        self.flush()
        sha256 = self._stream.digest.hexdigest()
        if sealer is not None and (seal := sealer(sha256)):
            self.describe(SEAL, {"sha256": sha256, "seal": seal})
        self._writer.finish()  # type: ignore[no-untyped-call]


def _storable(wall_ns: int) -> int:
    """A time within the range of the format: a clock that was never set may give one before 1970."""
    return min(max(wall_ns, 0), _LATEST_NS)
