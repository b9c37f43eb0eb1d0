"""The comparison's results: a matrix for people, figures by name for programs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hil.compare import cell
from hil.compare.margins import Robustness
from hil.compare.rivals import CONTROLLERS, OURS, PASSIVE
from hil.compare.scenarios import Scenario
from hil.compare.study import COMPENSATING, LOCKED, SETTLED_PCT, Result, Study, Verdict
from rigctl.config.quantity import count
from rigctl.config.settings import RigSettings

_Value = Callable[[Result], float | None]
_QUANTITIES: dict[str, tuple[str, _Value]] = {
    "max": ("Largest error of the vertical force, %", lambda result: result.eta_max_pct),
    "rms": ("The error's root mean square, %", lambda result: result.eta_rms_pct),
    "speed": ("Largest speed of the cylinder, mm/s", lambda result: result.speed_max_mm_s),
    "settle": (f"Time until the error stays within {SETTLED_PCT:g} %, s", lambda result: result.settle_s),
}
_NO_PRIZE = "speed"
"""A slow cylinder is no merit in itself: the locked one would win."""
NAMED = 3
"""Most laws that are named among those that did better."""
_NAMES = {
    "eta_true_max_pct": "max, %",
    "eta_true_rms_pct": "rms, %",
    "settle_s": "settling, s",
    "eta_true_max_over_passive": "max over passive",
}
_TITLES = {controller.name: controller.title for controller in CONTROLLERS}


def show(study: Study, console: Console) -> None:
    """Print a matrix per quantity, the tuning of the laws, our limits, and where our law does not win."""
    marks: dict[str, int] = {}
    for key, (title, value) in _QUANTITIES.items():
        rows = [s for s in study.scenarios if key != "settle" or s.event_s is not None]
        if rows:
            console.print(_matrix(study, key, title, value, rows, marks), highlight=False)
            console.print()
    for ended, mark in marks.items():
        console.print(f"[{mark}] {ended}", highlight=False, markup=False)
    console.print("bold, *: the best of its row. -: does not apply, or does not settle", highlight=False)
    console.print()
    console.print(_prices(study), highlight=False)
    console.print("\nHow each is tuned", highlight=False)
    for controller in study.controllers:
        console.print(f"  {controller.title}: {controller.rule}", highlight=False, markup=False)
    verdicts = list(study.verdicts())
    if verdicts:
        console.print()
        console.print(_limits(verdicts), highlight=False)
        console.print(f"{sum(v.ok for v in verdicts)} of {count(len(verdicts), 'limit')} kept by ours", highlight=False)
    if study.with_cell:
        console.print()
        console.print(_cell_errors(study), highlight=False)
        console.print(_budget(study.rig), highlight=False)
    if any(controller.name == OURS for controller in study.controllers):
        console.print("\nWhere ours does not win", highlight=False)
        for line in losses(study) or ["nowhere"]:
            console.print(f"  {line}", highlight=False, markup=False)


def document(study: Study) -> dict[str, Any]:
    """Everything that is printed, for JSON: ``scenarios``, ``controllers``, ``limits``."""
    return {
        "scenarios": {
            scenario.name: {
                controller.name: _figures(study.results[scenario.name, controller.name])
                for controller in study.controllers
            }
            for scenario in study.scenarios
        },
        "controllers": {
            controller.name: {"rule": controller.rule, **_robustness(study.robustness[controller.name])}
            for controller in study.controllers
        },
        "limits": [verdict._asdict() for verdict in study.verdicts()],
        "cell": {
            "budget_n": {error.name: error.newtons for error in cell.budget(study.rig)},
            "combined_n": cell.combined_n(cell.budget(study.rig)),
            "ours_with_errors": {name: _figures(result) for name, result in study.with_cell.items()},
        },
    }


def losses(study: Study) -> list[str]:
    """A line per scenario and quantity in which another law did better than ours."""
    lines = []
    for scenario in study.scenarios:
        for key, (_, value) in _QUANTITIES.items():
            if key == _NO_PRIZE or (key == "settle" and scenario.event_s is None):
                continue
            ours = value(study.results[scenario.name, OURS])
            better = [
                (found, controller.title)
                for controller in study.controllers
                if (found := value(study.results[scenario.name, controller.name])) is not None
                and (ours is None or _said(found) < _said(ours))
            ]
            if better:
                names = ", ".join(f"{title} {_said(found):.4g}" for found, title in sorted(better)[:NAMED])
                names += f" and {len(better) - NAMED} more" if len(better) > NAMED else ""
                lines.append(f"{scenario.name}, {key}: {names}; ours {'-' if ours is None else f'{_said(ours):.4g}'}")
    return lines


def _figures(result: Result) -> dict[str, float | str | None]:
    return {
        "eta_true_max_pct": result.eta_max_pct,
        "eta_true_rms_pct": result.eta_rms_pct,
        "speed_max_mm_s": result.speed_max_mm_s,
        "settle_s": result.settle_s,
        "ended": result.ended,
    }


def _robustness(found: Robustness | None) -> dict[str, float | None]:
    """``ms_family`` is null also where a plant of the family is unstable."""
    if found is None:
        return dict.fromkeys(Robustness._fields)
    return {name: value if math.isfinite(value) else None for name, value in found._asdict().items()}


def _prices(study: Study) -> Table:
    """The price of the figures above: each law's distance from instability, and its noise in the command."""
    title = "Sensitivity peak Ms and the command's noise, linear, with the plant of the rig file"
    table = Table("law", title=title, title_justify="left", box=None, pad_edge=False)
    for column in ("Ms, this plant", "Ms, worst of the family", "noise, mm/s rms"):
        table.add_column(column, justify="right", no_wrap=True)
    for controller in study.controllers:
        found = study.robustness[controller.name]
        if found is not None:
            worst = f"{found.ms_family:.2f}" if math.isfinite(found.ms_family) else "unstable"
            table.add_row(controller.title, f"{found.ms:.2f}", worst, f"{found.command_noise_mm_s:.2f}")
    return table


def _matrix(study: Study, key: str, title: str, value: _Value, rows: list[Scenario], marks: dict[str, int]) -> Table:
    table = Table("scenario", title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for controller in study.controllers:
        table.add_column(controller.title, justify="right", no_wrap=True)
    for scenario in rows:
        results = {c.name: study.results[scenario.name, c.name] for c in study.controllers}
        found = [_said(x) for name, r in results.items() if name != PASSIVE and (x := value(r)) is not None]
        best = min(found) if found and key != _NO_PRIZE and len(results) > 1 else None
        table.add_row(scenario.title, *(_cell(result, value(result), best, marks) for result in results.values()))
    return table


def _cell(result: Result, value: float | None, best: float | None, marks: dict[str, int]) -> Text:
    if result.ended not in (COMPENSATING, LOCKED):
        return Text(f"[{marks.setdefault(result.ended, len(marks) + 1)}]", style="red")
    if value is None:
        return Text("- ")
    won = best is not None and _said(value) <= best
    return Text(_number(_said(value)) + ("*" if won else " "), style="bold" if won else "")


def _said(value: float) -> float:
    """The value as printed: a difference that is not printed does not count."""
    return float(f"{value:.2g}") if value < 0.1 else float(f"{value:.3g}")


def _number(value: float) -> str:
    if value < 0.1:
        return f"{value:.4f}"
    return f"{value:.3f}" if value < 1.0 else f"{value:.2f}"


def _cell_errors(study: Study) -> Table:
    """Our law without and with the cell's errors."""
    title = "Ours without and with the cell's systematic errors, largest and rms error of the vertical force, %"
    table = Table("scenario", title=title, title_justify="left", box=None, pad_edge=False)
    for column in ("max", "max with", "rms", "rms with"):
        table.add_column(column, justify="right", no_wrap=True)
    for scenario in study.scenarios:
        without, having = study.results[scenario.name, OURS], study.with_cell[scenario.name]
        pairs = (without.eta_max_pct, having.eta_max_pct), (without.eta_rms_pct, having.eta_rms_pct)
        table.add_row(scenario.title, *("-" if x is None else _number(_said(x)) for pair in pairs for x in pair))
    return table


def _budget(rig: RigSettings) -> Table:
    """The sensor budget."""
    errors, target_n = cell.budget(rig), rig.tension.target_n
    table = Table("sensor budget", box=None, pad_edge=False)
    for column in ("N", "% of the target"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("")
    rows = [*errors, cell.Error("root of squares", cell.combined_n(errors), "")]
    rows.append(cell.Error("sum", math.fsum(error.newtons for error in errors), "what the runs above have"))
    for error in rows:
        table.add_row(error.name, f"{error.newtons:.3f}", f"{100 * error.newtons / target_n:.3f}", error.source)
    return table


def _limits(verdicts: list[Verdict]) -> Table:
    table = Table("ours", title="Ours against its limits", title_justify="left", box=None, pad_edge=False)
    for column in ("", "at most", "measured", "verdict"):
        table.add_column(column, justify="right" if column else "left", no_wrap=True)
    for verdict in verdicts:
        measured = "-" if verdict.measured is None else f"{verdict.measured:.4f}"
        said = Text("kept", "green") if verdict.ok else Text("MISSED", "red")
        table.add_row(verdict.scenario, _NAMES[verdict.quantity], f"{verdict.limit:g}", measured, said)
    return table
