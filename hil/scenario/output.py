"""Output of ``python -m hil scenario``: JSON for programs, a table for people."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.scenario.case import Case
from hil.scenario.figures import LOOP_FIGURES, TRUTH_FIGURES, Figure, Values, figures
from hil.scenario.play import Played
from rigctl.config.bounds import findings
from rigctl.model.quantity import unit_of

COLUMNS = 4
"""Windows side by side in one table: five do not fit into 80 columns."""


def as_dict(case: Case, played: Played) -> dict[str, Any]:
    """All results, for JSON."""
    scenario = case.scenario
    return {
        "scenario": scenario.scenario,
        "rig": case.settings.rig,
        "controller": played.controller,
        "target_n": played.target_n,
        "stiffness_n_mm": case.settings.plant.stiffness_n_mm,
        "duration_s": scenario.duration_s,
        "waived_bounds": [
            f"{key}: found {found}, expected {allowed}" for key, found, allowed in findings(case.settings)
        ],
        "ended": asdict(played.ended),
        "windows": {name: {"from_s": span[0], "to_s": span[1]} for name, span in scenario.spans.items()},
        **figures(played, scenario.spans),
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results of ``as_dict``."""
    how = "the loop at work" if results["controller"] == "loop" else "cylinder locked"
    seconds, target_n = results["duration_s"], results["target_n"]
    console.print(
        f"[bold]{results['scenario']}[/] on {results['rig']}: {seconds:g} s, {how}, target {target_n:g} N",
        highlight=False,
    )
    for bound in results["waived_bounds"]:
        console.print(f"note: a rig with a load could not run so: {bound}", highlight=False, markup=False)
    names = list(results["windows"])
    for first in range(0, len(names), COLUMNS):
        part = names[first : first + COLUMNS]
        _table("the plant's truth", TRUTH_FIGURES, results["truth"], results["windows"], part, console)
        if results["loop"] is not None:
            _table("the loop's view", LOOP_FIGURES, results["loop"], results["windows"], part, console)
    ended = results["ended"]
    if ended["tripped"]:
        words = f"TRIPPED at {ended['tripped_at_s']:.3f} s: {ended['fault']}, ended in {ended['mode']}"
        console.print(f"[bold red]{words}[/]", highlight=False)
    elif results["controller"] == "loop":
        console.print(f"no trip, ended in {ended['mode']}", highlight=False)


def _table(
    title: str,
    rows: tuple[Figure, ...],
    values: dict[str, Values],
    windows: dict[str, dict[str, float]],
    names: list[str],
    console: Console,
) -> None:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.add_column("")
    for name in names:
        span = windows[name]
        table.add_column(f"{name}\n{span['from_s']:g}-{span['to_s']:g} s", justify="right", overflow="fold")
    table.add_column("", no_wrap=True)
    for figure in rows:
        table.add_row(figure.meaning, *(_number(values[name][figure.name]) for name in names), unit_of(figure.name))
    console.print(table, highlight=False)


def _number(value: float | None) -> str:
    """Five digits, and never an exponent."""
    if value is None:
        return "-"
    digits = next((n for n, least in enumerate((1000.0, 100.0, 10.0, 1.0), 1) if abs(value) >= least), 4)
    return f"{value:.{digits}f}" if value != int(value) else f"{int(value)}"
