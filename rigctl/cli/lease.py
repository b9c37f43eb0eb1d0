"""``rigctl lease``, and the use of the operator's lease by every command of the command line."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rigctl.cli.lease_file import LeaseFile
from rigctl.cli.operator_name import operator_name
from rigctl.cli.options import (
    DONE,
    USAGE,
    Connect,
    Json,
    Operator,
    Rig,
    daemon,
    end,
    end_with_answer,
    say,
    say_json,
)
from rigctl.model.lease_acts import Denial
from rigctl.wire import state_words as figures

if TYPE_CHECKING:
    from rigctl.client.connection import Client


class LeaseTask(Enum):
    """Actions on the lease."""

    SHOW = "show"
    TAKE = "take"
    RETURN = "return"


What = Annotated[LeaseTask, typer.Argument(metavar="show|take|return", help="What to do about it.")]
Reason = Annotated[str | None, typer.Option(metavar="TEXT", help="Why it is taken over from who holds it; on record.")]


def lease(
    act: What = LeaseTask.SHOW,
    reason: Reason = None,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Show who may command the rig; take that over, or give it back.

    One operator commands at a time. The first command that is accepted takes the lease, every further one renews it for
    telemetry.lease_s; meanwhile others are refused. Taking it from who holds it needs --reason. A lapse, a takeover or
    a terminal that dies never moves the rig. HOLD is accepted from anyone, always; watching needs no lease.
    """
    if reason is not None and act is not LeaseTask.TAKE:
        end(USAGE, "found --reason, expected with take alone")
    with daemon(connect, rig) as client:
        if act is LeaseTask.SHOW:
            state = client.state()
            if json:
                say_json(state.get("lease"))
            else:
                say(f"lease: {figures.lease(state)}")
            end(DONE)
        why = (reason or "").encode(errors="replace").decode()
        answer = _ask(client, act, operator_name(operator), why)
    end_with_answer(answer, json)


def _ask(client: Client, act: LeaseTask, operator: str, reason: str) -> dict[str, Any]:
    operator = client.operator(operator)
    kept = _show(client, operator)
    if act is LeaseTask.TAKE:
        answer = client.take_lease(operator, reason)
        _keep(client, operator, kept)
    else:
        answer = client.return_lease(operator)
        if answer.get("accepted"):
            kept.forget()
    return answer


def give(
    client: Client, verb: str, operator: str, value: float | None = None, **options: bool | str | float
) -> dict[str, Any]:
    """Give a command under the lease that this operator's terminals on this machine share; returns the answer.

    A free lease is taken and its id stored before the command is given, so that the next terminal can use it if this
    one dies. A lapsed lease is taken again, since a person who types a command watches the rig.
    """
    operator = client.operator(operator)
    kept = _show(client, operator)
    if verb != "hold" and operator not in client.leases:
        _take(client, operator, kept)
    answer = client.command(verb, operator, value, **options)
    if answer.get("reason") == Denial.LAPSED.value:
        del client.leases[operator]
        _take(client, operator, kept)
        answer = client.command(verb, operator, value, **options)
    _keep(client, operator, kept)
    return answer


def _take(client: Client, operator: str, kept: LeaseFile) -> None:
    """Take the lease if nobody holds it; if another terminal of this operator just took it, use that one's id."""
    if client.take_lease(operator).get("accepted"):
        _keep(client, operator, kept)
    elif (id_ := kept.read()) is not None:
        client.leases[operator] = id_


def _show(client: Client, operator: str) -> LeaseFile:
    kept = LeaseFile(client.rig, client.endpoint, operator)
    if (id_ := kept.read()) is not None:
        client.leases[operator] = id_
    return kept


def _keep(client: Client, operator: str, kept: LeaseFile) -> None:
    if (id_ := client.leases.get(operator)) is not None and id_ != kept.read():
        kept.write(id_)
