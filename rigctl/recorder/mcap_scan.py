"""The whole records of an MCAP file that may have been cut off or damaged anywhere.

The index at its end is not needed. What a record holds is read by mcap's own reader; where it begins and ends is found
here, because that reader ends at the first damaged record. Layout: mcap.dev/spec.
"""

from __future__ import annotations

import io
import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk

from rigctl.model.quantity import count

MAGIC = b"\x89MCAP0\r\n"
READ = frozenset({Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.SCHEMA, Opcode.CHANNEL})
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = _HEAD.size + struct.calcsize("<QQQIIQ")
_LARGEST_CHUNK = 1 << 28
_DAMAGED = (struct.error, ValueError, OverflowError, McapError)


class ScanError(ValueError):
    """Not an MCAP file; ``str()`` says why, without the file's name."""


class DamageError(ValueError):
    """A damaged record: its content does not match its head or checksum."""


@dataclass(frozen=True)
class Piece:
    """One record of the file: its kind, its offset, and the offset of its end."""

    opcode: int
    offset: int
    end: int


class Scan:
    """Finds a file's records; afterwards ``note`` says why the file is incomplete, "" if it is complete."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        """``data``: the whole file.

        Raises:
            ScanError: it is not an MCAP file.
        """
        first = data[: len(MAGIC)]
        if first != MAGIC:
            raise ScanError("cut off within its first bytes" if MAGIC.startswith(first) else "not an MCAP file")
        self._data = data
        self.note = "not read yet"

    def pieces(self) -> Iterator[Piece]:
        """Records in file order, up to the end of the data section."""
        data, size, at = self._data, len(self._data), len(MAGIC)
        while at + _HEAD.size <= size:
            opcode, length = _HEAD.unpack_from(data, at)
            end = at + _HEAD.size + length
            if not 0 < opcode <= Opcode.DATA_END:
                self.note = f"damaged at byte {at}"
                return
            if end > size:
                break
            yield Piece(opcode, at, end)
            at = end
            if opcode == Opcode.DATA_END:
                closed = size >= at + len(MAGIC) and data[size - len(MAGIC) : size] == MAGIC
                self.note = "" if closed else "cut off within its index"
                return
        self.note = f"cut off: {count(size - at, 'byte')} after the last whole record" if size > at else "cut off"

    def content(self, piece: Piece) -> list[Any]:
        """What a record holds, as objects of `mcap.records`; of a chunk all that is in it.

        Raises:
            DamageError: the record is damaged.
        """
        raw = io.BytesIO(self._data[piece.offset : piece.end])
        try:
            record = next(iter(StreamReader(raw, skip_magic=True, emit_chunks=True).records))
        except _DAMAGED:
            of_chunk = piece.opcode == Opcode.CHUNK
            raise DamageError("a chunk's head is damaged" if of_chunk else "a record is damaged") from None
        if not isinstance(record, Chunk):
            return [record]
        if _CHUNK_HEAD + len(record.compression) + len(record.data) != piece.end - piece.offset:
            raise DamageError("a chunk's head is damaged")
        return _unpacked(record)


def _unpacked(chunk: Chunk) -> list[Any]:
    """The records in a chunk. Its head is checked first: it says how much memory the content takes."""
    packed, size = chunk.data, chunk.uncompressed_size
    if chunk.compression not in ("", "zstd"):
        raise DamageError(f"a chunk is compressed by {chunk.compression[:20]!r}, expected zstd or none")
    try:
        found = zstandard.frame_content_size(packed) if chunk.compression else len(packed)
        if size > _LARGEST_CHUNK or found not in (size, -1):
            raise DamageError("a chunk's head is damaged")
        return breakup_chunk(chunk, validate_crc=True)
    except zstandard.ZstdError:
        raise DamageError("a chunk cannot be decompressed") from None
    except CRCValidationError:
        raise DamageError("a chunk's checksum does not fit") from None
    except DamageError:
        raise
    except _DAMAGED:
        raise DamageError("a chunk ends within a record") from None
