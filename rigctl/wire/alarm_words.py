"""Alarms and the operator's view in words, the same for ``rigctl alarms``, ``status`` and ``watch``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rigctl.model.event_row import Priority
from rigctl.model.quantity import count
from rigctl.wire.alarms import NOT_WATCHED, Alarm, follows, is_explained, without_steps
from rigctl.wire.operator_view import OperatorView
from rigctl.wire.state_words import clock

STYLE = {Priority.URGENT: "bold red", Priority.HIGH: "bold yellow", Priority.LOW: ""}


def standing(row: Alarm, now_ns: int) -> str:
    """What became of an alarm: active, latched, cleared or not watched, acknowledged, shelved, chattering."""
    parts = [row.condition]
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


def listed(rows: Sequence[Alarm], state: dict[str, Any], now_ns: int) -> list[str]:
    """All alarms in lines, in their order: under the culprit those that follow from it, the others in full."""
    lines, culprit = [], [f"{label.upper():<7} {words}" for label, words, _ in culprit_rows(state)]
    if not any(follows(row, state) for row in rows):
        lines, culprit = culprit, []
    for row in rows:
        if follows(row, state):
            lines, culprit = [*lines, *culprit, f"        follows: {line(row, now_ns, state)}"], []
        else:
            lines += block(row, now_ns)
    return lines


def line(row: Alarm, now_ns: int, state: dict[str, Any] | None = None) -> str:
    """An alarm in one line; without steps of its own where the culprit of ``state`` explains it."""
    text = without_steps(row.text) if is_explained(row, state) else row.text
    return f"{row.priority.name} {row.cause}, {times(row)}, {standing(row, now_ns)}: {text}"


def tally(alarms: Sequence[Alarm], now_ns: int, barred: int = 0) -> str:
    """How many alarms are in each condition and shelved, in words; the same wherever they are counted.

    ``barred``: checks that bar arming, which are no alarms.
    """
    seen = [row for row in alarms if not row.shelved(now_ns)]
    names = ("active", "latched", NOT_WATCHED, "cleared")
    numbers = {name: sum(row.condition == name for row in seen) for name in names}
    numbers["shelved"] = len(alarms) - len(seen)
    parts = [f"{number} {name}" for name, number in numbers.items() if number]
    if barred:
        parts.append(f"{count(barred, 'check')} bar{'s' if barred == 1 else ''} ARM")
    return ", ".join(parts) or "none"


def alarm_rows(alarms: Sequence[Alarm], now_ns: int, state: dict[str, Any] | None = None) -> list[tuple[str, str, str]]:
    """Label, words and style of every alarm that is not put aside, and of how many are.

    Those that follow from the culprit of ``state`` say so.
    """
    rows = []
    for row in alarms:
        if follows(row, state) and not row.shelved(now_ns):
            rows.append(("follows", line(row, now_ns, state), ""))
        elif not row.shelved(now_ns):
            rows.append(("alarm", line(row, now_ns), STYLE[row.priority] if row.condition != "cleared" else ""))
    shelved = sum(row.shelved(now_ns) for row in alarms)
    return rows + ([("shelved", f"{count(shelved, 'alarm')}: rigctl alarms", "")] if shelved else [])


def in_brief(alarms: Sequence[Alarm], now_ns: int, state: dict[str, Any] | None = None) -> list[str]:
    """The alarms that are not put aside by priority and name; those that follow from the culprit are one, counted."""
    seen = [row for row in alarms if not row.shelved(now_ns)]
    folded = [row for row in seen if follows(row, state)]
    more = f" +{len(folded) - 1} that follow" if folded[1:] else ""
    first = [f"{min(row.priority for row in folded).name} {folded[0].cause}{more}"] if folded else []
    named = []
    for row in seen:
        if not follows(row, state):
            named.append(f"{row.priority.name} {row.cause}")
        elif row is folded[0]:
            named += first
    return named


def culprit_rows(state: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Label, words and style of the part that is to blame, of the question that decides, and of the first step."""
    found = state.get("culprit")
    if not isinstance(found, dict) or not found.get("parts"):
        return []
    rows = [("culprit", f"{' or '.join(map(str, found['parts']))}: {found.get('text', '')}", "bold red")]
    rows += [("decide", str(found["question"]), "bold")] if found.get("question") else []
    return [*rows, ("first", str(found.get("first", "")), "bold")]


def banner_rows(state: dict[str, Any], view: OperatorView) -> list[tuple[str, str, str]]:
    """Label, words and style of what the rig does, what blocks a reset, what to do next, and who may walk in."""
    rows = [("does now", view.does, "bold")]
    if state.get("fault"):
        rows.append(("blocks reset", view.blocks, ""))
    if view.next_step:
        rows.append(("next step", view.next_step, "bold" if state.get("fault") else ""))
    return [*rows, ("entry", f"{view.entry}: {view.entry_why}", "")]
