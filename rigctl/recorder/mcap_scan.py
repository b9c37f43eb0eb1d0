"""The whole records of an MCAP file that may have been cut off anywhere.

The index at its end is not needed. Layout: mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import zstandard

from rigctl.config.quantity import count

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
ATTACHMENT, METADATA, DATA_END = 9, 12, 15
_LAST_OPCODE = 15
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_LARGEST_CHUNK = 1 << 28

Buffer = memoryview


class ScanError(ValueError):
    """Not an MCAP file; ``str()`` says why, without the file's name."""


class DamageError(ValueError):
    """A damaged record: its content does not match its head or checksum."""


@dataclass(frozen=True)
class Piece:
    """One record of the file: its kind, its content and its offset."""

    opcode: int
    content: Buffer
    offset: int


class Scan:
    """Reads a file's records; afterwards ``note`` says why the file is incomplete, "" if it is complete."""

    def __init__(self, data: Buffer) -> None:
        """``data``: the whole file.

        Raises:
            ScanError: it is not an MCAP file.
        """
        if bytes(data[: len(MAGIC)]) != MAGIC:
            cut = MAGIC.startswith(bytes(data[: len(MAGIC)]))
            raise ScanError("cut off within its first bytes" if cut else "not an MCAP file")
        self._data = data
        self.note = "not read yet"
        self.end = len(MAGIC)
        """Offset of the end of the last whole record."""

    def pieces(self) -> Iterator[Piece]:
        """Records in file order, up to the end of the data section."""
        data, size, at = self._data, len(self._data), len(MAGIC)
        while at + _HEAD.size <= size:
            opcode, length = _HEAD.unpack_from(data, at)
            start, end = at + _HEAD.size, at + _HEAD.size + length
            if not 0 < opcode <= _LAST_OPCODE:
                self.note = f"damaged at byte {at}"
                return
            if end > size:
                break
            yield Piece(opcode, data[start:end], at)
            at = self.end = end
            if opcode == DATA_END:
                closed = size >= at + len(MAGIC) and bytes(data[size - len(MAGIC) :]) == MAGIC
                self.note = "" if closed else "cut off within its index"
                return
        self.note = (
            f"cut off: {count(size - self.end, 'byte')} after the last whole record" if size > self.end else "cut off"
        )


def unpacked(chunk: Buffer) -> bytes:
    """The decompressed content of a chunk: schemas, channels and messages in sequence.

    Raises:
        DamageError: the chunk is damaged.
    """
    try:
        _, _, size, crc = _CHUNK.unpack_from(chunk)
        (name_size,) = struct.unpack_from("<I", chunk, _CHUNK.size)
        at = _CHUNK.size + 4
        compression = bytes(chunk[at : at + name_size]).decode("ascii")
        (length,) = struct.unpack_from("<Q", chunk, at + name_size)
        packed = chunk[at + name_size + 8 :]
    except (struct.error, UnicodeDecodeError):
        raise DamageError("a chunk's head is damaged") from None
    if length != len(packed) or size > _LARGEST_CHUNK:
        raise DamageError("a chunk's head is damaged")
    data = _decompressed(compression, packed, size)
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise DamageError("a chunk's checksum does not fit")
    return data


def _decompressed(compression: str, packed: Buffer, size: int) -> bytes:
    try:
        match compression:
            case "":
                return bytes(packed)
            case "zstd":
                if zstandard.frame_content_size(packed) not in (size, -1):
                    raise DamageError("a chunk's head is damaged")
                return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError:
        raise DamageError("a chunk cannot be decompressed") from None
    raise DamageError(f"a chunk is compressed by {compression[:20]!r}, expected zstd or none")


def records(data: Buffer) -> Iterator[Piece]:
    """Records within a chunk.

    Raises:
        DamageError: a record does not end within the chunk.
    """
    at, size = 0, len(data)
    while at < size:
        if at + _HEAD.size > size:
            raise DamageError("a chunk ends within a record")
        opcode, length = _HEAD.unpack_from(data, at)
        start, end = at + _HEAD.size, at + _HEAD.size + length
        if end > size:
            raise DamageError("a chunk ends within a record")
        yield Piece(opcode, data[start:end], at)
        at = end
