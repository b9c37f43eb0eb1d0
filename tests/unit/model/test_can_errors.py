"""CAN error frames of the kernel's drivers in an operator's words."""

from __future__ import annotations

import pytest

from rigctl.model import can_errors
from rigctl.model.events import Kind, worded

FRAMES = (
    (0x040, "00" * 8, "error", "bus-off: the controller has left the bus (set the interface down and up again)"),
    (0x204, "0020000000008200", "warning", "error-passive, transmitting (error counter above 127)"),
    (0x204, "0010", "warning", "error-passive, receiving (error counter above 127)"),
    (0x204, "0004000000000064", "warning", "error warning, receiving (error counter at 96 or above)"),
    (0x204, "0008", "warning", "error warning, transmitting (error counter at 96 or above)"),
    (0x204, "0040000000000a00", "warning", "error-active again"),
    (0x08C, "0001000000000000", "warning", "receive overrun, frames lost, bus error"),
    (0x08C, "0002000000000000", "warning", "transmit overrun, frames lost, bus error"),
    (0x088, "0000050800000000", "warning", "bus error, bit error, stuff error"),
    (0x0A8, "0000001900000000", "warning", "no acknowledgement: no other node on the bus answers, bus error"),
    (0x001, "", "error", "transmit time-out: the controller cannot get a frame onto the bus"),
    (0x044, "0020", "error", "bus-off: the controller has left the bus (set the interface down and up again), "
     "error-passive, transmitting (error counter above 127)"),
    (0x100, "", "warning", "controller restarted"),
    (0x000, "0012", "warning", "class 0x000, data 0x0012"),
    (0x004, "0080", "warning", "class 0x004, data 0x0080"),
)  # fmt: skip


@pytest.mark.parametrize(("classes", "data", "severity", "words"), FRAMES)
def test_an_error_frame_in_words(classes: int, data: str, severity: str, words: str) -> None:
    event = worded(Kind.BUS_ERROR, classes, can_errors.details(bytes.fromhex(data)), 0.0, 0.0, "")
    assert (event.severity, event.text) == (severity, f"CAN error frame: {words}")


def test_no_word_for_any_bit_is_an_error() -> None:
    for bit in range(29):
        for found in (0, *(1 << i for i in range(16))):
            assert can_errors.in_words(1 << bit, found)


def test_every_class_of_the_kernel_has_words_of_its_own() -> None:
    """linux/can/error.h: the classes that need no further data."""
    said = [can_errors.in_words(1 << bit, 0) for bit in (0, 1, 4, 5, 6, 7, 8)]
    assert len(set(said)) == len(said)
    assert not [words for words in said if "class 0x" in words]
