"""The option ``--json`` of commands that play or compute for a while: a flag that prints, or with a file for them.

One rule: ``--json`` prints the figures as one JSON document on standard output, in place of the words. These commands
take a file too, ``--json FILE``, which gets them beside the words; ``--json -`` is ``--json``.
"""

from __future__ import annotations

import pathlib
from collections.abc import Iterator
from typing import Annotated

import typer

STANDARD_OUTPUT = pathlib.Path("-")
JsonFile = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--json",
        metavar="[FILE]",
        help="Print the figures as JSON in place of the words; FILE: write them there.",
    ),
]
_OPTION = "--json"


def with_files(words: list[str]) -> list[str]:
    """A command line in which each ``--json`` has its file: standard output where none is named.

    What follows ``--json`` is its file, unless it is another option or nothing does.
    """
    return [*_with_files(words)]


def _with_files(words: list[str]) -> Iterator[str]:
    for at, word in enumerate(words):
        yield word
        after = words[at + 1] if at + 1 < len(words) else "--"
        if word == _OPTION and after.startswith("-") and after != str(STANDARD_OUTPUT):
            yield str(STANDARD_OUTPUT)


def complaint(json: pathlib.Path | None) -> str | None:
    """Why figures are not written to a file: it has the name of a rig file, which was meant for the command."""
    if json is None or json.suffix.lower() not in (".yaml", ".yml"):
        return None
    return f"--json: found {json}, expected a file for the figures (--json behind the rig file prints them)"
