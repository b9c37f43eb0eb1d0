"""Notes of the gateway, in an operator's words."""

from __future__ import annotations

import pytest

from rigctl.ipc.notes import Note, worded

OF_THE_DAEMON = (
    Note.LEASE_NOT_BELIEVED, Note.ENDPOINT_TAKEN, Note.ENDPOINT_BACK, Note.PROCESS_LOST, Note.PROCESS_BACK,
    Note.AUDIT_LOG_CHANGED,
)  # fmt: skip


@pytest.mark.parametrize("note", Note)
def test_every_note_names_who_it_is_about(note: Note) -> None:
    _, said = worded(note, "kim", "lee", "12 commands in 10 s")
    assert "kim" in said or note in OF_THE_DAEMON


def test_refused_commands_are_reported_with_their_number_and_name_or_that_there_is_none() -> None:
    assert worded(Note.TOO_MANY_COMMANDS, "kim", "", "12 commands")[1].startswith("12 commands from kim refused")
    unknown = "12 commands from an unknown operator refused"
    assert worded(Note.TOO_MANY_COMMANDS, "", "", "12 commands")[1].startswith(unknown)
