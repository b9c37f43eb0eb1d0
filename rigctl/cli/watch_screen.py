"""The watch screen: the most important values come first and largest, readable from a distance."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from rigctl.cli.unanswered import rows
from rigctl.client.unanswered import unanswered_here
from rigctl.model.quantity import count, significant
from rigctl.wire import state_words as figures
from rigctl.wire.alarm_words import alarm_rows, banner_rows, culprit_rows
from rigctl.wire.operator_view import view as operator_view
from rigctl.wire.trust import trusted

if TYPE_CHECKING:
    from rigctl.client.rig_view import RigView

SPAN_PCT = 10.0  # span of the bar on either side of the target
NARROW = 72
"""Columns below which a line is wrapped below its label, else beside it; no word is cut off."""
_LABEL = 14
_INDENT = 2
_SEVERITY = {"error": "bold red", "warning": "yellow", "info": ""}


def scale(width: int, value: float | None, low: float, high: float, marks: dict[float, str]) -> str:
    """A ruler of ``width`` from ``low`` to ``high`` with ``marks`` and the value as a block; an arrow outside."""
    cells = ["─"] * width

    def cell(x: float) -> int:
        return round((x - low) / (high - low) * (width - 1)) if high > low else 0

    for x, mark in marks.items():
        if low <= x <= high:
            cells[cell(x)] = mark
    if value is None or not math.isfinite(value):
        return "".join(cells)
    if value < low:
        cells[0] = "◀"
    elif value > high:
        cells[-1] = "▶"
    else:
        cells[cell(value)] = "█"
    return "".join(cells)


def _row(label: str, value: str | Text, style: str = "") -> Text:
    return Text.assemble((f"{label:<{_LABEL}}", "dim"), value if isinstance(value, Text) else (value, style))


def tension_bar(state: dict[str, Any], width: int) -> list[Text]:
    """Vertical tension against the target and its band."""
    value, target = trusted(state, "vertical_n"), state["target_n"] or 0.0
    low, high = target * (1 - SPAN_PCT / 100), target * (1 + SPAN_PCT / 100)
    band = (target * (1 - figures.BAND_PCT / 100), target * (1 + figures.BAND_PCT / 100))
    inside = value is not None and band[0] <= value <= band[1]
    active = state["mode"] in ("TENSIONING", "COMPENSATING")
    colour = "green" if inside else "red" if state["mode"] == "COMPENSATING" else "yellow" if active else "dim"
    bar = scale(width, value, low, high, {band[0]: "[", target: "┼", band[1]: "]"})
    legend = f"{low:z.0f}".ljust(width // 2 - 8) + f"target {target:z.1f} N".center(16)
    return [
        _row("vertical", f"{figures.number(value, 2, 'N'):>10}  {figures.error(state)}", f"bold {colour}".strip()),
        _row("", bar, colour),
        _row("", legend + f"{high:z.0f}".rjust(width - len(legend)), "dim"),
    ]


def stroke_bar(state: dict[str, Any], limits: dict[str, Any], width: int) -> list[Text]:
    """Stroke within its limits."""
    stroke, low, high = trusted(state, "stroke_mm"), limits.get("stroke_min_mm"), limits.get("stroke_max_mm")
    speed = figures.measured(state, "speed_mm_s")
    first = _row("stroke", f"{figures.number(stroke, 2, 'mm'):>10}  {speed}")
    if low is None or high is None:
        return [first]
    text = f"{significant(low)} ", f" {significant(high, 'mm')}"
    near = stroke is not None and not low + 0.05 * (high - low) <= stroke <= high - 0.05 * (high - low)
    bar = scale(width - len(text[0]) - len(text[1]), stroke, low, high, {low: "├", high: "┤"})
    return [first, _row("", text[0] + bar + text[1], "yellow" if near else "")]


def fitted(text: Text, width: int) -> list[Text]:
    """A line, wrapped with indentation where it is longer than the terminal is wide."""
    if text.cell_len <= width:
        return [text]
    indent = _INDENT if width < NARROW else _LABEL
    first, *rest = text.wrap(Console(width=width), width - indent)
    return [first, *(Text.assemble(" " * indent, more) for more in rest)]


def words(label: str, value: str, style: str, width: int) -> list[Text]:
    """A row of words, each step on a line of its own, wrapped in their column; on a narrow terminal below its label."""
    if width < NARROW:
        return fitted(_row(label, value, style), width)
    first, *rest = Text(value.replace("  ", "\n"), style).wrap(Console(width=width), width - _LABEL)
    return [_row(label, first), *(_row("", more) for more in rest)]


class Screen:
    """A view as a full screen, whatever its size."""

    def __init__(self, view: RigView) -> None:
        self._view = view

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width, height = options.max_width, options.height or console.height
        lines = self.lines(width, height)
        for number, text in enumerate(lines[:height]):
            text.truncate(width, overflow="ellipsis")
            yield Text.assemble(text, end="" if number == min(len(lines), height) - 1 else "\n")

    def lines(self, width: int, height: int) -> list[Text]:
        """The screen's lines from top to bottom; events fill the rest."""
        view, state = self._view, self._view.state
        head, more = [self._title(width)], list[tuple[str, str, str]]()
        if view.is_silent or state is None:
            head += self._banner(f"NO DATA FOR {view.silent_s:.0f} s", "bold white on red", width)
            said = rows(found) if (found := unanswered_here(view.endpoint, view.rig)) is not None else []
            said.append(("", f"reconnecting to {view.endpoint}; the values below are the last ones, old", "bold red"))
        else:
            head += self._banner(" ".join(figures.mode(state)), figures.mode_style(state), width)
            said, more = self._said(state)
        more += [("warning", text, "yellow") for text in (state or {}).get("warnings", [])]
        more += [("warning", view.refused, "yellow")] if view.refused else []
        load, values = [], list[Text]()
        if state is not None and state.get("mode") is not None:
            room = width - _LABEL
            load = [*tension_bar(state, room), *stroke_bar(state, view.settings.get("cylinder") or {}, room)]
            values = self._values(state)
        lines = [
            *(part for text in head for part in fitted(text, width)),
            *(part for row in said for part in words(*row, width)),
            *(part for text in load for part in fitted(text, width)),
            *(part for row in more for part in words(*row, width)),
            *(part for text in values for part in fitted(text, width)),
        ]  # fmt: skip
        return lines + self._events(width, max(0, height - len(lines)))

    def _said(self, state: dict[str, Any]) -> tuple[list[tuple[str, str, str]], list[tuple[str, str, str]]]:
        """Label, words and style of what is wrong and what to do, and of every cause and alarm in detail."""
        view, now_ns = self._view, time.time_ns()
        lock_out = str((view.settings.get("safety") or {}).get("lock_out") or "")
        with view.lock:
            alarms = view.alarms.rows(state, now_ns)
        why, origin = figures.why(state), view.origin.now
        said = [*culprit_rows(state), ("why", why, "bold red")] if why else culprit_rows(state)
        more = [("active", text, "bold red") for text in figures.causes(state) if not text.startswith(f"{why}, since")]
        if began := figures.began(origin):
            more.append(("in this mode", began, ""))
        return said + banner_rows(state, operator_view(state, alarms, lock_out)), more + alarm_rows(
            alarms, now_ns, state
        )

    def _title(self, width: int) -> Text:
        left = f"{self._view.rig}  {self._view.endpoint}"
        right = time.strftime("%Y-%m-%d %H:%M:%S") + "  Ctrl-C ends"
        return Text(left + right.rjust(max(len(right) + 2, width - len(left))), "dim")

    @staticmethod
    def _banner(text: str, style: str, width: int) -> list[Text]:
        blank = " " * width
        return [Text(blank, style), Text(text.center(width), style), Text(blank, style)]

    def _values(self, state: dict[str, Any]) -> list[Text]:
        skipped = f"{state['skipped']} of {count(state['tick'], 'tick')}"
        slope = state["quality"]["inclination"]
        return [
            _row(*line) for line in figures.in_order(
                *figures.lines(state, "watch"),
                figures.DisplayLine(10, "inclination", figures.inclination(state), "" if slope == "good" else "yellow"),
                figures.DisplayLine(20, "signals", figures.flaws(state), "bold yellow"),
                figures.DisplayLine(30, "lateness", figures.percentiles(state["lateness_us"])),
                figures.DisplayLine(40, "work", figures.percentiles(state["work_us"])),
                figures.DisplayLine(50, "skipped", skipped, "bold yellow" if state["skipped"] else ""),
                figures.DisplayLine(60, "bus", figures.counters(state)),
                figures.DisplayLine(70, "flags", figures.flags(state), "yellow"),
                figures.DisplayLine(80, "limits", "; ".join(self._view.limits.now), "yellow"),
                *(figures.DisplayLine(90, "before arming", text, style) for text, style in figures.checks(state)),
                figures.DisplayLine(100, "calibration", *figures.calibration(state)),
                figures.DisplayLine(110, "recorder", *figures.recorder(state)),
                figures.DisplayLine(120, "lease", figures.lease(state)),
            )
        ]  # fmt: skip

    def _events(self, width: int, room: int) -> list[Text]:
        if room <= 1:
            return []
        lines = [
            Text(f"{figures.clock(event['wall_ns'])}  {event['text']}", _SEVERITY.get(event["severity"], ""))
            for event in list(self._view.events)[-(room - 1) :]
        ]
        parts = [part for line in lines for part in fitted(line, width)]
        return [Text("events", "dim"), *parts[-(room - 1) :]]
