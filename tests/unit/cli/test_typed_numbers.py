"""Every number on a command line is read by one reader; what it refuses is one line with an example."""

from __future__ import annotations

import importlib
import inspect
import io
from collections.abc import Callable, Iterator
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pytest

from hil.__main__ import app
from hil.cli import new
from hil.new.rig_decisions import PAYLOAD
from rigctl.cli.verb_table import VERBS
from rigctl.config.typed_number import TypedNumber
from tests.conftest import Command

HIL = [command.callback for command in app.registered_commands if command.callback is not None]


def functions() -> Iterator[Callable[..., Any]]:
    for row in VERBS:
        module, _, name = row.place.partition(":")
        found = getattr(importlib.import_module(f"rigctl.cli.{module}"), name)
        if inspect.isfunction(found):
            yield found
        else:
            yield from (command.callback for command in found.registered_commands)
    yield from HIL


def numbers(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Parameters that are a number, a list of numbers or None, with what typer reads them by."""
    for name, hint in get_type_hints(function, include_extras=True).items():
        if get_origin(hint) is not Annotated:
            continue
        kind, info = get_args(hint)[:2]
        kinds = {kind, *get_args(kind), *(inner for outer in get_args(kind) for inner in get_args(outer))}
        if kinds & {int, float}:
            yield name, info


def test_every_number_of_every_command_goes_through_the_reader() -> None:
    found = [(function, name, info) for function in functions() for name, info in numbers(function)]
    assert len(found) > 25
    others = [
        f"{function.__module__}.{function.__name__}: {name}"
        for function, name, info in found
        if not isinstance(getattr(info.parser, "__self__", None), TypedNumber)
    ]
    assert others == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("new", "rig", "x", "--payload", "30,5"), "'--payload': found '30,5', expected a number of kg with a decimal"),
        (("new", "rig", "x", "--rate", "1_00"), "'--rate': found '1_00', expected a whole number such as 3"),
        (
            ("inject", "FILE", "cell_silent", "--for", "0,5"),
            "'--for': found '0,5', expected a number of seconds with a ",
        ),
        (("cell", "--cells", "0"), "'--cells': found 0, expected 1 to 10000 cells"),
        (("faults", "--draw", "1", "--only", "\uff10"), "--only: found '\uff10', expected a whole number such as 3"),
        (("faults", "--draw", "1", "--only", "1"), "--only: found 1, expected 0 to 0"),
    ],
)
def test_the_simulated_rigs_numbers_are_read_alike(in_process: Command, words: tuple[str, ...], says: str) -> None:
    answer = in_process("hil", *words)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert says in answer.stderr
    assert answer.stderr.count("\n") == 1


def test_a_question_on_the_terminal_is_asked_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("30,5\n3_0\n30.5\n"))
    assert new._asked(PAYLOAD, 30.0) == 30.5
    found = [line for line in capsys.readouterr().err.splitlines() if "found" in line]
    assert [line.partition("found ")[2] for line in found] == [
        "'30,5', expected a number of kg with a decimal point, such as 290.5",
        "'3_0', expected a number of kg such as 290.5",
    ]


def test_the_help_has_the_bounds_of_a_number(in_process: Command) -> None:
    assert "0.1<=x<=480" in "".join(in_process("rigctl", "alarms", "--help").stdout.split())
