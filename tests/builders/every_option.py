"""The commands and options of a program, by its own catalogue, and what holds for each run of them."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import typer

OWN_LINE = re.compile(r"(rigctl|hil): .|[a-z' ]+: [0-9]+ (%|s)(, .*)?$")
"""Of the program itself on standard error: a complaint or a note, or how far it is."""
FOREIGN = re.compile(r"Traceback|Error:|Warning:|site-packages|\.py:[0-9]")


def spellings(app: typer.Typer) -> dict[str, list[tuple[str, ...]]]:
    """The options of each command, each with its spellings; ``--no-x`` is one of its own. ``""``: the program's own."""
    group: Any = typer.main.get_group(app)
    found = {}
    for name, command in {"": group, **group.commands}.items():
        options = [part for part in command.params if part.param_type_name == "option"]
        found[name] = [tuple(each) for part in options for each in (part.opts, part.secondary_opts) if each]
    return found


def untried(app: typer.Typer, cases: Iterable[Sequence[str]]) -> list[str]:
    """Commands and options that no case has, each case the words behind the program's name."""
    tried: dict[str, set[str]] = {}
    for case in cases:
        own = "" if case[0].startswith("-") else case[0]
        tried.setdefault(own, set()).update(word.partition("=")[0] for word in case)
    return list(_untried(spellings(app), tried))


def _untried(known: dict[str, list[tuple[str, ...]]], tried: dict[str, set[str]]) -> Iterator[str]:
    for name, options in known.items():
        if name not in tried:
            yield name
        for spelling in options:
            if tried.get(name, set()).isdisjoint(spelling):
                yield f"{name} {'/'.join(spelling)}".strip()


def ended_well(done: subprocess.CompletedProcess[str], codes: Sequence[int] = (0, 1), *, words: bool = False) -> None:
    """Hold a command that has ended to its exit code, and its standard error to lines of its own.

    ``words``: it prints its words there, because its figures are on standard output.
    """
    assert done.returncode in codes, f"{done.returncode}: {done.stderr}"
    strange = [line for line in done.stderr.splitlines() if FOREIGN.search(line) or not (words or OWN_LINE.match(line))]
    assert not strange, done.stderr
    assert "Traceback" not in done.stdout


def documents(text: str) -> list[Any]:
    """What ``--json`` has printed: one document, or one in each line."""
    try:
        return [json.loads(text)]
    except json.JSONDecodeError:
        return [json.loads(line) for line in text.splitlines()]
