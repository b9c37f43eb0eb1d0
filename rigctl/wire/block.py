"""Blocks of the fast stream: a header of 48 bytes, then the records as in the ring, all little-endian.

======  =====  ===========================================================================================
offset  type   meaning
======  =====  ===========================================================================================
0       4s     magic ``RGF1``
4       u16    version of this layout
6       u16    header size; records begin here
8       u32    size of one record
12      u32    number of records
16      u64    sequence number of the first record; within a block they follow without a gap
24      u64    records overwritten in the ring so far before a gateway could publish them
32      u64    stream: changes when the daemon is restarted and numbers begin at 1 again
40      u64    newest sequence number in the ring when the block was made
======  =====  ===========================================================================================

This module does not import numpy: a subscriber that only counts needs the header alone.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

MAGIC = b"RGF1"
VERSION = 1
HEADER = struct.Struct("<4sHHIIQQQQ")
HEADER_FIELDS = (
    ("magic", "4s", "RGF1"),
    ("version", "H", "version of this layout"),
    ("header_size", "H", "records begin here"),
    ("record_size", "I", "bytes of one record"),
    ("count", "I", "number of records"),
    ("first_seq", "Q", "sequence number of the first record; the others follow without a gap"),
    ("lost", "Q", "records overwritten before a gateway could publish them, so far"),
    ("stream", "Q", "changes when the daemon is started anew and numbers begin at 1 again"),
    ("head_seq", "Q", "sequence number written last when the block was made"),
)


class FastBlockError(ValueError):
    """Bytes that are not a block of the fast stream."""


@dataclass(frozen=True)
class Block:
    """A decoded block; ``data`` is ``count`` records of ``record_size`` bytes."""

    record_size: int
    count: int
    first_seq: int
    lost: int
    stream: int
    head_seq: int
    data: memoryview

    @property
    def last_seq(self) -> int:
        """Sequence number of the last record (``first_seq - 1`` of an empty block)."""
        return self.first_seq + self.count - 1

    def part(self, first_seq: int, last_seq: int) -> Block:
        """The block's records from ``first_seq`` to ``last_seq``, as a block."""
        first, last = max(first_seq, self.first_seq), min(last_seq, self.last_seq)
        count = max(0, last - first + 1)
        start = (first - self.first_seq) * self.record_size if count else 0
        data = self.data[start : start + count * self.record_size]
        return Block(self.record_size, count, first, self.lost, self.stream, self.head_seq, data)


def encode(data: bytes, record_size: int, *, first_seq: int, lost: int, stream: int, head_seq: int) -> bytes:
    """A block of whole records."""
    count = len(data) // record_size
    return HEADER.pack(MAGIC, VERSION, HEADER.size, record_size, count, first_seq, lost, stream, head_seq) + data


def decode(payload: bytes) -> Block:
    """Read a block.

    Raises:
        FastBlockError: the message says what does not fit.
    """
    if len(payload) < HEADER.size:
        raise FastBlockError(f"{len(payload)} bytes, a header has {HEADER.size}")
    magic, version, start, size, count, first_seq, lost, stream, head_seq = HEADER.unpack_from(payload)
    if magic != MAGIC or version != VERSION:
        raise FastBlockError(f"found {magic!r} version {version}, expected {MAGIC!r} version {VERSION}")
    if size < 8 or first_seq + count > 2**63 or head_seq > 2**63:
        raise FastBlockError(f"found {count} records of {size} bytes from {first_seq} on, expected records of a rig")
    if start < HEADER.size or len(payload) != start + count * size:
        raise FastBlockError(f"{len(payload)} bytes do not hold {count} records of {size} after {start}")
    return Block(size, count, first_seq, lost, stream, head_seq, memoryview(payload)[start:])
