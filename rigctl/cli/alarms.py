"""``rigctl alarms``: one row for each cause, the first to look at first, and what an operator decides about it."""

from __future__ import annotations

import time
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from rigctl.cli.completion import causes
from rigctl.cli.operator_name import operator_name
from rigctl.cli.options import (
    BAD,
    DONE,
    USAGE,
    Connect,
    Json,
    Operator,
    Rig,
    daemon,
    end,
    end_with_answer,
    number_option,
    say,
    say_json,
)
from rigctl.wire.typed_values import SHELF_MINUTES, shelf_s

if TYPE_CHECKING:
    from rigctl.client.connection import Client
    from rigctl.wire.alarms import Alarm


class AlarmTask(Enum):
    """What to do about alarms."""

    SHOW = "show"
    ACKNOWLEDGE = "acknowledge"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"


What = Annotated[AlarmTask, typer.Argument(metavar="show|acknowledge|shelve|unshelve", help="What to do.")]
Cause = Annotated[
    str | None, typer.Argument(metavar="[CAUSE]", help="Which alarm, as the list names it.", autocompletion=causes)
]
All = Annotated[bool, typer.Option("--all", help="acknowledge: every alarm that is not acknowledged.")]
Reason = Annotated[str | None, typer.Option(metavar="TEXT", help="shelve: why; on record.")]
Minutes = Annotated[float | None, number_option(SHELF_MINUTES, "--for", metavar="MINUTES", help="shelve: how long.")]


def alarms(
    act: What = AlarmTask.SHOW,
    cause: Cause = None,
    all_: All = False,
    reason: Reason = None,
    minutes: Minutes = None,
    json: Json = False,
    connect: Connect = None,
    rig: Rig = None,
    operator: Operator = None,
) -> None:
    """Show the alarms, acknowledge one or all, or shelve one; every display of the rig follows.

    One row for each cause: priority, how often, since when, and what to do. The exit code is 1 while one of them is
    active and not shelved. A shelved alarm comes back when its time is over. None of this moves the rig or takes the
    lease.
    """
    if all_ and act is not AlarmTask.ACKNOWLEDGE:
        end(USAGE, f"found --all, expected acknowledge with it, not {act.value}")
    if all_ and cause is not None:
        end(USAGE, f"found the cause {cause!r} and --all, expected one of them")
    if act is AlarmTask.ACKNOWLEDGE and cause is None and not all_:
        end(USAGE, "found no cause, expected acknowledge CAUSE or acknowledge --all")
    if not all_ and (cause is None) != (act is AlarmTask.SHOW):
        end(USAGE, "found a cause, expected none with show" if cause else f"found no cause, expected {act.value} CAUSE")
    if (act is AlarmTask.SHELVE) != (reason is not None and minutes is not None):
        end(USAGE, "expected --reason TEXT and --for MINUTES with shelve, and neither with anything else")
    with daemon(connect, rig) as client:
        rows, state, now_ns = _rows(client)
        if all_:
            answers = _acknowledge_all(client, rows, operator_name(operator))
        elif act is not AlarmTask.SHOW:
            from rigctl.wire.alarms import AlarmAct

            if cause not in {row.cause for row in rows}:
                known = ", ".join(row.cause for row in rows) or "there are no alarms"
                end(USAGE, f"found the cause {cause!r}, expected one of: {known}")
            answer = client.decide_alarm(
                AlarmAct(f"alarm_{act.value}"), operator_name(operator), str(cause), (reason or "").strip(),
                shelf_s(minutes) if minutes is not None else 0,
            )  # fmt: skip
    if all_:
        _end_with_answers(answers, json)
    if act is not AlarmTask.SHOW:
        end_with_answer(answer, json)
    _show(rows, state, now_ns, json)


def _acknowledge_all(client: Client, rows: list[Alarm], operator: str) -> list[dict[str, Any]]:
    """The answers, one for each alarm that is not acknowledged, until one is refused."""
    from rigctl.wire.alarms import AlarmAct

    answers: list[dict[str, Any]] = []
    for row in rows:
        if not row.acknowledged and all(answer["accepted"] for answer in answers[-1:]):
            answers.append(client.decide_alarm(AlarmAct.ACKNOWLEDGE, operator, row.cause))
    return answers


def _end_with_answers(answers: list[dict[str, Any]], json: bool) -> NoReturn:
    """Print what was acknowledged, and why the rest was not."""
    if json:
        say_json(answers)
    for answer in [] if json else answers:
        if answer["accepted"]:
            say(str(answer["text"]))
    if answers and not answers[-1]["accepted"]:
        end(BAD, None if json else str(answers[-1]["text"]))
    if not (answers or json):
        say("every alarm is acknowledged")
    end(DONE)


def _rows(client: Client) -> tuple[list[Alarm], dict[str, Any], int]:
    """The open rows, the state and the wall clock they are of."""
    from rigctl.wire.alarms import Alarms

    known, state = Alarms(client.past_events()), client.state()
    return known.rows(state, now_ns := time.time_ns()), state, now_ns


def _show(rows: list[Alarm], state: dict[str, Any], now_ns: int, json: bool) -> None:
    from rigctl.wire.alarm_words import listed
    from rigctl.wire.alarms import as_message

    if json:
        say_json([as_message(row, now_ns, state) for row in rows])
    else:
        for line in listed(rows, state, now_ns):
            say(line)
        if not rows:
            say("no alarms")
    end(BAD if any(row.stands and not row.shelved(now_ns) for row in rows) else DONE)
