"""The study's pictures, laid out like the paper's figures: locked on the left, with the loop closed beside it."""

from __future__ import annotations

import math
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from hil.scenario.plot import widen
from hil.studies import plotting
from hil.studies.paper.cases import FIGURE_9, NO_SPRING, SPEEDS_DEG_S, cases, speed, stiffness
from hil.studies.paper.claims import ETA_PCT, PEAK_LAG_DEG, PLATEAU_LAG_DEG, TARGET_N
from hil.studies.paper.paper_study import PaperStudy
from hil.studies.paper.run_truth import Floats, RunTruth
from hil.studies.planned_run import STIFFNESSES_N_MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANELS: dict[str, tuple[str, float, Callable[[RunTruth], Floats]]] = {
    "vertical": ("vertical tension, N", 1.0, lambda run: run.vertical_n),
    "tangential": ("tangential inclination, deg", 0.2, lambda run: run.tangential_deg),
    "normal": ("normal inclination, deg", 0.2, lambda run: run.normal_deg),
    "pulley": ("pulley displacement, mm", 0.5, lambda run: run.pulley_mm),
    "tension": ("tension in the rope, N", 1.0, lambda run: run.tension_n),
}
"""By panel: words, least span of the axis, values."""
_FIGURES: dict[str, tuple[str, tuple[str, ...], str]] = {
    "fig4": (
        "Figure 4: with (k = 6 N/mm) and without (k = 1000 N/mm) an elastic element",
        (stiffness(6.0), NO_SPRING),
        "vertical normal tangential pulley",
    ),
    "fig5": (
        "Figure 5: stiffness of the elastic element, 0.5 deg/s",
        tuple(map(stiffness, STIFFNESSES_N_MM)),
        "vertical tangential normal pulley",
    ),
    "fig7": (
        "Figure 7: deployment speed, k = 6 N/mm",
        tuple(map(speed, SPEEDS_DEG_S)),
        "vertical tangential normal pulley",
    ),
    "fig9": (
        "Figure 9: 13 deg out and back, with errors of level and vibration",
        (FIGURE_9,),
        "tension vertical tangential normal",
    ),
}
"""By file: title, cases, panels."""
_SOFT = stiffness(6.0)
_PEAKS_S = 7.0  # "in about 7 s", section 2.2
_PRINTED: dict[str, dict[str, list[tuple[str, float, float]]]] = {
    "fig4": {
        "vertical": [(NO_SPRING, 4.5, 455.0), (_SOFT, 4.0, 301.0), (NO_SPRING, math.inf, 435.0)],
        "tangential": [
            (NO_SPRING, 4.5, 0.80), (_SOFT, 4.0, 0.70), (NO_SPRING, math.inf, 0.65), (_SOFT, math.inf, 0.525),
        ],
    },
    "fig5": {
        "vertical": [(stiffness(k), _PEAKS_S, TARGET_N * (1.0 + 0.01 * eta)) for k, eta in ETA_PCT.items()],
        "tangential": [
            *((stiffness(k), _PEAKS_S, lag) for k, lag in PEAK_LAG_DEG.items()),
            *((stiffness(k), math.inf, lag) for k, lag in PLATEAU_LAG_DEG.items()),
        ],
    },
}  # fmt: skip
"""The paper's printed values by figure and panel: case, time in s (infinite: of the plateau), value."""
FIRST = "fig4.png"


def save(study: PaperStudy, folder: pathlib.Path) -> list[pathlib.Path]:
    """Write one PNG per figure; returns their names.

    Raises:
        OutputError: the folder cannot be written.
    """
    titles = {case.name: case.title for case in cases()}
    closed = {name: run.truth for name, run in study.closed.items()}
    written = []
    for name, (title, shown, panels) in _FIGURES.items():
        names = panels.split()
        size = (13.0, 3.0 * len(names))
        figure, axes = plotting.panels(len(names), 2, size, title, sharex=True, sharey="row")
        for row, panel in enumerate(names):
            for axis, runs in zip(axes[row], (study.passive, closed), strict=True):
                _panel(axis, f"({'abcd'[row]})", panel, {titles[case]: runs[case] for case in shown})
            _printed(axes[row, 0], _PRINTED.get(name, {}).get(panel, []), shown)
            widen(axes[row, 0], _PANELS[panel][1])
        axes[0, 0].set_title("cylinder locked, as in the paper", fontsize=10)
        axes[0, 1].set_title("loop closed, to the same scale", fontsize=10)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=8)
        for axis in axes[-1]:
            axis.set_xlabel("time, s")
        written.append(plotting.save(figure, folder / f"{name}.png"))
    return [*written, _figure_6(study, folder / "fig6.png")]


def _panel(axis: Axes, letter: str, panel: str, runs: Mapping[str, RunTruth]) -> None:
    label, _, values = _PANELS[panel]
    for title, run in runs.items():
        axis.plot(run.t_s[::10], values(run)[::10], label=title, linewidth=1.0)
    axis.ticklabel_format(axis="y", useOffset=False)
    plotting.label(axis, y=f"{letter} {label}")


def _printed(axis: Axes, points: Sequence[tuple[str, float, float]], shown: Sequence[str]) -> None:
    """The paper's values over the curves, each in its case's colour: a cross at a time, a dotted line of a plateau."""
    if not points:
        return
    for case, t_s, value in points:
        colour = f"C{shown.index(case)}"
        if math.isinf(t_s):
            axis.axhline(value, 0.5, 1.0, color=colour, linestyle=":", linewidth=1.6)
        else:
            axis.plot(t_s, value, "X", color=colour, markeredgecolor="black", markersize=9, zorder=5)
    axis.plot([], [], "X", color="none", markeredgecolor="black", markersize=9, label="paper: peak")
    if any(math.isinf(t_s) for _, t_s, _ in points):
        axis.plot([], [], ":", color="black", linewidth=1.6, label="paper: plateau")


def _figure_6(study: PaperStudy, file: pathlib.Path) -> pathlib.Path:
    title = "Figure 6: influence of the elastic element's stiffness, 0.5 deg/s"
    figure, ((errors, lags),) = plotting.panels(1, 2, (13.0, 4.5), title)
    k = list(STIFFNESSES_N_MM)
    passive = [study.passive[stiffness(x)] for x in k]
    errors.semilogy(k, [ETA_PCT[x] for x in k], "k--x", label="paper, simulated")
    errors.semilogy(k, [float(abs(run.eta_pct(TARGET_N)).max()) for run in passive], "-o", label="ours, locked")
    errors.semilogy(k, [study.closed[stiffness(x)].eta_max_pct for x in k], "-s", label="ours, loop closed")
    lags.plot(k, [PEAK_LAG_DEG[x] for x in k], "--X", color="C0", label="paper: largest lag")
    lags.plot(k, [PLATEAU_LAG_DEG[x] for x in k], "--X", color="C1", label="paper: mean lag, plateau")
    lags.plot(k, [float(run.tangential_deg.max()) for run in passive], "-o", color="C0", label="largest lag")
    lags.plot(k, [float(run.plateau(run.tangential_deg).mean()) for run in passive], "-s", color="C1",
              label="mean lag, plateau")  # fmt: skip
    lags.set_ylim(bottom=0.0)
    for axis, words in ((errors, "largest error of vertical tension, %"), (lags, "tangential inclination, deg")):
        plotting.label(axis, "stiffness, N/mm", words)
        axis.legend(fontsize=8)
    return plotting.save(figure, file)
