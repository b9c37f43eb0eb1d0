"""``rigctl status``: the state of the rig on one small screen."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rigctl.cli.options import BAD, DONE, Connect, Json, Rig, daemon, end, say_json
from rigctl.config.quantity import count
from rigctl.wire import state_words as figures

if TYPE_CHECKING:
    from rigctl.wire.alarms import Alarm


def status(json: Json = False, connect: Connect = None, rig: Rig = None) -> None:
    """Show mode, tension, error, stroke, inclination and how well the loop keeps its time."""
    from rigctl.wire.alarms import Alarms

    with daemon(connect, rig) as client:
        known = Alarms(client.past_events()) if not json else None
        state = client.state()
        active = client.active() if not json else {}
        endpoint = client.endpoint
    if json:
        say_json(state)
    else:
        lock_out = str(((active.get("settings") or {}).get("safety") or {}).get("lock_out") or "")
        _show(state, endpoint, known.rows(state, time.time_ns()) if known is not None else [], lock_out)
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
        flaws, n, of = figures.flaws(state), figures.number, figures.measured
        tension = f"{of(state, 'tension_n', 2, 'N')} (vertical {of(state, 'vertical_n', 2, 'N')})"
        skipped = f"{state['skipped']} of {count(state['tick'], 'tick')}"
        late = figures.percentiles(state["lateness_us"])
        result += [
            ("tension", tension, "bold"),
            ("vertical error", figures.error(state), "bold"),
            ("target", n(state["target_n"], 1, "N"), ""),
            ("stroke", f"{of(state, 'stroke_mm', 2, 'mm')}, {of(state, 'speed_mm_s', 2, 'mm/s', sign=True)}", ""),
            ("inclination", figures.inclination(state), ""),
            ("drive", figures.drive_with_state(state), ""),
            *([("power off", shown, "")] if (shown := figures.power_off(state)) else []),
            ("load at rest", figures.at_rest(state), ""),
            ("calibration", *figures.calibration(state)),
            *([("signals", flaws, "bold yellow")] if flaws else []),
            ("lateness", late, ""),
            ("work", figures.percentiles(state["work_us"]), ""),
            ("skipped", skipped, "bold yellow" if state["skipped"] else ""),
            ("bus", figures.counters(state), ""),
            ("age", n(state["age_ms"], 1, "ms"), ""),
            *([("design", state["design"], "")] if state.get("design") else []),
            *([("margins", measured, "")] if (measured := figures.margins(state)) else []),
        ]
    result.append(("lease", figures.lease(state), ""))
    return result + [("warning", text, "yellow") for text in state["warnings"]]


def _show(state: dict[str, Any], endpoint: str, alarms: Sequence[Alarm], lock_out: str) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("rig", Text(f"{state['rig']} at {endpoint}"))
    for label, value, style in rows(state, alarms, time.time_ns(), lock_out):
        table.add_row(label, Text(value, style))
    Console(highlight=False).print(table)
