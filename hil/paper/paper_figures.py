"""The study's pictures, laid out like the paper's figures: locked on the left, with the loop closed beside it."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from hil.paper.cases import FIGURE_9, NO_SPRING, SPEEDS_DEG_S, cases, speed, stiffness
from hil.paper.claims import ETA_PCT, TARGET_N
from hil.paper.paper_study import PaperStudy
from hil.paper.run_truth import Floats, RunTruth
from hil.study import plotting
from hil.study.planned_run import STIFFNESSES_N_MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANELS: dict[str, tuple[str, Callable[[RunTruth], Floats]]] = {
    "vertical": ("vertical tension, N", lambda run: run.vertical_n),
    "tangential": ("tangential inclination, deg", lambda run: run.tangential_deg),
    "normal": ("normal inclination, deg", lambda run: run.normal_deg),
    "pulley": ("pulley displacement, mm", lambda run: run.pulley_mm),
    "tension": ("tension in the rope, N", lambda run: run.tension_n),
}
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
        figure, axes = plotting.panels(len(names), 2, (13.0, 3.0 * len(names)), title, sharex=True)
        for row, panel in enumerate(names):
            for axis, runs in zip(axes[row], (study.passive, closed), strict=True):
                _panel(axis, f"({'abcd'[row]})", panel, {titles[case]: runs[case] for case in shown})
        axes[0, 0].set_title("cylinder locked, as in the paper", fontsize=10)
        axes[0, 1].set_title("loop closed", fontsize=10)
        axes[0, 0].legend(fontsize=8, loc="lower right")
        for axis in axes[-1]:
            axis.set_xlabel("time, s")
        written.append(plotting.save(figure, folder / f"{name}.png"))
    return [*written, _figure_6(study, folder / "fig6.png")]


def _panel(axis: Axes, letter: str, panel: str, runs: Mapping[str, RunTruth]) -> None:
    label, values = _PANELS[panel]
    for title, run in runs.items():
        axis.plot(run.t_s[::10], values(run)[::10], label=title, linewidth=1.0)
    axis.ticklabel_format(axis="y", useOffset=False)
    plotting.label(axis, y=f"{letter} {label}")


def _figure_6(study: PaperStudy, file: pathlib.Path) -> pathlib.Path:
    title = "Figure 6: influence of the elastic element's stiffness, 0.5 deg/s"
    figure, ((errors, lags),) = plotting.panels(1, 2, (13.0, 4.5), title)
    k = list(STIFFNESSES_N_MM)
    passive = [study.passive[stiffness(x)] for x in k]
    errors.semilogy(k, [ETA_PCT[x] for x in k], "k--x", label="paper, simulated")
    errors.semilogy(k, [float(abs(run.eta_pct(TARGET_N)).max()) for run in passive], "-o", label="ours, locked")
    errors.semilogy(k, [study.closed[stiffness(x)].eta_max_pct for x in k], "-s", label="ours, loop closed")
    lags.plot(k, [float(run.tangential_deg.max()) for run in passive], "-o", label="largest lag")
    lags.plot(k, [float(run.plateau(run.tangential_deg).mean()) for run in passive], "-s", label="mean lag, plateau")
    for axis, words in ((errors, "largest error of vertical tension, %"), (lags, "tangential inclination, deg")):
        plotting.label(axis, "stiffness, N/mm", words)
        axis.legend(fontsize=8)
    return plotting.save(figure, file)
