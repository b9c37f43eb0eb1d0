"""SDO frames of CiA 301 for the loop: request of an object, its answer, and words for other masters' frames."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from rigctl.config.built_type import built
from rigctl.config.settings import RigSettings

SIZE = 8
READS_HZ, FEWEST_TICKS = 100, 4  # largest rate of the loop's requests, and least ticks between two
_MULTIPLEXER = struct.Struct("<HB")
_REQUEST = struct.Struct("<BHB4x")
_WRITE = struct.Struct("<BHBI")
_VALUE = struct.Struct("<I")
_SPECIFIER = 0xE0
_UPLOAD, _DOWNLOAD, _ABORT, _BLOCK_UPLOAD, _BLOCK_DOWNLOAD = 0x40, 0x20, 0x80, 0xA0, 0xC0
_UPLOADED, _DOWNLOADED = 0x40, 0x60  # of the server
_EXPEDITED, _SIZED = 0x02, 0x01
_DOWNLOAD_16 = _DOWNLOAD | 2 << 2 | _EXPEDITED | _SIZED  # two of the four bytes hold no value
_BLOCK_INITIATE = 0x01  # bit 0 of the sub-command: 0 begins a block transfer


@built
@dataclass(frozen=True)
class Watched:
    """One object of a device that must keep the value that start-up has read back.

    ``size`` is in bytes, by the device's EDS; ``wanted`` is the value's bit pattern; ``timeout_ms`` is how long the
    device may take to answer; ``obeys``: the drive does not follow commands without it.
    """

    node: int
    index: int
    sub: int
    size: int
    wanted: int
    name: str
    timeout_ms: int
    obeys: bool = False

    @property
    def words(self) -> str:
        """``node 4 0x6007:00 abort connection option``, short enough for an event's text."""
        return f"{place(self.node, self.index, self.sub)} {self.name[:24]}".rstrip()


@dataclass(frozen=True)
class UploadAnswer:
    """An upload's answer: an object's bit pattern or the abort code; more frames follow if not ``expedited``."""

    value: int = 0
    abort: int = 0
    expedited: bool = True


def every_ticks(settings: RigSettings) -> int:
    """Ticks of the loop from one request to the next, which bounds the requests' bus load."""
    return max(FEWEST_TICKS, math.ceil(settings.loop.rate_hz / READS_HZ))


def place(node: int, index: int, sub: int) -> str:
    """``node 4 0x6007:00``."""
    return f"node {node} 0x{index:04X}:{sub:02X}"


def upload_request(index: int, sub: int) -> bytes:
    """Initiate upload (CiA 301): request an object's value."""
    return _REQUEST.pack(_UPLOAD, index, sub)


def write_request(index: int, sub: int, value: int) -> bytes:
    """Initiate an expedited download (CiA 301) of 16 bits."""
    return _WRITE.pack(_DOWNLOAD_16, index, sub, value)


def answered(data: bytes | bytearray) -> tuple[int, int] | None:
    """Index and sub-index of an answer to an upload or a write, or of an abort; None for another frame."""
    if len(data) != SIZE or data[0] & _SPECIFIER not in (_UPLOADED, _DOWNLOADED, _ABORT):
        return None
    return _MULTIPLEXER.unpack_from(data, 1)


def upload_answer(data: bytes | bytearray, size: int) -> UploadAnswer:
    """Content of such an answer, for an object of ``size`` bytes; a longer value is cut only where it is padded.

    A device may extend a value to four bytes, by zeros or by its sign.
    """
    (value,) = _VALUE.unpack_from(data, 4)
    if data[0] & _SPECIFIER == _ABORT:
        return UploadAnswer(abort=value or 1)
    if not data[0] & _EXPEDITED:
        return UploadAnswer(expedited=False)
    used, bits = _used(data, size), 8 * size
    value &= (1 << 8 * used) - 1
    sign = value >> bits - 1
    if used > size and sign == (1 << 8 * used - bits + 1) - 1:
        value &= (1 << bits) - 1
    return UploadAnswer(value)


def _used(data: bytes | bytearray, size: int) -> int:
    """Bytes of an expedited transfer that hold the value; ``size`` where the transfer has no length."""
    return SIZE // 2 - (data[0] >> 2 & 3) if data[0] & _SIZED else size


def multiplexer(data: bytes | bytearray) -> tuple[int, int] | None:
    """Index and sub-index in an SDO frame of a client or a server; None for a later frame of a transfer."""
    if len(data) != SIZE:
        return None
    specifier = data[0] & _SPECIFIER
    named = specifier in (_UPLOAD, _DOWNLOAD, _ABORT)
    named |= specifier in (_BLOCK_UPLOAD, _BLOCK_DOWNLOAD) and not data[0] & _BLOCK_INITIATE
    return _MULTIPLEXER.unpack_from(data, 1) if named else None


def foreign_request(node: int, data: bytes | bytearray) -> str:
    """Another master's request to a device, in words: ``writes node 4 0x6007:00 = 0``."""
    where = multiplexer(data)
    if where is None:
        return f"goes on an SDO transfer with node {node}"
    specifier, (value,) = data[0] & _SPECIFIER, _VALUE.unpack_from(data, 4)
    if specifier == _DOWNLOAD and data[0] & _EXPEDITED:
        return f"writes {place(node, *where)} = {value & (1 << 8 * _used(data, SIZE // 2)) - 1}"
    if specifier in (_DOWNLOAD, _BLOCK_DOWNLOAD):
        return f"writes {place(node, *where)}"
    return f"{'aborts a transfer of' if specifier == _ABORT else 'reads'} {place(node, *where)}"


def foreign_answer(node: int, data: bytes | bytearray) -> str:
    """A device's answer to a request that was not ours, in words."""
    if len(data) == SIZE and data[0] & _SPECIFIER in (_UPLOADED, _DOWNLOADED, _ABORT):
        index, sub = _MULTIPLEXER.unpack_from(data, 1)
        return f"is answered by {place(node, index, sub)}"
    return f"is answered by node {node}"
