"""The comparison's results: a matrix for people, figures by name for programs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hil.runs.result_table import table, verdict
from hil.studies.compare.compared_runs import ComparedRun
from hil.studies.compare.comparison import SETTLED_PCT, Comparison, LawResult, LimitVerdict
from hil.studies.compare.law_robustness import Robustness
from hil.studies.compare.rivals import OURS, PASSIVE
from rigctl.config.settings import RigSettings
from rigctl.model.quantity import count
from rigctl.report.sensor_budget import Error, budget, combined_n

_Value = Callable[[LawResult], float | None]
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


def show(study: Comparison, console: Console) -> None:
    """Print a matrix per quantity, the tuning of the laws, our limits, and where our law does not win."""
    marks: dict[str, int] = {}
    for key, (title, value) in _QUANTITIES.items():
        runs = [run for run in study.runs if key != "settle" or run.event_s is not None]
        if runs:
            console.print(_matrix(study, key, title, value, runs, marks), highlight=False)
            console.print()
    for ended, mark in marks.items():
        console.print(f"[{mark}] {ended}", highlight=False, markup=False)
    console.print("bold, *: the best of its row. -: does not apply, or does not settle", highlight=False)
    console.print()
    console.print(_prices(study), highlight=False)
    console.print("\nHow each is tuned", highlight=False)
    for law in study.laws:
        console.print(f"  {law.title}: {law.rule}", highlight=False, markup=False)
    verdicts = list(study.verdicts())
    if verdicts:
        console.print()
        console.print(_limits(verdicts), highlight=False)
        console.print(f"{sum(v.ok for v in verdicts)} of {count(len(verdicts), 'limit')} kept by ours", highlight=False)
    if study.with_cell:
        console.print()
        console.print(_cell_errors(study), highlight=False)
        console.print(_budget(study.rig), highlight=False)
    if any(law.name == OURS for law in study.laws):
        console.print("\nWhere ours does not win", highlight=False)
        for line in losses(study) or ["nowhere"]:
            console.print(f"  {line}", highlight=False, markup=False)


def document(study: Comparison) -> dict[str, Any]:
    """Everything that is printed, for JSON: ``scenarios``, ``controllers``, ``limits``, ``cell``."""
    errors = budget(study.rig)
    return {
        "scenarios": {
            run.name: {law.name: _figures(study.results[run.name, law.name]) for law in study.laws}
            for run in study.runs
        },
        "controllers": {law.name: {"rule": law.rule, **_robustness(study.robustness[law.name])} for law in study.laws},
        "limits": [verdict._asdict() for verdict in study.verdicts()],
        "cell": {
            "budget_n": {error.name: error.newtons for error in errors},
            "combined_n": combined_n(errors),
            "ours_with_errors": {name: _figures(result) for name, result in study.with_cell.items()},
            "ours_commissioned": {name: _figures(result) for name, result in study.with_commissioned.items()},
        },
    }


def losses(study: Comparison) -> list[str]:
    """A line per run and quantity in which another law did better than ours."""
    lines = []
    for run in study.runs:
        for key, (_, value) in _QUANTITIES.items():
            if key == _NO_PRIZE or (key == "settle" and run.event_s is None):
                continue
            ours = value(study.results[run.name, OURS])
            better = [
                (found, law.title)
                for law in study.laws
                if (found := value(study.results[run.name, law.name])) is not None
                and (ours is None or _printed(found) < _printed(ours))
            ]
            if better:
                names = ", ".join(f"{title} {_printed(found):.4g}" for found, title in sorted(better)[:NAMED])
                names += f" and {len(better) - NAMED} more" if len(better) > NAMED else ""
                lines.append(f"{run.name}, {key}: {names}; ours {'-' if ours is None else f'{_printed(ours):.4g}'}")
    return lines


def _figures(result: LawResult) -> dict[str, float | str | None]:
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


def _prices(study: Comparison) -> Table:
    """The price of the figures above: each law's distance from instability, and its noise in the command."""
    title = "Sensitivity peak Ms and the command's noise, linear, with the plant of the rig file"
    found = table("law", ("Ms, this plant", "Ms, worst of the family", "noise, mm/s rms"), title)
    for law in study.laws:
        robust = study.robustness[law.name]
        if robust is not None:
            worst = f"{robust.ms_family:.2f}" if math.isfinite(robust.ms_family) else "unstable"
            found.add_row(law.title, f"{robust.ms:.2f}", worst, f"{robust.command_noise_mm_s:.2f}")
    return found


def _matrix(
    study: Comparison, key: str, title: str, value: _Value, runs: list[ComparedRun], marks: dict[str, int]
) -> Table:
    found = table("scenario", [law.title for law in study.laws], title)
    found.padding = (0, 1, 0, 0)
    for run in runs:
        results = {law.name: study.results[run.name, law.name] for law in study.laws}
        values = [_printed(x) for name, r in results.items() if name != PASSIVE and (x := value(r)) is not None]
        best = min(values) if values and key != _NO_PRIZE and len(results) > 1 else None
        found.add_row(run.title, *(_cell(result, value(result), best, marks) for result in results.values()))
    return found


def _cell(result: LawResult, value: float | None, best: float | None, marks: dict[str, int]) -> Text:
    if not result.whole:
        return Text(f"[{marks.setdefault(result.ended, len(marks) + 1)}]", style="red")
    if value is None:
        return Text("- ")
    won = best is not None and _printed(value) <= best
    return Text(_number(value) + ("*" if won else " "), style="bold" if won else "")


def _printed(value: float) -> float:
    """The value as printed: a difference that is not printed does not count."""
    return float(f"{value:.2g}") if value < 0.1 else float(f"{value:.3g}")


def _number(value: float) -> str:
    value = _printed(value)
    if value < 0.1:
        return f"{value:.4f}"
    return f"{value:.3f}" if value < 1.0 else f"{value:.2f}"


def _cell_errors(study: Comparison) -> Table:
    """Our law without and with the cell's errors, and with the cell commissioned."""
    title = "Ours without and with the cell's systematic errors, and with these corrected: vertical force, %"
    found = table("scenario", ("max", "max with", "corrected", "rms", "rms with", "corrected"), title)
    for run in study.runs:
        without, having = study.results[run.name, OURS], study.with_cell[run.name]
        known = study.with_commissioned.get(run.name)
        largest, rms = (None, None) if known is None else (known.eta_max_pct, known.eta_rms_pct)
        values = (
            without.eta_max_pct, having.eta_max_pct, largest, without.eta_rms_pct, having.eta_rms_pct, rms,
        )  # fmt: skip
        found.add_row(run.title, *("-" if value is None else _number(value) for value in values))
    return found


def _budget(rig: RigSettings) -> Table:
    """The sensor budget."""
    errors, target_n = budget(rig), rig.tension.target_n
    found = table("sensor budget", ("N", "% of the target"))
    found.add_column("")
    rows = [*errors, Error("root of squares", combined_n(errors), "")]
    rows.append(Error("sum", math.fsum(error.newtons for error in errors), "what the runs above have"))
    for error in rows:
        found.add_row(error.name, f"{error.newtons:.3f}", f"{100 * error.newtons / target_n:.3f}", error.source)
    return found


def _limits(verdicts: list[LimitVerdict]) -> Table:
    found = Table("ours", title="Ours against its limits", title_justify="left", box=None, pad_edge=False)
    for column in ("", "at most", "measured", "verdict"):
        found.add_column(column, justify="right" if column else "left", no_wrap=True)
    for row in verdicts:
        measured = "-" if row.measured is None else f"{row.measured:.4f}"
        words = verdict(row.ok, "kept", "MISSED")
        found.add_row(row.scenario, _NAMES[row.quantity], f"{row.limit:g}", measured, words)
    return found
