"""The commands that move the rig: each prints one line on what happened, or why not.

They are made of the catalogue (`rigctl.model.verbs`): the options of the payload are those of the command line.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from inspect import Parameter, Signature
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from rigctl.cli.lease import give
from rigctl.cli.operator_name import operator_name
from rigctl.cli.options import (
    Connect,
    Json,
    Operator,
    Rig,
    Wait,
    daemon,
    end_with_answer,
    number_argument,
    say,
)
from rigctl.model.verbs import CommandRow, Option, Verb
from rigctl.wire import state_words as figures
from rigctl.wire.typed_values import typed

if TYPE_CHECKING:
    from rigctl.client.connection import Client
    from rigctl.client.shapes import Message
    from rigctl.client.stream import Stream

SILENCE_S = 5.0


def __getattr__(name: str) -> Callable[..., None]:
    """The function of a command, by its name in `rigctl.cli.verb_table`."""
    verb = Verb.__members__.get(name.upper())
    if verb is None or not verb.row.help:
        raise AttributeError(name)
    return of_verb(verb)


def of_verb(verb: Verb) -> Callable[..., None]:
    """The function of a command line, with the options of the verb's row, for `typer`."""
    row = verb.row

    def command(*, json: bool, connect: str | None, rig: str | None, operator: str | None, **given: Any) -> None:
        wait, value = bool(given.pop("wait", False)), given.pop("value", None)
        for option in row.options:
            if option.required and option.kind is bool and not given[option.name]:
                raise typer.BadParameter(row.missing)
        named = {name: found or "" if isinstance(found, str | None) else found for name, found in given.items()}
        give_and_end(verb, json, connect, rig, operator, None if value is None else float(value), wait=wait, **named)

    command.__doc__, command.__name__ = row.help, verb.name.lower()
    parameters = list(_parameters(row))
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    return command


def _parameters(row: CommandRow) -> Iterator[Parameter]:
    for option in row.options:
        yield _parameter(option)
    kinds: list[tuple[str, Any, Any]] = [("wait", Wait, False)] if row.ends else []
    for name, kind, default in (
        *kinds, ("json", Json, False), ("connect", Connect, None), ("rig", Rig, None), ("operator", Operator, None),
    ):  # fmt: skip
        yield Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


def _parameter(option: Option) -> Parameter:
    default: Any
    kind: Any
    if option.noun:
        number = int if option.whole else float
        argument = number_argument(typed(option), option.metavar or option.form, option.help)
        kind, default = Annotated[number if option.required else number | None, argument], None
        default = Parameter.empty if option.required else None
    elif option.choices:
        words = tuple(filter(None, option.choices))
        kind, default = Annotated[Literal[words] | None, typer.Option(f"--{option.name}", help=option.help)], None
    else:
        kind, default = Annotated[bool, typer.Option(f"--{_typed_name(option.name)}", help=option.help)], False
    return Parameter(option.name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


def _typed_name(name: str) -> str:
    return name.replace("_", "-")


def give_and_end(
    verb: Verb,
    json: bool,
    connect: str | None,
    rig: str | None,
    operator: str | None,
    value: float | None = None,
    *,
    wait: bool = False,
    **options: bool | str,
) -> NoReturn:
    """Give a command over the network, print its answer and end; ``wait``: when it is over.

    ``options``: see `rigctl.wire.command_request.Request`.
    """
    with daemon(connect, rig) as client:
        states = client.follow(client.keys.state) if wait else None
        answer = give(client, verb.name.lower(), operator_name(operator), value, **options)
        if bool(answer.get("accepted")) and states is not None:
            if not json:
                say(str(answer["text"]))
            answer = _finish(client, verb, answer, states)
    end_with_answer(answer, json)


def _standing(state: dict[str, Any]) -> str:
    return f"tension {figures.number(state['tension_n'], 1, 'N')}, stroke {figures.number(state['stroke_mm'], 2, 'mm')}"


def _finish(client: Client, verb: Verb, answer: dict[str, Any], states: Stream[Message]) -> dict[str, Any]:
    """Follow the state until the command has ended or failed."""
    goal, passing = (mode.name for mode in verb.row.ends or ())
    newest = time.monotonic()
    while True:
        state = states.read(0.2)
        if state is None:
            if time.monotonic() - newest > SILENCE_S:
                text = f"{verb.name}: no data for {SILENCE_S:.0f} s from {client.endpoint}, outcome unknown"
                return {**answer, "accepted": False, "reason": "no_data", "text": text}
            continue
        newest = time.monotonic()
        mode = state.get("mode")
        if state.get("t_ns", 0) < answer.get("t_ns", 0) or mode in (passing, None):
            continue
        about = {"mode": mode, "value": state["tension_n"]}
        if mode == goal:
            text = f"{verb.name}: {goal}, {_standing(state)}"
            return {**answer, **about, "text": text}
        why = f" {state['fault']}: {state['fault_text']}" if mode == "FAULT" else ""
        text = f"{verb.name} failed: ended in {mode}{why}"
        return {**answer, **about, "accepted": False, "reason": "ended_otherwise", "text": text}
