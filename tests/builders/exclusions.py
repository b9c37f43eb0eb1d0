"""The table of exclusions: statements that may not be made together about one state, on any display."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from typing import Any

from rigctl.cli.status import rows
from rigctl.cli.watch_screen import Screen
from rigctl.client.rig_view import RigView
from rigctl.page.panel import state_message
from rigctl.page.picture import Picture

_DRIVE_SILENT = r"nothing valid is heard of the drive"
_UNTRUSTED_FORCE = r"^doubt tension:|^tension cell .*(stale|invalid)"
EXCLUSIONS: tuple[tuple[str, str], ...] = (
    (_DRIVE_SILENT, r"held by the (motor|brake)|^brake (open|closed|closing)|^drive (on|off)\b|holds the stroke:"),
    (_DRIVE_SILENT, r"LOCK OUT FIRST|nothing is driven|^motor current [\d.-]+ A"),
    (_DRIVE_SILENT, r"^stroke +[\d.+-]+ mm|^E-stop, drive's input released"),
    (
        r"^alarm high active BUS_SILENT|^active BUS_SILENT",
        r"\b0 error frames|^brake (open|closed)|^mode: since .*data 0\.",
    ),
    (_UNTRUSTED_FORCE, r"^(tension|vertical) +[\d.-]+ N|rope slack|^vertical error .*[\d.]+ N|carry [\d.]+ N"),
    (r"^mode FAULT", r"^tally none|^alarms none|^bar tension$|^bar arm$|^blocks$"),
    (r"^mode FAULT", r"not needed|keeps the tension|ramps the tension"),
    (r"RESET is accepted", r"^alarm (urgent|high) active|is active and may trip|blocked by"),
    (r"RESET is accepted", r"^bar barred reset|still stopping"),
    (r"^alarm high active E_STOP$|^fault E_STOP", r"^E-stop, drive's input released"),
    (r"holds by itself", r"nothing is driven|drive is off"),
    (r"LOCK OUT FIRST", r"(BRAKE_SLIPS|STROKE_MOVES|LOAD_SINKS)(?!.*cleared)"),
    (r"LOCK OUT FIRST", r"^drive (on|not known|not off|stopping)|held by the motor"),
    (r"LOCK OUT FIRST", r"UNCONFIRMED|which SLIPS|not yet confirmed"),
    (r"drive is on, the stroke may move", r"^drive off|^does .*drive is off"),
    (r"^tally none", r"^barred [1-9]"),
    (r"^step ARM\.$", r"^bar barred arm|^barred [1-9]"),
    (r"^step RESET\.$", r"^bar barred reset|is active and may trip"),
    (r"on the way to", r"^error [+-]"),
    (r"loop writes no records", r"^stroke +[\d.+-]+ mm|held by the|^drive (on|off)\b|LOCK OUT FIRST"),
    (r"\bstands\b|\bover,|standing", r""),
)
"""Pairs of patterns: where a line matches the first, no line may match the second. The last: words of no vocabulary."""


def contradictions(lines: Sequence[str]) -> list[str]:
    """The exclusions that statements break, each with the lines that do."""
    found = []
    for first, second in EXCLUSIONS:
        ones = [line for line in lines if re.search(first, line)]
        others = [line for line in lines if re.search(second, line)] if ones else []
        if ones and others:
            found.append(f"{ones[0]!r} with {others[0]!r}")
    return found


def said_by_page(picture: Picture) -> list[str]:
    """What the page states, one line each."""
    message = state_message(picture, holds_lease=True)
    lines = [f"mode {message.get('mode')}", f"tally {message['tally']}"]
    lines += [f"alarm {row['priority']} {row['condition']} {row['cause']}" for row in message["alarms"]]
    told = message["answers"]
    lines += [f"cause {' / '.join(told['parts'])}", f"text {told['text']}", f"does {told['does']}"]
    lines += [f"blocks {told['blocks']}".rstrip(), f"entry {told['entry']}: {told['entry_why']}"]
    lines += [f"step {step['text']}" for step in told["steps"]]
    if "values" not in message:
        return lines
    doubts: dict[str, str] = message["doubts"]
    lines += [f"doubt {device}: {why}" for device, why in doubts.items()]
    lines += [f"bar barred {verb}" if why else f"bar {verb}" for verb, why in message["verbs"].items()]
    lines += [f"{row['name']} {row['text']}" for row in message["devices"]]
    lines += [f"barred {message['barred']}"]
    for label, name, device, unit in (
        ("vertical", "vertical_n", "tension", "N"),
        ("stroke", "stroke_mm", "drive", "mm"),
    ):
        if device not in doubts and message["mode"] != "LOOP STOPPED":
            lines.append(f"{label} {message['values'][name]} {unit}")
    if message["ramping"]:
        lines.append("error on the way to the target")
    elif message["values"]["error_n"] is not None and "tension" not in doubts:
        lines.append(f"error {message['values']['error_n']:+.2f} N")
    return lines


def said_by_status(picture: Picture, lock_out: str) -> list[str]:
    """What ``rigctl status`` prints, one line each."""
    assert picture.state is not None
    state: dict[str, Any] = picture.state
    now_ns = time.time_ns()
    return [f"{label} {words.strip()}" for label, words, _ in
            rows(state, picture.alarms.rows(state, now_ns), now_ns, lock_out)]  # fmt: skip


def said_by_watch(view: RigView) -> list[str]:
    """What ``rigctl watch`` shows, one line each, without the history of events."""
    lines = [line.plain.strip() for line in Screen(view).lines(400, 200)]
    return lines[: lines.index("events")] if "events" in lines else lines
