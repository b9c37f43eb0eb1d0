"""Frames of the bus as blocks: one protobuf message for many frames, one column for each value.

With one message for each frame, headers and index would take more space than the frames.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

from rigctl.ipc.record import FRAME
from rigctl.recorder.protobuf import WIRE_64, WIRE_BYTES, tag

NAME = "rigctl.FrameBlock"
BLOCK_FRAMES = 4096
_P = FieldDescriptorProto
_FIELDS = (
    ("seq", _P.TYPE_FIXED64, _P.LABEL_OPTIONAL),  # of the first frame; the others follow without a gap
    ("t_ns", _P.TYPE_SFIXED64, _P.LABEL_OPTIONAL),  # of the first frame, CLOCK_MONOTONIC
    ("later_ns", _P.TYPE_SFIXED32, _P.LABEL_REPEATED),  # time since the frame before
    ("can_id", _P.TYPE_FIXED32, _P.LABEL_REPEATED),
    ("sent", _P.TYPE_BYTES, _P.LABEL_OPTIONAL),  # a byte for each frame: 1 sent, 0 received
    ("dlc", _P.TYPE_BYTES, _P.LABEL_OPTIONAL),
    ("data", _P.TYPE_BYTES, _P.LABEL_OPTIONAL),  # 8 bytes for each
)
_HEAD = struct.Struct("<1sQ1sq")
_COLUMNS = (("later_ns", "<i4"), ("can_id", "<u4"), ("sent", "u1"), ("dlc", "u1"), ("data", "S8"))
_LONGEST_NS = 2**31 - 1


class FrameBlockError(ValueError):
    """Bytes that are not a block."""


def descriptor() -> bytes:
    """A serialised ``FileDescriptorSet``: the schema."""
    files = FileDescriptorSet()
    file = files.file.add(name="rigctl/frame_block.proto", package="rigctl", syntax="proto3")
    message = file.message_type.add(name=NAME.split(".")[1])
    for number, (name, kind, label) in enumerate(_FIELDS, 1):
        message.field.add(name=name, number=number, type=kind, label=label)
    return bytes(files.SerializeToString())


def encode(frames: npt.NDArray[np.void]) -> Iterator[tuple[int, int, bytes]]:
    """``FRAME`` slots as blocks: number and time of the first frame, and the message."""
    if not len(frames):
        return
    later = np.diff(frames["t_ns"], prepend=frames["t_ns"][:1])
    breaks = (np.diff(frames["seq"].astype(np.int64), prepend=0) != 1) | (np.abs(later) > _LONGEST_NS)
    cuts = np.union1d(np.flatnonzero(breaks), np.arange(0, len(frames), BLOCK_FRAMES))
    for part in np.split(np.arange(len(frames)), cuts):
        if len(part):
            block = frames[part[0] : part[-1] + 1]
            yield int(block["seq"][0]), int(block["t_ns"][0]), _message(block)


def _message(block: npt.NDArray[np.void]) -> bytes:
    first_seq, first_ns = int(block["seq"][0]), int(block["t_ns"][0])
    parts = [_HEAD.pack(tag(1, WIRE_64), first_seq, tag(2, WIRE_64), first_ns)]
    columns = {name: block[name] for name, _ in _COLUMNS if name != "later_ns"}
    columns["later_ns"] = np.diff(block["t_ns"], prepend=block["t_ns"][:1])
    for number, (name, kind) in enumerate(_COLUMNS, 3):
        raw = np.ascontiguousarray(columns[name].astype(kind)).tobytes()
        parts += [tag(number, WIRE_BYTES), _varint(len(raw)), raw]
    return b"".join(parts)


def decode(messages: Sequence[bytes]) -> npt.NDArray[np.void]:
    """The frames of blocks, one after the other.

    Raises:
        FrameBlockError: the bytes are not a block.
    """
    return np.concatenate([_frames(memoryview(message)) for message in messages])


def _frames(message: memoryview) -> npt.NDArray[np.void]:
    """A block's frames.

    Raises:
        FrameBlockError: the bytes are not a block.
    """
    try:
        first, seq, second, t_ns = _HEAD.unpack_from(message)
    except struct.error:
        raise FrameBlockError("too short") from None
    if (first, second) != (tag(1, WIRE_64), tag(2, WIRE_64)):
        raise FrameBlockError("not laid out as a block")
    at, columns = _HEAD.size, {}
    for number, (name, kind) in enumerate(_COLUMNS, 3):
        if bytes(message[at : at + 1]) != tag(number, WIRE_BYTES):
            raise FrameBlockError("not laid out as a block")
        size, at = _read_varint(message, at + 1)
        raw, at = message[at : at + size], at + size
        if len(raw) != size or size % np.dtype(kind).itemsize:
            raise FrameBlockError("a column is cut")
        columns[name] = np.frombuffer(raw, kind)
    count = len(columns["later_ns"])
    if at != len(message) or any(len(column) != count for column in columns.values()):
        raise FrameBlockError("columns of unequal length")
    frames = np.zeros(count, FRAME.dtype)
    with np.errstate(over="ignore"):
        frames["seq"] = np.uint64(seq) + np.arange(count, dtype=np.uint64)
        frames["t_ns"] = t_ns + np.cumsum(columns["later_ns"], dtype=np.int64)
    for name in ("can_id", "sent", "dlc", "data"):
        frames[name] = columns[name]
    return frames


def _varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _read_varint(message: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(message) and shift < 35:
        byte = message[at]
        value |= (byte & 0x7F) << shift
        at += 1
        if byte < 0x80:
            return value, at
        shift += 7
    raise FrameBlockError("not laid out as a block")
