"""The comparison's pictures: the largest error everywhere, and the error against time in selected runs."""

from __future__ import annotations

import pathlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from hil.studies import plotting
from hil.studies.compare.compared_runs import ComparedRun
from hil.studies.compare.comparison import SETTLED_PCT, Comparison, LawResult
from hil.studies.compare.rivals import OURS, PASSIVE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIRST = "eta_max.png"
COLUMNS = 3
ROOM_FOR_VALUES = 3.0  # to the right of the largest error, on the logarithmic axis
RIVAL, LIMIT = "#7c8590", "#d00000"
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
    """Write the errors of all runs, and a plot of the traces that were run; returns their names.

    Raises:
        OutputError: the folder cannot be written.
    """
    shown = [run.name for run in study.runs if run.name in _TRACES]
    return [_errors(study, folder / FIRST), *(_trace(study, name, folder / f"{name}.png") for name in shown)]


def _errors(study: Comparison, file: pathlib.Path) -> pathlib.Path:
    """A panel per run, all on one logarithmic axis; a row per law: dot at the largest error, tick at the rms."""
    columns = min(COLUMNS, len(study.runs))
    rows = -(-len(study.runs) // columns)
    size = (2.0 + 3.6 * columns, 1.0 + rows * (0.75 + 0.19 * len(study.laws)))
    title = "Error of the vertical force, %: dot largest, bar rms; red line: limit of ours"
    figure, axes = plotting.panels(rows, columns, size, title, sharex=True, sharey=True)
    places = range(len(study.laws))[::-1]
    for axis, run in zip(axes.flat, study.runs, strict=False):
        for y, law in zip(places, study.laws, strict=True):
            _row(axis, y, study.results[run.name, law.name], COLORS[law.name] if law.name == OURS else RIVAL)
        for most in _limits_pct(study, run):
            axis.axvline(most, color=LIMIT, linewidth=1.3)
            axis.annotate(
                f"{most:.2g}", (most, 1.0), (0, 2), ("data", "axes fraction"), "offset points", fontsize=7.5,
                color=LIMIT, ha="center",
            )  # fmt: skip
        axis.set_title(run.title, fontsize=10, loc="left", pad=13.0)
        axis.tick_params(labelbottom=True)
        plotting.label(axis, axis="x", which="major", alpha=0.35)
    for axis in list(axes.flat)[len(study.runs) :]:
        axis.set_axis_off()
    first = axes[0, 0]
    first.set_xscale("log")
    low, high = first.get_xlim()
    first.set_xlim(0.8 * low, ROOM_FOR_VALUES * high)
    first.set_ylim(-0.6, len(study.laws) - 0.4)
    first.set_yticks(list(places), [law.title for law in study.laws], fontsize=9)
    return plotting.save(figure, file)


def _row(axis: Axes, y: int, result: LawResult, color: str) -> None:
    if result.eta_max_pct is None or result.eta_rms_pct is None:
        axis.text(0.02, y, result.ended, fontsize=7.5, va="center", color=color, transform=axis.get_yaxis_transform())
        return
    axis.plot([result.eta_rms_pct, result.eta_max_pct], [y, y], color=color, linewidth=1.0)
    axis.plot(result.eta_rms_pct, y, "|", color=color, markersize=8, markeredgewidth=1.6)
    axis.plot(result.eta_max_pct, y, "o", color=color, markersize=5)
    axis.annotate(
        f"{result.eta_max_pct:.2g}", (result.eta_max_pct, y), (5, 0), textcoords="offset points", fontsize=7.5,
        va="center", color=color, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
    )  # fmt: skip


def _limits_pct(study: Comparison, run: ComparedRun) -> Iterator[float]:
    """The limits of our largest error; one over that of the locked cylinder needs its run."""
    passive = study.results.get((run.name, PASSIVE))
    for quantity, most in run.limits:
        if quantity == "eta_true_max_pct":
            yield most
        elif quantity == "eta_true_max_over_passive" and passive is not None and passive.eta_max_pct is not None:
            yield most * passive.eta_max_pct


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
