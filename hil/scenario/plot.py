"""The plot of a run, laid out like the paper's figures: force, inclinations, pulley; with the loop, also its action."""

from __future__ import annotations

import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hil.scenario.case import Case
from hil.scenario.play import Played
from rigctl.config.settings import RigSettings
from rigctl.metrics.tension_error import error_pct

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SUFFIXES = (".png", ".svg", ".pdf")
MOST_POINTS = 6000
"""More points than this are not visible; the lowest and the highest of every stretch are kept."""

ERROR = "vertical_error_n"
LIMITED = ("vertical_n", "tangential_deg", "normal_deg", "pulley_mm", "stroke_mm", ERROR)
"""Signals of the rig file's limits by panel."""
LEAST_ERROR_PCT = 0.05  # shown of the error

_TRUTH, _VIEW, _SPEED, _GREY, _ALARM = "#1f4e79", "#f0b98d", "#8cc5a2", "#8a8a8a", "#b00020"


def plot(case: Case, played: Played, file: pathlib.Path) -> None:
    """Draw a run into a file of one of ``SUFFIXES``.

    Raises:
        OSError: the file cannot be written.
    """
    import matplotlib as mpl  # 0.5 s to import: only where a plot is drawn
    from matplotlib.figure import Figure

    mpl.rcParams.update({"svg.hashsalt": "rigctl", "axes.spines.top": False, "axes.spines.right": False})
    loop = played.controller == "loop"
    figure = Figure(figsize=(10.0, 8.4 if loop else 5.8), layout="constrained")
    axes = figure.subplots(3 if loop else 2, 2, sharex=True)
    truth, t_s = played.truth, played.t_s
    panels = [
        ("vertical tension", "N", "vertical_n", 1.0, 1.0),
        ("tangential inclination", "deg", "tangential_rad", np.degrees(1.0), 0.1),
        ("normal inclination", "deg", "normal_rad", np.degrees(1.0), 0.1),
        ("pulley displacement", "mm", "pulley_mm", 1.0, 0.5),
    ]
    for letter, axis, (title, unit, field, scale, _) in zip("abcd", axes.flat, panels, strict=False):
        _curve(axis, t_s, truth[field] * scale, _TRUTH, "truth")
        axis.set_ylabel(f"({letter}) {title}, {unit}")
    axes.flat[0].axhline(played.target_n, color=_GREY, linewidth=0.8, linestyle="--", label="target")
    if loop:
        _work_of_the_loop(axes.flat[4], axes.flat[5], played)
        _seen_by_the_loop(axes.flat[:3], played)
    for axis, panel in zip(axes.flat, panels, strict=False):
        widen(axis, panel[-1])
    if loop:
        _limits(case.settings, played.target_n, dict(zip(LIMITED, axes.flat, strict=True)))
    for axis in axes.flat:
        for window in case.scenario.windows.values():
            axis.axvspan(window.from_s, window.to_s, color=_GREY, alpha=0.12, linewidth=0.0)
            for edge_s in (window.from_s, window.to_s):  # one window may begin where another ends
                axis.axvline(edge_s, color=_GREY, linewidth=0.6, alpha=0.6)
        if played.ended.tripped_at_s is not None:
            axis.axvline(played.ended.tripped_at_s, color=_ALARM, linewidth=1.0, label="trip")
        axis.grid(visible=True, axis="both" if axis.get_zorder() == 0 else "x", color="#e4e4e4", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.ticklabel_format(axis="y", useOffset=False)
        axis.margins(x=0.0)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    for axis in axes[0]:
        for name, window in case.scenario.windows.items():
            middle = 0.5 * (window.from_s + window.to_s)
            axis.text(middle, 1.01, name, transform=axis.get_xaxis_transform(), ha="center", fontsize=8, color=_GREY)
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    how = "loop" if loop else "cylinder locked"
    stiffness = case.settings.plant.stiffness_n_mm
    trip = f", TRIPPED: {played.ended.fault}" if played.ended.tripped else ""
    figure.suptitle(f"{case.scenario.scenario}: k {stiffness:.4g} N/mm, {how}, target {played.target_n:g} N{trip}")
    figure.savefig(file, dpi=150, metadata={"Date": None} if file.suffix.lower() == ".svg" else None)


def widen(axis: Axes, span: float) -> None:
    """Show at least ``span`` on the y axis, so that noise does not fill the picture."""
    low, high = axis.get_ylim()
    if high - low < span:
        middle = 0.5 * (low + high)
        axis.set_ylim(middle - 0.5 * span, middle + 0.5 * span)


def _work_of_the_loop(stroke: Axes, error: Axes, played: Played) -> None:
    """Stroke with its speed, and the error of equation (16)."""
    truth, t_s = played.truth, played.t_s
    speed = stroke.twinx()
    _curve(speed, t_s, truth["speed_mm_s"], _SPEED, "speed", linewidth=0.6)
    _curve(stroke, t_s, truth["stroke_mm"], _TRUTH, "stroke")
    stroke.set_zorder(speed.get_zorder() + 1)
    stroke.patch.set_visible(False)
    speed.spines["right"].set_visible(True)
    speed.set_ylabel("speed, mm/s", color="#3a8a5f")
    speed.tick_params(axis="y", colors="#3a8a5f")
    stroke.set_ylabel("(e) stroke of the cylinder, mm", color=_TRUTH)
    eta_pct = np.abs(error_pct(truth["vertical_n"], played.target_n))
    _curve(error, t_s, eta_pct, _TRUTH, "truth", linewidth=0.6)
    error.set_ylabel("(f) error of the force, %")
    error.set_ylim(0.0, max(error.get_ylim()[1], LEAST_ERROR_PCT))
    widen(stroke, 1.0)
    widen(speed, 1.0)


def _limits(settings: RigSettings, target_n: float, axes: Mapping[str, Axes]) -> None:
    """The rig file's limits where they are in view, with what the loop does beyond them."""
    for limit in settings.limits:
        if limit.signal not in axes or "COMPENSATING" not in limit.modes:
            continue
        axis = axes[limit.signal]
        for bound in (limit.low, limit.high):
            value = bound if bound is None or limit.signal != ERROR else 100.0 * bound / target_n
            if value is None or not axis.get_ylim()[0] < value < axis.get_ylim()[1]:
                continue
            axis.axhline(value, color=_ALARM, linewidth=0.8, linestyle="--")
            words = f"limit {bound:g}{' N' if limit.signal == ERROR else ''}: {limit.action}"
            axis.text(0.01, value, words, transform=axis.get_yaxis_transform(), fontsize=7, color=_ALARM, va="bottom")


def _seen_by_the_loop(axes: list[Axes], played: Played) -> None:
    """The measurements of cell and inclinometer, behind the truth."""
    assert played.records is not None and played.records_t_s is not None
    seen = [("vertical_n", 1.0), ("tangential_rad", np.degrees(1.0)), ("normal_rad", np.degrees(1.0))]
    for axis, (field, scale) in zip(axes, seen, strict=True):
        _curve(axis, played.records_t_s, played.records[field] * scale, _VIEW, "measured", linewidth=0.6, zorder=1.0)


def _curve(
    axis: Axes, t_s: np.ndarray, values: np.ndarray, color: str, label: str, linewidth: float = 1.2, zorder: float = 2.0
) -> None:
    at = _visible(values)
    axis.plot(t_s[at], values[at], color=color, linewidth=linewidth, label=label, zorder=zorder)


def _visible(values: np.ndarray) -> np.ndarray:
    """Rows to draw: all if they are few, else the lowest and the highest of every stretch, so that no peak is lost."""
    if len(values) <= MOST_POINTS:
        return np.arange(len(values))
    width = -(-2 * len(values) // MOST_POINTS)
    first = np.arange(0, len(values), width)
    stretches = np.pad(values, (0, len(first) * width - len(values)), mode="edge").reshape(-1, width)
    kept = np.concatenate([first + stretches.argmin(axis=1), first + stretches.argmax(axis=1)])
    return np.unique(np.minimum(kept, len(values) - 1))
