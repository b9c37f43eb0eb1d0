"""The fast stream and the events: what is due to be published, continuing where the previous gateway stopped."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import zenoh

from rigctl.gateway.published_position import Cursor
from rigctl.ipc.notes import note_message
from rigctl.ipc.record import RECORD
from rigctl.ipc.ring import RingReader
from rigctl.wire import block
from rigctl.wire.event_message import event_message
from rigctl.wire.keys import SEVERITIES, Keys

BLOCK_RECORDS = 60_000 // RECORD.dtype.itemsize  # a block fits one Zenoh batch (64 KB)
HISTORY_RECORDS = 1000  # in one answer
BACKLOG_SPEED = 16  # a backlog goes out at this multiple of the loop's rate; at 8, gateways killed in turn lag behind
PATIENCE_NS = 5_000_000_000  # longest wait for subscribers to come back after a restart
UNRECORDED_NS = 100_000_000  # an event waits at most this long for the record of its tick


def blocks_of(records: npt.NDArray[Any], reader: RingReader, lost: int, stream: int) -> list[bytes]:
    """Records as blocks of at most ``BLOCK_RECORDS``; a gap starts a new block."""
    if not len(records):
        return []
    gaps = np.flatnonzero(np.diff(records["seq"].astype(np.int64)) != 1) + 1
    result = []
    for run in np.split(records, gaps):
        for start in range(0, len(run), BLOCK_RECORDS):
            part = run[start : start + BLOCK_RECORDS]
            first = int(part["seq"][0])
            result.append(
                block.encode(
                    part.tobytes(), part.dtype.itemsize, first_seq=first, lost=lost, stream=stream, head_seq=reader.head
                )
            )
    return result


def past_block(reader: RingReader, after: int, stream: int) -> bytes:
    """One block with the records after ``after`` that the ring still holds, at most ``HISTORY_RECORDS``."""
    head = reader.head
    reader.cursor = min(max(after, 0), head)
    records = reader.read(HISTORY_RECORDS)
    if len(records):
        gap = np.flatnonzero(np.diff(records["seq"].astype(np.int64)) != 1)
        records = records[: gap[0] + 1] if len(gap) else records
    first = int(records["seq"][0]) if len(records) else head + 1
    return block.encode(
        records.tobytes(), records.dtype.itemsize, first_seq=first, lost=0, stream=stream, head_seq=head
    )


def declare_publisher(session: zenoh.Session, key: str, **options: Any) -> zenoh.Publisher:
    """A publisher for clients."""
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        **options,
    )


def has_subscriber(publisher: zenoh.Publisher) -> bool:
    """Whether a subscriber exists. (zenoh 1.10's stub says bool; it is an object, and always true.)"""
    return bool(getattr(publisher.matching_status, "matching", publisher.matching_status))


class Resumption:
    """Holds a stream back after a restart until a subscriber is back, for at most ``PATIENCE_NS``."""

    def __init__(self, listened: bool, now_ns: int) -> None:
        """``listened``: whether there was a subscriber when the previous gateway ended."""
        self._waiting = listened
        self._until_ns = now_ns + PATIENCE_NS

    def waits(self, publishers: list[zenoh.Publisher], now_ns: int) -> bool:
        """Whether to hold the stream back now."""
        if self._waiting and (now_ns > self._until_ns or any(map(has_subscriber, publishers))):
            self._waiting = False
        return self._waiting


class FastStream:
    """Every record, in blocks."""

    def __init__(self, publisher: zenoh.Publisher, reader: RingReader, cursor: Cursor, now_ns: int) -> None:
        """``reader`` starts at the oldest record held; a cursor of the previous gateway moves it on."""
        self._publisher, self._reader, self._cursor = publisher, reader, cursor
        self._lost_before = cursor.fast_lost
        self._resumption = Resumption(cursor.fast_listened, now_ns)
        if cursor.resumed:
            reader.cursor = cursor.fast_seq

    @property
    def lost(self) -> int:
        """Records overwritten before a gateway could publish them."""
        return self._lost_before + self._reader.lost

    def publish(self, per_call: int, now_ns: int) -> None:
        """Publish what is new; ``per_call``: records written between two calls."""
        cursor, publisher = self._cursor, self._publisher
        if self._resumption.waits([publisher], now_ns):
            return
        cursor.fast_listened = has_subscriber(publisher)
        records = self._reader.read(BACKLOG_SPEED * per_call)
        for payload in blocks_of(records, self._reader, self.lost, cursor.stream):
            publisher.put(payload)
        cursor.fast_seq, cursor.fast_lost = self._reader.cursor, self.lost
        cursor.save()


def past_messages(
    events: RingReader, notes: RingReader, after: int, after_note: int, wall_offset_ns: int, stream: int
) -> list[dict[str, Any]]:
    """The loop's events after ``after`` and the gateway's notes after ``after_note`` that are held, oldest first."""
    events.cursor, notes.cursor = min(after, events.head), min(after_note, notes.head)
    found = [event_message(event, wall_offset_ns)[1] for event in events.read()]
    found += [note_message(note, wall_offset_ns)[1] for note in notes.read()]
    found = [message | {"stream": stream} for message in found]
    return sorted(found, key=lambda message: int(message["t_ns"]))


class EventStream:
    """Every event of the loop and every note of the gateway, on the key of its severity."""

    def __init__(
        self,
        publishers: dict[str, zenoh.Publisher],
        reader: RingReader,
        notes: RingReader,
        cursor: Cursor,
        now_ns: int,
    ) -> None:
        self._publishers, self._reader, self._notes, self._cursor = publishers, reader, notes, cursor
        self._resumption = Resumption(cursor.events_listened, now_ns)
        self._worded: list[tuple[str, dict[str, Any]]] | None = None
        if cursor.resumed:
            reader.cursor, notes.cursor = cursor.event_seq, cursor.note_seq

    def read(self, wall_offset_ns: int, now_ns: int, recorded_ns: int) -> None:
        """Take what is new from the rings, for `publish`.

        ``recorded_ns``: time of the newest record. An event whose tick has no record yet waits for the next call, so
        that no client sees a state older than an event it already has. The wait is limited by ``UNRECORDED_NS``,
        because a loop that died writes no more records.
        """
        if self._resumption.waits(list(self._publishers.values()), now_ns):
            return
        events = self._reader.read()
        late = (events["t_ns"] > recorded_ns) & (events["t_ns"] > now_ns - UNRECORDED_NS)
        if late.any():
            first = int(late.argmax())
            self._reader.cursor = int(events["seq"][first]) - 1
            events = events[:first]
        self._worded = [event_message(event, wall_offset_ns) for event in events]
        self._worded += [note_message(note, wall_offset_ns) for note in self._notes.read()]
        self._cursor.event_seq, self._cursor.note_seq = self._reader.cursor, self._notes.cursor

    def publish(self) -> None:
        """Publish what `read` took."""
        if self._worded is None:
            return
        self._cursor.events_listened = any(map(has_subscriber, self._publishers.values()))
        for severity, message in self._worded:
            payload = msgspec.json.encode(message | {"stream": self._cursor.stream})
            self._publishers[severity].put(payload)
        self._worded = None
        self._cursor.save()


def event_publishers(session: zenoh.Session, keys: Keys) -> dict[str, zenoh.Publisher]:
    """One publisher per severity, with priority over the data streams."""
    return {
        severity: declare_publisher(
            session,
            keys.event(severity),
            encoding=zenoh.Encoding.APPLICATION_JSON,
            priority=zenoh.Priority.DATA_HIGH,
        )
        for severity in SEVERITIES
    }
