"""The help of every command, as it is on a terminal of 80 columns."""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Iterator, Mapping
from typing import Any

import typer

from rigctl.cli import typer_app
from rigctl.cli.top_help import top_help

COLUMNS = "80"
_COLOUR = re.compile(r"\x1b\[[\d;]*m")


def helps(hil: typer.Typer, program: str) -> dict[str, str]:
    """By command, of ``rigctl`` and of ``hil``, whose commands are typed as those of ``program``."""
    with _columns():
        top = {"help rigctl": top_help()}
        return dict(_of(program, hil)) | dict(_of("rigctl", typer_app.program())) | top


@contextlib.contextmanager
def _columns() -> Iterator[None]:
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = COLUMNS
    try:
        yield
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before


def _of(program: str, app: typer.Typer) -> Iterator[tuple[str, str]]:
    command = typer.main.get_command(app)
    for words in _commands(command):
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown):
            command.main([*words, "--help"], prog_name=program, standalone_mode=False)
        yield " ".join(("help", program, *words)), _COLOUR.sub("", shown.getvalue())


def _commands(command: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The words of a command and of those below it."""
    yield above
    below: Mapping[str, Any] = getattr(command, "commands", {})
    for name, one in below.items():
        yield from _commands(one, (*above, name))
