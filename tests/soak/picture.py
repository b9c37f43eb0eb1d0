"""A picture of a soak: memory and descriptors of every process, strikes, and lateness with and without the load."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tests.soak import plan
from tests.soak.sampling import Processes

COLOURS = {
    "supervisor": "#000000", "control": "#D55E00", "gateway": "#0072B2", "recorder": "#009E73", "hold": "#CC79A7",
    "page": "#E69F00", "scripts": "#8C6D31",
}  # fmt: skip
WORDS = {"scripts": "scripts in the browser"}
LATENESS = {"p50_us": "half", "p99_us": "99 %", "p999_us": "99.9 %", "worst_us": "worst"}
STARTING_S = 15.0  # of a process: imports


def _scale(results: dict[str, Any]) -> tuple[float, str]:
    return (60.0, "min") if results["duration_s"] >= 300 else (1.0, "s")


def _over_time(axes: Axes, results: dict[str, Any], processes: Processes, column: int) -> None:
    """One quantity of every process; a gap where it was killed."""
    scale, _ = _scale(results)
    for life in processes.lives:
        table = life.table
        if life.name not in COLOURS or (column == 2 and life.name == "scripts"):
            continue
        shown = table[table[:, 0] >= min(table[0, 0] + STARTING_S, table[-1, 0])] if table[0, 0] > 1.0 else table
        axes.plot(shown[:, 0] / scale, shown[:, column], color=COLOURS[life.name], linewidth=1.4)
    begin, end = plan.busy(results["duration_s"])
    axes.axvspan(begin / scale, end / scale, color="#56B4E9", alpha=0.08, linewidth=0)
    for strike in results["strikes"]:
        axes.axvline(
            strike["at_s"] / scale, color=COLOURS.get(strike["what"], "#666666"), alpha=0.6, linewidth=0.9,
            linestyle="--" if strike["what"] == "disk" else ":",
        )  # fmt: skip
    axes.set_xlim(0.0, results["duration_s"] / scale)
    axes.set_ylim(bottom=0)
    axes.grid(axis="y", alpha=0.3)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _lateness(axes: Axes, figures: dict[str, dict[str, float]]) -> None:
    rows = np.arange(len(LATENESS))[::-1]
    for kind, offset, colour, label in (
        ("alone", 0.2, "#56B4E9", "without clients"), ("busy", -0.2, "#D55E00", "with the whole load"),
    ):  # fmt: skip
        values = [figures[kind][name] for name in LATENESS]
        axes.barh(rows + offset, values, 0.36, color=colour, label=label)
        for row, value in zip(rows, values, strict=True):
            text = f"{value / 1000:.1f} ms" if value >= 1000 else f"{value:.0f} us"
            axes.annotate(text, (value, row + offset), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(rows, list(LATENESS.values()))
    axes.set_xscale("log")
    axes.margins(x=0.12)
    axes.set_xlabel("lateness of the loop's ticks, us")
    axes.legend(fontsize=8, loc="upper right", frameon=False)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def draw(results: dict[str, Any], processes: Processes, file: pathlib.Path) -> None:
    """Draw it into ``file``."""
    figure = Figure((10.0, 8.2), layout="constrained")
    memory, handles, late = figure.subplots(3, 1, height_ratios=(3.2, 2, 1.8))
    _over_time(memory, results, processes, 1)
    _over_time(handles, results, processes, 2)
    memory.set_ylabel("private memory, MiB")
    handles.set_ylabel("file handles")
    handles.set_xlabel(_scale(results)[1])
    there = {life.name for life in processes.lives}
    lines = [
        Line2D([], [], color=colour, label=WORDS.get(name, name)) for name, colour in COLOURS.items() if name in there
    ]
    lines.append(Line2D([], [], color="#666666", linestyle=":", label="killed"))
    lines.append(Line2D([], [], color="#666666", linestyle="--", label="disk full"))
    figure.legend(handles=lines, ncols=5, fontsize=8.5, loc="outside upper center", frameon=False)
    trips = results["trips"]
    memory.set_title(
        f"{results['duration_s'] / _scale(results)[0]:.0f} {_scale(results)[1]} of service: "
        f"{results['records']:,} records, "
        f"{sum(results['lost'].values())} lost; {len(trips)} trips, {sum(not trip['cause'] for trip in trips)} without "
        f"a cause; {results['clients_came']} clients came and went",
        fontsize=9.5,
    )
    _lateness(late, results["lateness"])
    figure.savefig(file, dpi=100)
