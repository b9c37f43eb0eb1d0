"""The comparison's pictures: the largest error everywhere, and the error against time in selected runs."""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING

import numpy as np

from hil.compare.comparison import SETTLED_PCT, Comparison
from hil.compare.rivals import OURS, PASSIVE
from hil.study import plotting

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIRST = "eta_max.png"
COLORS = {
    "passive": "#b5b5b5",
    "p": "#e0a458",
    "pi": "#c8553d",
    "pid_ff": "#8f2d56",
    "lqi": "#6a8d73",
    "pi_dob": "#2a9d8f",
    "adrc": "#5b8fd9",
    "ours": "#12263a",
}
_TRACES: dict[str, tuple[str, tuple[float, float], tuple[float, float] | None]] = {
    "jolt": ("jolt, 1 mm in 20 ms: error of the vertical force", (0.95, 1.75), (-1.0, 0.5)),
    "shake_3hz": ("shake, 0.05 mm at 3 Hz", (4.0, 5.0), (-0.115, 0.115)),
    "paper_k6": ("paper move, k = 6 N/mm: the lag's peak", (2.0, 12.0), None),
}
"""By run: title, time shown in s, error shown in % (None: range of the active laws)."""


def save(study: Comparison, folder: pathlib.Path) -> list[pathlib.Path]:
    """Write the bar chart, and a plot of the traces that were run; returns their names.

    Raises:
        OutputError: the folder cannot be written.
    """
    shown = [run.name for run in study.runs if run.name in _TRACES]
    return [_bars(study, folder / FIRST), *(_trace(study, name, folder / f"{name}.png") for name in shown)]


def _bars(study: Comparison, file: pathlib.Path) -> pathlib.Path:
    count = len(study.laws)
    rows = len(study.runs)
    figure, ((axis,),) = plotting.panels(1, 1, (13.0, 1.2 + 0.62 * max(rows, 3)))
    height = 0.84 / count
    places = np.arange(rows)[::-1]
    for i, law in enumerate(study.laws):
        results = [study.results[run.name, law.name] for run in study.runs]
        values = [np.nan if result.eta_max_pct is None else result.eta_max_pct for result in results]
        at = places + (0.5 * (count - 1) - i) * height
        axis.barh(at, values, height, color=COLORS[law.name], label=law.title)
        for y, result in zip(at, results, strict=True):
            if not result.whole:
                words = f"{law.title} {result.ended}"
                axis.text(1.05e-3, y, words, fontsize=7.5, va="center", color=COLORS[law.name])
    for y, run in zip(places, study.runs, strict=True):
        for quantity, most in run.limits:
            if quantity == "eta_true_max_pct":
                axis.plot([most, most], [y - 0.46, y + 0.46], color="#d00000", linewidth=1.3, label="_")
    axis.plot([], [], color="#d00000", linewidth=1.3, label="limit of ours")
    axis.set_xscale("log")
    axis.set_xlim(1e-3, 1.3 * axis.get_xlim()[1])  # the end of a bar must be visible
    axis.set_yticks(places, [run.title for run in study.runs])
    axis.set_ylim(-0.6, rows - 0.4)
    plotting.label(axis, "largest error of the vertical force, %", axis="x", which="major", alpha=0.35)
    axis.set_axisbelow(True)
    figure.legend(loc="outside upper center", ncols=count + 1, frameon=False, fontsize=9)
    return plotting.save(figure, file)


def _trace(study: Comparison, name: str, file: pathlib.Path) -> pathlib.Path:
    """A panel per law, all with the same axes, the locked cylinder and our law behind."""
    title, (from_s, to_s), span = _TRACES[name]
    laws = [law for law in study.laws if law.name != PASSIVE] or list(study.laws)
    columns = min(4, len(laws))
    rows = -(-len(laws) // columns)
    behind = [law for law in (PASSIVE, OURS) if (name, law) in study.results]
    band = f"; band: {SETTLED_PCT:g} %" if name == "jolt" else ""
    title += f" (faint: {' and '.join(behind)}{band})" if behind else ""
    size = (3.4 * columns, 2.7 * rows + 0.6)
    figure, axes = plotting.panels(rows, columns, size, title, sharex=True, sharey=True)
    for axis, law in zip(axes.flat, laws, strict=False):
        for drawn in dict.fromkeys((PASSIVE, OURS, law.name)):
            if (name, drawn) in study.results:
                _curve(study, name, drawn, axis, faint=drawn != law.name)
        axis.set_title(law.title, fontsize=10)
        plotting.label(axis)
        if name == "jolt":
            axis.axhspan(-SETTLED_PCT, SETTLED_PCT, color="#2a9d8f", alpha=0.15, linewidth=0.0)
    for axis in list(axes.flat)[len(laws) :]:
        axis.set_axis_off()
    first = axes[0, 0]
    first.set_xlim(from_s, to_s)
    first.set_ylim(span or _range(study, name, from_s, to_s))
    for axis in axes[:, 0]:
        axis.set_ylabel("error, %", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time, s", fontsize=9)
    return plotting.save(figure, file)


def _curve(study: Comparison, name: str, law: str, axis: Axes, *, faint: bool) -> None:
    run = study.results[name, law]
    axis.plot(run.t_s, run.eta_pct, color=COLORS[law], linewidth=0.9, alpha=0.4 if faint else 1.0)


def _range(study: Comparison, name: str, from_s: float, to_s: float) -> tuple[float, float]:
    """Range of the active laws' errors; that of the locked cylinder may leave the plot."""
    most = 0.0
    for law in study.laws:
        run = study.results[name, law.name]
        if law.name != PASSIVE or len(study.laws) == 1:
            inside = (run.t_s >= from_s) & (run.t_s <= to_s)
            most = max(most, float(np.max(np.abs(run.eta_pct[inside]), initial=0.0)))
    return -1.15 * most, 1.15 * most
