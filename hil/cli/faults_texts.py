"""``python -m hil faults --texts``: every text by its name, and the comparison with those of another commit."""

from __future__ import annotations

import json
import pathlib
from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher

import typer

from hil.cli import reference
from hil.cli.files import check_outputs, simulated_rig
from hil.cli.two_files import conclude, print_line
from hil.scenario.errors import ScenarioError
from hil.texts.helps import helps
from hil.texts.pages import pages
from hil.texts.words import words
from rigctl.config.settings import RigSettings
from rigctl.ipc import output_file

Texts = dict[str, list[str]]
"""Lines by the name of the text."""
_LINES_SHOWN = 6


def run(
    rig_file: pathlib.Path, file: pathlib.Path, against: pathlib.Path | None, app: typer.Typer, program: str
) -> int:
    """Write every text into ``file``, and compare them with those of another file.

    Args:
        rig_file: with the ``simulation`` section; its figures are in some of the texts.
        file: gets the texts, as JSON.
        against: texts of another commit.
        app: the commands of this program.
        program: as it is typed.

    Returns:
        0 when nothing is compared or all is equal, else 1.

    Raises:
        ScenarioError, ConfigError: bad input, or a rig that cannot be simulated.
        OutputError: the file cannot be written.
    """
    rig = simulated_rig(rig_file)
    check_outputs({"--texts": file}, [rig_file, *([against] if against is not None else [])])
    other = None if against is None else _read(against)
    found = texts(rig, app, program)
    output_file.write(file, json.dumps(found, indent=1, ensure_ascii=False, sort_keys=True) + "\n")
    print_line(f"{len(found)} texts")
    return 0 if other is None else _compare(found, other)


def texts(rig: RigSettings, app: typer.Typer, program: str) -> Texts:
    """Every text of this commit."""
    generated = {f"page {name}": text for name, text in reference.documents().items()}
    found = helps(app, program) | generated | pages(rig) | words()
    return {name: text.split("\n") for name, text in sorted(found.items())}


def _read(file: pathlib.Path) -> Texts:
    try:
        return {str(name): [str(line) for line in lines] for name, lines in json.loads(file.read_text()).items()}
    except (OSError, ValueError, AttributeError, TypeError):
        raise ScenarioError([f"--against: {file} holds no texts, expected a file of --texts"]) from None


def _compare(found: Texts, other: Texts) -> int:
    differing = [name for name in found if name in other and found[name] != other[name]]
    for name in differing:
        lines = list(_differing(found[name], other[name]))
        print_line(f"{name}:")
        for line in lines[:_LINES_SHOWN]:
            print_line(f"  {line}")
        if len(lines) > _LINES_SHOWN:
            print_line(f"  and {len(lines) - _LINES_SHOWN} more")
    return conclude("text", found, other, differing)


def _differing(here: Sequence[str], there: Sequence[str]) -> Iterator[str]:
    """Lines that only one side has, in their order: those of the other side with a minus."""
    for _, there_from, there_to, here_from, here_to in (
        step for step in SequenceMatcher(None, there, here, autojunk=False).get_opcodes() if step[0] != "equal"
    ):
        yield from (f"- {line}" for line in there[there_from:there_to])
        yield from (f"+ {line}" for line in here[here_from:here_to])
