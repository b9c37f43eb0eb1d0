"""Emergency messages in the words of CiA 301."""

from __future__ import annotations

import pytest

from rigctl.model import emergency


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (0x1000, "generic error"), (0x1234, "generic error"), (0x2000, "current"), (0x2110, "current, input side"),
        (0x2F00, "current"), (0x3210, "voltage inside the device"), (0x4210, "device temperature"),
        (0x5441, "device hardware"), (0x6010, "device software"), (0x6100, "internal software"),
        (0x6200, "user software"), (0x6320, "data set"), (0x7000, "additional modules"), (0x8110, "CAN overrun"),
        (0x8130, "heartbeat or life guard lost"), (0x8100, "communication"), (0x8210, "PDO not processed: length"),
        (0x9000, "external error"), (0xF001, "additional functions"), (0xFF00, "device specific"),
        (0xA000, "class unknown to CiA 301"),
    ],
)  # fmt: skip
def test_a_code_has_the_meaning_that_cia_301_gives_it_or_its_class(code: int, said: str) -> None:
    assert emergency.code_words(code) == said


def test_an_emergency_is_over_only_with_an_empty_register() -> None:
    assert emergency.words(0x0000, 0x00, bytes(5)) == "emergency over"
    assert emergency.words(0x0000, 0x81, bytes(5)) == (
        "one emergency is over (0x0000), others are active: error register 0x81: generic, manufacturer"
    )
    assert emergency.words(0xFF01, 0x01, bytes(5)).endswith("generic; manufacturer's bytes 00 00 00 00 00")
