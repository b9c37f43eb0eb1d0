"""SDO frames of others in words, and answers to ours."""

from __future__ import annotations

import struct

import pytest

from rigctl.devices import sdo


@pytest.mark.parametrize(
    ("command", "value", "said"),
    [
        (0x2F, 3, "writes node 4 0x6007:01 = 3"), (0x2B, 500, "writes node 4 0x6007:01 = 500"),
        (0x23, 0xFFFFFFFF, "writes node 4 0x6007:01 = 4294967295"), (0x2F, 0xAABBCC03, "writes node 4 0x6007:01 = 3"),
        (0x21, 20, "writes node 4 0x6007:01"), (0xC6, 20, "writes node 4 0x6007:01"),
        (0x40, 0, "reads node 4 0x6007:01"), (0xA0, 0, "reads node 4 0x6007:01"),
        (0x80, 0x05040000, "aborts a transfer of node 4 0x6007:01"),
        (0x00, 0, "goes on an SDO transfer with node 4"), (0x60, 0, "goes on an SDO transfer with node 4"),
    ],
)  # fmt: skip
def test_another_masters_request_is_told_with_object_and_value(command: int, value: int, said: str) -> None:
    assert sdo.foreign_request(4, struct.pack("<BHBI", command, 0x6007, 1, value)) == said


def test_an_abort_without_a_code_is_an_abort() -> None:
    assert sdo.upload_answer(struct.pack("<BHBI", 0x80, 0x6007, 0, 0), 2).abort
    assert sdo.upload_answer(struct.pack("<BHBI", 0x80, 0x6007, 0, 0x06020000), 2).abort == 0x06020000


@pytest.mark.parametrize(
    ("command", "answered", "value"),
    [
        (0x4B, 0xABCD0002, 0x0002),  # two bytes
        (0x43, 0x00000002, 0x0002),  # four, by zeros
        (0x43, 0xFFFFFFFE, 0xFFFE),  # four, by the sign
        (0x43, 0x00010002, 0x10002), (0x43, 0xFFFF0002, 0xFFFF0002), (0x43, 100_000, 100_000), (0x47, 0x10002, 0x10002),
        (0x42, 0x00010002, 0x0002),  # without a length: what is beyond the object's size is nothing
    ],
)  # fmt: skip
def test_an_answer_longer_than_its_object_is_another_value(command: int, answered: int, value: int) -> None:
    assert sdo.upload_answer(struct.pack("<BHBI", command, 0x605E, 0, answered), 2).value == value
