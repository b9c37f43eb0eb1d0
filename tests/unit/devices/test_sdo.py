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
