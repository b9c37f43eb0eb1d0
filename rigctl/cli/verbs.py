"""The commands that move the rig: each prints one line on what happened, or why not."""

from __future__ import annotations

import time
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
from rigctl.wire import state_words as figures
from rigctl.wire.typed_values import LENGTH, MOVE, SECONDS, STROKE, TARGET

if TYPE_CHECKING:
    from rigctl.client.connection import Client
    from rigctl.client.shapes import Message
    from rigctl.client.stream import Stream

SILENCE_S = 5.0


Newtons = Annotated[float, number_argument(TARGET, "NEWTONS", "Vertical tension to hold.")]
MoveNumber = Annotated[int, number_argument(MOVE, "N", "Number of the move, from 1; 0 ends it.")]
Millimetres = Annotated[float, number_argument(STROKE, "MM", "Stroke, as measured at the cylinder.")]
Seconds = Annotated[float, number_argument(SECONDS, "SECONDS", "How long, 1 to 3600 s.")]
NearEnd = Annotated[
    bool, typer.Option("--near-end", help="Arm at an end of the stroke, to drive away from it (tension, release).")
]
Length = Annotated[
    float | None,
    number_argument(
        LENGTH, "MM", "How far a slack rope is paid out, in HOLD, at 2 mm/s; without it the tension is ramped down."
    ),
]
Supported = Annotated[
    bool, typer.Option("--supported", help="Confirm that the payload is supported from below. Required.")
]
By = Annotated[
    Literal["encoder", "cell"] | None,
    typer.Option("--by", help="Go by this alone, where encoder and tension disagree: see at the rig which is right."),
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
    give_and_end("arm", json, connect, rig, operator, near_end=near_end)


def tension(
    wait: Wait = False, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None
) -> None:
    """Ramp to the target and hold it: TENSIONING, then COMPENSATING."""
    give_and_end("tension", json, connect, rig, operator, wait=wait)


def release(
    length: Length = None,
    wait: Wait = False,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Ramp to a slack rope, then HOLD; or pay out MM of a slack rope."""
    give_and_end("release", json, connect, rig, operator, length, wait=wait)


def disarm(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Drive off, brake closed."""
    give_and_end("disarm", json, connect, rig, operator)


def reset(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Acknowledge a fault whose cause is gone."""
    give_and_end("reset", json, connect, rig, operator)


def carry(
    seconds: Seconds,
    by: By = None,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Where the brake does not hold: the motor holds the load for SECONDS, then lowers it."""
    give_and_end("carry", json, connect, rig, operator, seconds, by=by or "")


def lower(
    by: By = None, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None
) -> None:
    """Where the brake does not hold: the motor lowers the load to a slack rope."""
    give_and_end("lower", json, connect, rig, operator, by=by or "")


def brake_test(
    supported: Supported = False,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Where the brake is known not to hold: it has the load for 10 s, then the motor; shows that it holds.

    In HOLD on a tight rope. If the load moves by 0.05 mm the motor takes it back.
    """
    if not supported:
        raise typer.BadParameter("support the payload from below first, the brake may let it go; then give --supported")
    give_and_end("brake_test", json, connect, rig, operator, supported=True)


def target(
    newtons: Newtons, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None
) -> None:
    """Set the vertical tension to hold."""
    give_and_end("target", json, connect, rig, operator, newtons)


def confirm_stroke(
    millimetres: Millimetres,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Confirm the stroke after the drive's position was lost or differs from the last one known."""
    give_and_end("confirm_stroke", json, connect, rig, operator, millimetres)


def move(
    number: MoveNumber, json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None
) -> None:
    """A move of the mechanism begins now: play what was learnt from it, and learn from it; 0: it has ended."""
    give_and_end("move", json, connect, rig, operator, float(number))


def give_and_end(
    verb: str,
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
        answer = give(client, verb, operator_name(operator), value, **options)
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
