"""Alarms and the operator's view in words, the same for ``rigctl alarms``, ``status`` and ``watch``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rigctl.config.quantity import count
from rigctl.wire.alarms import Alarm, Priority
from rigctl.wire.operator_view import OperatorView
from rigctl.wire.state_words import clock

STYLE = {Priority.URGENT: "bold red", Priority.HIGH: "bold yellow", Priority.LOW: ""}


def standing(row: Alarm, now_ns: int) -> str:
    """What became of an alarm: stands or over, acknowledged, shelved, chattering."""
    parts = ["stands" if row.stands else "over"]
    if row.acknowledged:
        parts.append("reset" if row.acknowledged == "reset" else f"acknowledged by {row.acknowledged}")
    else:
        parts.append("not acknowledged")
    if row.chatters(now_ns):
        parts.append("chatters")
    if row.shelf is not None and row.shelved(now_ns):
        parts.append(f"shelved until {clock(row.shelf.until_ns)[:-2]} by {row.shelf.operator}: {row.shelf.reason}")
    return ", ".join(parts)


def times(row: Alarm) -> str:
    """When it came, how often, and since when it is there."""
    if row.count == 1:
        return f"since {clock(row.first_ns)}"
    return f"{count(row.count, 'time')}, first {clock(row.first_ns)}, last {clock(row.last_ns)}"


def block(row: Alarm, now_ns: int) -> list[str]:
    """An alarm in full: three lines, the last what to do."""
    head = f"{row.priority.name:<7} {row.cause}  {times(row)}  ({standing(row, now_ns)})"
    return [head, f"        {row.text}", f"        -> {row.remedy}"]


def line(row: Alarm, now_ns: int) -> str:
    """An alarm in one line."""
    return f"{row.priority.name} {row.cause}, {times(row)}, {standing(row, now_ns)}: {row.text}"


def alarm_rows(alarms: Sequence[Alarm], now_ns: int) -> list[tuple[str, str, str]]:
    """Label, words and style of every alarm that is not put aside, and of how many are."""
    rows = [("alarm", line(row, now_ns), STYLE[row.priority]) for row in alarms if not row.shelved(now_ns)]
    shelved = sum(row.shelved(now_ns) for row in alarms)
    return rows + ([("shelved", f"{count(shelved, 'alarm')}: rigctl alarms", "")] if shelved else [])


def banner_rows(state: dict[str, Any], view: OperatorView) -> list[tuple[str, str, str]]:
    """Label, words and style of what the rig does, what blocks a reset, what to do next, and who may walk in."""
    rows = [("does now", view.does, "bold")]
    if state.get("fault"):
        rows.append(("blocks reset", view.blocks, ""))
    if view.next_step:
        rows.append(("next step", view.next_step, "bold" if state.get("fault") else ""))
    return [*rows, ("entry", view.entry, "")]
