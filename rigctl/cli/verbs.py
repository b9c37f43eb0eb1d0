"""The commands that move the rig: each prints one line on what happened, or why not."""

from __future__ import annotations

import contextlib
import os
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.lease import give
from rigctl.cli.options import (
    Connect,
    Json,
    Operator,
    Rig,
    Wait,
    daemon,
    end_with_answer,
    finite_number,
    operator_name,
    say,
)
from rigctl.wire import state_words as figures

if TYPE_CHECKING:
    from rigctl.client.connection import Client
    from rigctl.client.shapes import Message
    from rigctl.client.stream import Stream

SILENCE_S = 5.0


Newtons = Annotated[
    float, typer.Argument(metavar="NEWTONS", parser=finite_number("newtons"), help="Vertical tension to hold.")
]


MoveNumber = Annotated[int, typer.Argument(metavar="N", min=0, help="Number of the move, from 1; 0 ends it.")]
Millimetres = Annotated[
    float,
    typer.Argument(metavar="MM", parser=finite_number("millimetres"), help="Stroke, as measured at the cylinder."),
]
NearEnd = Annotated[
    bool, typer.Option("--near-end", help="Arm at an end of the stroke, to drive away from it (tension, release).")
]

# Mode in which a command ends, and the mode it passes through.
_ENDS = {"tension": ("COMPENSATING", "TENSIONING"), "release": ("HOLD", "RELEASING")}


def arm(
    near_end: NearEnd = False,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Drive on, brake open, stroke held: DISARMED to HOLD. Refused with everything that stands against it."""
    _give("arm", json, connect, rig, operator, near_end=near_end)


def tension(
    wait: Wait = False, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None
) -> None:
    """Ramp to the target and hold it: TENSIONING, then COMPENSATING."""
    _give("tension", json, connect, rig, operator, wait=wait)


def release(
    wait: Wait = False, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None
) -> None:
    """Ramp to a slack rope, then HOLD."""
    _give("release", json, connect, rig, operator, wait=wait)


def hold(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Stop and hold the stroke where it is. Anyone may, always: it needs no lease and takes none.

    To a daemon of this computer and user it goes past the network, on a socket of its own (FOLDER/hold.sock in memory),
    and works while the gateway is flooded, hangs or is gone; to any other as every command.
    """
    from rigctl.client import local_hold
    from rigctl.client.connection import ChoiceError, endpoint_of

    answer = None
    with contextlib.suppress(ChoiceError):  # `_give` below reports it
        named = rig or os.environ.get("RIGCTL_RIG") or None
        answer = local_hold.hold(endpoint_of(connect), named, operator_name(operator))
    if answer is None:
        _give("hold", json, connect, rig, operator)
    else:
        end_with_answer(answer, json)


def disarm(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Drive off, brake closed."""
    _give("disarm", json, connect, rig, operator)


def reset(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Acknowledge a fault whose cause is gone."""
    _give("reset", json, connect, rig, operator)


def target(
    newtons: Newtons, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None
) -> None:
    """Set the vertical tension to hold."""
    _give("target", json, connect, rig, operator, newtons)


def confirm_stroke(
    millimetres: Millimetres,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Confirm the stroke after the drive's position was lost or differs from the last one known."""
    _give("confirm_stroke", json, connect, rig, operator, millimetres)


def move(
    number: MoveNumber, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None
) -> None:
    """A move of the mechanism begins now: play what was learnt from it, and learn from it; 0: it has ended."""
    _give("move", json, connect, rig, operator, float(number))


def _give(
    verb: str,
    json: bool,
    connect: str | None,
    rig: str | None,
    operator: str | None,
    value: float | None = None,
    *,
    wait: bool = False,
    near_end: bool = False,
) -> None:
    with daemon(connect, rig) as client:
        states = client.follow(client.keys.state) if wait else None
        answer = give(client, verb, operator_name(operator), value, near_end=near_end)
        if bool(answer.get("accepted")) and states is not None:
            if not json:
                say(str(answer["text"]))
            answer = _finish(client, verb, answer, states)
    end_with_answer(answer, json)


def _standing(state: dict[str, Any]) -> str:
    return f"tension {figures.number(state['tension_n'], 1, 'N')}, stroke {figures.number(state['stroke_mm'], 2, 'mm')}"


def _finish(client: Client, verb: str, answer: dict[str, Any], states: Stream[Message]) -> dict[str, Any]:
    """Follow the state until the command has ended or failed."""
    goal, passing = _ENDS[verb]
    newest = time.monotonic()
    while True:
        state = states.read(0.2)
        if state is None:
            if time.monotonic() - newest > SILENCE_S:
                text = f"{verb.upper()}: no data for {SILENCE_S:.0f} s from {client.endpoint}, outcome unknown"
                return {**answer, "accepted": False, "reason": "no_data", "text": text}
            continue
        newest = time.monotonic()
        mode = state.get("mode")
        if state.get("t_ns", 0) < answer.get("t_ns", 0) or mode in (passing, None):
            continue
        about = {"mode": mode, "value": state["tension_n"]}
        if mode == goal:
            text = f"{verb.upper()}: {goal}, {_standing(state)}"
            return {**answer, **about, "text": text}
        why = f" {state['fault']}: {state['fault_text']}" if mode == "FAULT" else ""
        text = f"{verb.upper()} failed: ended in {mode}{why}"
        return {**answer, **about, "accepted": False, "reason": "ended_otherwise", "text": text}
