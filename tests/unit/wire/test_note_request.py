"""An operator's note on the wire: what is read, and what is refused in one line."""

from __future__ import annotations

import msgspec
import pytest

from rigctl.wire.command_request import RequestError
from rigctl.wire.note_request import LONGEST_BYTES, NoteRequest, parse_note
from rigctl.wire.schema import schema


def test_words_are_read_on_one_line() -> None:
    assert parse_note(b'{"operator": " kim ", "text": " a\\n new  rope "}') == NoteRequest("kim", "a new rope")
    longest = "ü" * (LONGEST_BYTES // 2)
    assert parse_note(msgspec.json.encode({"operator": "kim", "text": longest})).text == longest


@pytest.mark.parametrize("text", ["", "  ", "x" * (LONGEST_BYTES + 1), "ü" * LONGEST_BYTES, "a\x07b"])
def test_words_that_are_none_or_too_many_are_refused(text: str) -> None:
    with pytest.raises(RequestError, match="expected 1 to 400 bytes") as refused:
        parse_note(msgspec.json.encode({"operator": "kim", "text": text}))
    assert "\n" not in str(refused.value)


def test_the_schema_describes_a_note() -> None:
    found = schema("rig")["note"]
    assert found["key"].endswith("/cmd/note")
    assert {row["name"] for row in found["payload"]} == {"operator", "text", "lease", "run_id"}
