"""``rigctl note``: words that go on record with the run."""

from __future__ import annotations

from typing import Annotated

import typer

from rigctl.cli.operator_name import operator_name
from rigctl.cli.options import Connect, Json, Operator, Rig, daemon, end_with_answer

Words = Annotated[str, typer.Argument(metavar="TEXT", help="The words, in quotes.")]


def note(text: Words, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Put words on record with the run: an event, an entry of the audit log, a line of runs and of the report."""
    with daemon(connect, rig) as client:
        answer = client.note(operator_name(operator), text.encode(errors="replace").decode())
    end_with_answer(answer, json)
