"""Frames on the simulated bus: Linux ``struct can_frame``, 16 bytes, one per packet."""

from __future__ import annotations

import struct

import can

FRAME = struct.Struct("=IB3x8s")
"""Identifier with flags in its top bits, data length code, data padded to 8 bytes."""

FRAME_SIZE = FRAME.size
EXTENDED_FLAG = 0x80000000
REMOTE_FLAG = 0x40000000
ERROR_FLAG = 0x20000000
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFFFFFF


def frame_of(message: can.Message) -> bytes:
    """A python-can message as 16 bytes.

    Raises:
        ValueError: CAN FD, or more than 8 bytes of data.
    """
    if message.is_fd or message.dlc > 8:
        raise ValueError(f"rigsim carries classic CAN frames only, not {message}")
    can_id = message.arbitration_id
    if message.is_extended_id:
        can_id |= EXTENDED_FLAG
    if message.is_remote_frame:
        can_id |= REMOTE_FLAG
    if message.is_error_frame:
        can_id |= ERROR_FLAG
    return FRAME.pack(can_id, message.dlc, message.data)


def message_of(frame: bytes, timestamp_s: float, channel: str | None = None) -> can.Message:
    """16 bytes as a python-can message received at ``timestamp_s``."""
    can_id, dlc, data = FRAME.unpack(frame)
    if can_id <= STANDARD_MASK:
        return can.Message(timestamp_s, can_id, False, False, False, channel, dlc, bytearray(data[:dlc]))
    extended = bool(can_id & EXTENDED_FLAG)
    return can.Message(
        timestamp=timestamp_s,
        arbitration_id=can_id & (EXTENDED_MASK if extended or can_id & ERROR_FLAG else STANDARD_MASK),
        is_extended_id=extended,
        is_remote_frame=bool(can_id & REMOTE_FLAG),
        is_error_frame=bool(can_id & ERROR_FLAG),
        channel=channel,
        dlc=dlc,
        data=data[:dlc],
    )
