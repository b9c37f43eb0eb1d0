"""Frames on the wire are Linux ``struct can_frame``, both ways."""

from __future__ import annotations

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.wire import frame_of, message_of


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_standard_frames_survive(can_id: int, data: bytes) -> None:
    sent = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
    assert message_of(frame_of(sent), 0.0).equals(sent, timestamp_delta=None)


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.booleans())
def test_extended_and_error_frames_survive(can_id: int, data: bytes, error: bool) -> None:
    sent = can.Message(arbitration_id=can_id, data=data, is_extended_id=not error, is_error_frame=error)
    assert message_of(frame_of(sent), 0.0).equals(sent, timestamp_delta=None)


@given(st.integers(0, 0x7FF), st.integers(0, 8))
def test_remote_frames_survive_with_their_length(can_id: int, dlc: int) -> None:
    sent = can.Message(arbitration_id=can_id, is_remote_frame=True, dlc=dlc, is_extended_id=False)
    received = message_of(frame_of(sent), 0.0)
    assert (received.is_remote_frame, received.dlc, received.arbitration_id) == (True, dlc, can_id)


def test_layout_is_the_kernels() -> None:
    frame = frame_of(can.Message(arbitration_id=0x182, data=b"\x01\x02", is_extended_id=False))
    assert frame == bytes.fromhex("82010000 02 000000 0102000000000000")
    frame = frame_of(can.Message(arbitration_id=0x40, data=bytes(8), is_error_frame=True, is_extended_id=False))
    assert frame[:4] == bytes.fromhex("40000020")


def test_can_fd_is_refused() -> None:
    with pytest.raises(ValueError, match="classic"):
        frame_of(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))
