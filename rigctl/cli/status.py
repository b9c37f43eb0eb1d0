"""``rigctl status``: what an operator needs first in a few lines, or all of the state."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from rigctl.cli.label_grid import grid
from rigctl.cli.options import BAD, DONE, Connect, Json, Rig, daemon, end, say, say_json
from rigctl.model.quantity import count
from rigctl.wire import state_words as figures

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from rigctl.wire.alarms import Alarm

LINES = 8
"""Of the terminal, at most, below the head (rig, mode, who began it, load), on 80 columns or more."""

All = Annotated[bool, typer.Option("--all", help="Show every cause, alarm, value and warning.")]


def status(all_: All = False, json: Json = False, connect: Connect = None, rig: Rig = None) -> None:
    """Show mode, what holds the load, what is wrong, what to do next, alarms and tension.

    At most eight lines below rig, mode and load; the last one says how many more --all shows. Where no daemon answers,
    at most eight lines say why, and what this computer shows of the rig without the gateway.
    """
    from rigctl.wire.alarms import Alarms
    from rigctl.wire.mode_origin import ModeOrigin

    def otherwise(endpoint: str, error: Exception) -> NoReturn:
        from rigctl.cli.unanswered import end_unanswered

        end_unanswered(endpoint, rig, error, json=json)

    with daemon(connect, rig, otherwise) as client:
        events = client.past_events() if not json else []
        state = client.state()
        active = client.active() if not json else {}
        endpoint = client.endpoint
    if json:
        say_json(state)
    else:
        lock_out = str(((active.get("settings") or {}).get("safety") or {}).get("lock_out") or "")
        now_ns, origin = time.time_ns(), ModeOrigin()
        for event in events:
            origin.note(event)
        alarms = Alarms(events).rows(state, now_ns)
        _show(state, endpoint, alarms, now_ns, lock_out, all_=all_, began=figures.began(origin.now))
    end(DONE if state["loop_alive"] else BAD)


def rows(
    state: dict[str, Any], alarms: Sequence[Alarm] = (), now_ns: int = 0, lock_out: str = ""
) -> list[tuple[str, str, str]]:
    """Label, value and style, line by line. ``alarms``: their rows at ``now_ns`` (wall clock)."""
    from rigctl.wire.alarm_words import alarm_rows, banner_rows, culprit_rows
    from rigctl.wire.operator_view import view

    why = figures.why(state)
    result = [("mode", f" {figures.mode(state)} ", figures.mode_style(state))]
    result += culprit_rows(state)
    if why:
        result.append(("fault" if state.get("fault") else "loop", why, "bold red"))
    result += [("active", words, "bold red") for words in figures.causes(state)]
    if why and state.get("fault") and state.get("trip_dump"):
        result.append(("trip dump", state["trip_dump"], ""))
    result += banner_rows(state, view(state, alarms, lock_out)) + alarm_rows(alarms, now_ns, state)
    result += [("e-stop", words, "bold red") for words in figures.e_stop(state)]
    if state.get("mode") is not None:
        skipped = f"{state['skipped']} of {count(state['tick'], 'tick')}"
        result += figures.in_order(
            *figures.lines(state, "status"),
            figures.DisplayLine(20, "vertical error", figures.error(state), "bold"),
            figures.DisplayLine(50, "inclination", figures.inclination(state)),
            figures.DisplayLine(60, "drive", figures.drive_with_state(state)),
            figures.DisplayLine(90, "calibration", *figures.calibration(state)),
            figures.DisplayLine(100, "signals", figures.flaws(state), "bold yellow"),
            figures.DisplayLine(110, "lateness", figures.percentiles(state["lateness_us"])),
            figures.DisplayLine(120, "work", figures.percentiles(state["work_us"])),
            figures.DisplayLine(130, "skipped", skipped, "bold yellow" if state["skipped"] else ""),
            figures.DisplayLine(140, "bus", figures.counters(state)),
            figures.DisplayLine(150, "age", figures.number(state["age_ms"], 1, "ms")),
            figures.DisplayLine(160, "design", state.get("design") or ""),
            figures.DisplayLine(170, "margins", figures.margins(state)),
        )
    result.append(("lease", figures.lease(state), ""))
    return result + [("warning", text, "yellow") for text in state["warnings"]]


def brief_rows(
    state: dict[str, Any], alarms: Sequence[Alarm], now_ns: int, lock_out: str, height: Callable[[str], int]
) -> list[tuple[str, str, str]]:
    """What an operator needs first: what is wrong, the part to blame, what to do, alarms; values in the room left.

    ``height``: lines of the terminal that a text takes. Together they are less than ``LINES``, so that one is left.
    """
    from rigctl.wire.alarm_words import STYLE, in_brief
    from rigctl.wire.operator_view import view

    seen, fault = view(state, alarms, lock_out), state.get("fault")
    alive, parts = bool(state.get("loop_alive")), (state.get("culprit") or {}).get("parts")
    wrong = f"{fault}: {state.get('fault_text')}" if fault and alive else figures.why(state)
    shown = [("fault" if fault and alive else "loop", wrong, "bold red")] if wrong else []
    shown += [("culprit", " or ".join(map(str, parts)), "bold red")] if parts else []
    in_force = []
    if named := in_brief(alarms, now_ns, state):
        in_force = [("alarms", _fitting(named, ", ", height, 1), STYLE[min(row.priority for row in alarms)])]
    room = LINES - 1 - sum(height(text) for _, text, _ in shown + in_force)
    step = _fitting(seen.numbered, "  ", height, room)
    room -= height(step)
    shown += [("next step", step, "bold" if wrong else ""), *in_force]
    for row in _values(state):
        if (lines := height(row[1])) <= room:
            shown.append(row)
            room -= lines
    return shown


def _fitting(parts: Sequence[str], mark: str, height: Callable[[str], int], room: int) -> str:
    """As many parts as fit into ``room`` lines, but one, and how many more there are."""
    for shown in range(len(parts), 0, -1):
        more = f"{mark}and {len(parts) - shown} more" if shown < len(parts) else ""
        text = mark.join(parts[:shown]) + more
        if height(text) <= room:
            break
    return text


def _values(state: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Values to be trusted, warnings and the lease, the most important first."""
    from rigctl.wire.trust import trusted

    if state.get("mode") is not None and trusted(state, "tension_n") is not None:
        yield "tension", f"{figures.measured(state, 'tension_n')} (target {figures.worded(state, 'target_n')})", ""
        if state.get("error_n") is not None:
            yield "error", figures.error(state), ""
    if state.get("mode") is not None and trusted(state, "stroke_mm") is not None:
        yield "stroke", figures.measured(state, "stroke_mm"), ""
    yield from (("warning", text, "yellow") for text in state["warnings"])
    yield "lease", figures.lease(state), ""


def _show(
    state: dict[str, Any], endpoint: str, alarms: Sequence[Alarm], now_ns: int, lock_out: str, *, all_: bool,
    began: str = "",
) -> None:  # fmt: skip
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False)
    whole = grid([("rig", Text(f"{state['rig']} at {endpoint}"))])
    for label, value, style in rows(state, alarms, now_ns, lock_out):
        whole.add_row(label, Text(value, style))
        if label == "mode" and began:
            whole.add_row("", Text(began))
    if all_:
        console.print(whole)
        return
    brief = _brief(state, endpoint, alarms, now_ns, lock_out, console, began)
    console.print(brief)
    more = len(console.render_lines(whole)) - len(console.render_lines(brief))
    if more > 0:
        say(f"{count(more, 'line')} more: rigctl status --all")


def _brief(
    state: dict[str, Any], endpoint: str, alarms: Sequence[Alarm], now_ns: int, lock_out: str, console: Console,
    began: str = "",
) -> Table:  # fmt: skip
    from rich.text import Text

    from rigctl.wire.operator_view import view

    seen = view(state, alarms, lock_out)
    mode = Text.assemble((f" {figures.mode(state)} ", figures.mode_style(state)), f"  {seen.entry}: {seen.entry_why}")
    load = "; ".join(filter(None, (figures.held(state), figures.ending(state)))) if state["loop_alive"] else seen.does
    since = [("", Text(began))] if began else []
    table = grid([("rig", Text(f"{state['rig']} at {endpoint}")), ("mode", mode), *since, ("load", Text(load))])

    def height(text: str) -> int:
        return len(console.render_lines(grid([("", Text(text))])))

    for label, value, style in brief_rows(state, alarms, now_ns, lock_out, height):
        table.add_row(label, Text(value, style))
    return table
