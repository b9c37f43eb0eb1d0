"""An operator's note on the wire: words that go on record with the run. Pure functions of bytes and values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec

from rigctl.config.built_type import built
from rigctl.wire.command_request import RequestError, decoded, lease_of, operator_of

NOTE = "note"
"""The request's name, as its key ends."""
LONGEST_BYTES = 400
_ALLOWED = '{"operator": "NAME", "text": "WORDS"}'


@built
class _NotePayload(msgspec.Struct, forbid_unknown_fields=True):
    operator: str
    text: str = ""
    lease: Any = None
    run_id: str = ""


@dataclass(frozen=True)
class NoteRequest:
    """``text``: the words. The others: see `Request`."""

    operator: str
    text: str
    lease: str | None = None
    run_id: str = ""
    command: str = NOTE


def parse_note(payload: bytes | None) -> NoteRequest:
    """Read the payload.

    Raises:
        RequestError: bad JSON, an unknown key, a wrong type, no operator, or no words, too many or not printable.
    """
    found = decoded(payload, _NotePayload, _ALLOWED)
    text = " ".join(found.text.split())
    if not text or len(text.encode(errors="replace")) > LONGEST_BYTES or not text.isprintable():
        raise RequestError(f"found text {text[:80]!r}, expected 1 to {LONGEST_BYTES} bytes of printable letters")
    return NoteRequest(operator_of(found.operator), text, lease_of(found.lease), found.run_id)
