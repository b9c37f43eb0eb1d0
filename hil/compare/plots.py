"""The comparison's plots: the largest error everywhere, and the error against time in selected scenarios."""

from __future__ import annotations

import pathlib

import matplotlib as mpl

mpl.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from hil.compare.rivals import OURS, PASSIVE
from hil.compare.study import SETTLED_PCT, Study
from rigctl.ipc import output_file

FIRST = "eta_max.png"
_COLORS = {
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
"""By scenario: title, time shown in s, error shown in % (None: range of the active laws)."""


def save(study: Study, folder: pathlib.Path) -> list[pathlib.Path]:
    """Write the bar chart, and a plot of the traces that were run; returns their names.

    Raises:
        OutputError: the folder cannot be written.
    """
    written = [folder / FIRST]
    _bars(study, written[0])
    shown = [scenario.name for scenario in study.scenarios if scenario.name in _TRACES]
    for name in shown:
        written.append(folder / f"{name}.png")
        _trace(study, name, written[-1])
    return written


def _bars(study: Study, file: pathlib.Path) -> None:
    count = len(study.controllers)
    rows = len(study.scenarios)
    figure, axis = plt.subplots(figsize=(13.0, 1.2 + 0.62 * max(rows, 3)), layout="constrained")
    height = 0.84 / count
    places = np.arange(rows)[::-1]
    for i, controller in enumerate(study.controllers):
        results = [study.results[scenario.name, controller.name] for scenario in study.scenarios]
        values = [np.nan if result.eta_max_pct is None else result.eta_max_pct for result in results]
        at = places + (0.5 * (count - 1) - i) * height
        axis.barh(at, values, height, color=_COLORS[controller.name], label=controller.title)
        for y, result in zip(at, results, strict=True):
            if not result.whole:
                words = f"{controller.title} {result.ended}"
                axis.text(1.05e-3, y, words, fontsize=7.5, va="center", color=_COLORS[controller.name])
    for y, scenario in zip(places, study.scenarios, strict=True):
        for quantity, most in scenario.limits:
            if quantity == "eta_true_max_pct":
                axis.plot([most, most], [y - 0.46, y + 0.46], color="#d00000", linewidth=1.3, label="_")
    axis.plot([], [], color="#d00000", linewidth=1.3, label="limit of ours")
    axis.set_xscale("log")
    axis.set_xlim(1e-3, 1.3 * axis.get_xlim()[1])  # the end of a bar must be visible
    axis.set_yticks(places, [scenario.title for scenario in study.scenarios])
    axis.set_ylim(-0.6, rows - 0.4)
    axis.set_xlabel("largest error of the vertical force, %")
    axis.grid(visible=True, axis="x", which="major", alpha=0.35)
    axis.set_axisbelow(True)
    figure.legend(loc="outside upper center", ncols=count + 1, frameon=False, fontsize=9)
    with output_file.writing(file):
        figure.savefig(file, dpi=110)
    plt.close(figure)


def _trace(study: Study, name: str, file: pathlib.Path) -> None:
    """A panel per law, all with the same axes, the locked cylinder and our law behind."""
    title, (from_s, to_s), span = _TRACES[name]
    laws = [c for c in study.controllers if c.name != PASSIVE] or list(study.controllers)
    columns = min(4, len(laws))
    rows = -(-len(laws) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(3.4 * columns, 2.7 * rows + 0.6), sharex=True, sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    behind = [who for who in (PASSIVE, OURS) if (name, who) in study.results]
    band = f"; band: {SETTLED_PCT:g} %" if name == "jolt" else ""
    figure.suptitle(title + (f" (faint: {' and '.join(behind)}{band})" if behind else ""))
    for axis, law in zip(axes.flat, laws, strict=False):
        for who in dict.fromkeys((PASSIVE, OURS, law.name)):
            if (name, who) in study.results:
                _curve(study, name, who, axis, faint=who != law.name)
        axis.set_title(law.title, fontsize=10)
        axis.grid(visible=True, alpha=0.3)
    for axis in list(axes.flat)[len(laws) :]:
        axis.set_axis_off()
    first = axes[0, 0]
    first.set_xlim(from_s, to_s)
    first.set_ylim(span or _range(study, name, from_s, to_s))
    for axis in axes[:, 0]:
        axis.set_ylabel("error, %", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time, s", fontsize=9)
    if name == "jolt":
        for axis in axes.flat[: len(laws)]:
            axis.axhspan(-SETTLED_PCT, SETTLED_PCT, color="#2a9d8f", alpha=0.15, linewidth=0.0)
    with output_file.writing(file):
        figure.savefig(file, dpi=110)
    plt.close(figure)


def _curve(study: Study, name: str, who: str, axis: Axes, *, faint: bool) -> None:
    run = study.results[name, who]
    axis.plot(run.t_s, run.eta_pct, color=_COLORS[who], linewidth=0.9, alpha=0.4 if faint else 1.0)


def _range(study: Study, name: str, from_s: float, to_s: float) -> tuple[float, float]:
    """Range of the active laws' errors; that of the locked cylinder may leave the plot."""
    most = 0.0
    for controller in study.controllers:
        run = study.results[name, controller.name]
        if controller.name != PASSIVE or len(study.controllers) == 1:
            inside = (run.t_s >= from_s) & (run.t_s <= to_s)
            most = max(most, float(np.max(np.abs(run.eta_pct[inside]), initial=0.0)))
    return -1.15 * most, 1.15 * most
