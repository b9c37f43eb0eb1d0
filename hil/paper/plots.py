"""The study's plots, laid out like the paper's figures: locked on the left, with the loop closed beside it."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Mapping, Sequence

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from hil.paper.cases import FIGURE_9, NO_SPRING, SPEEDS_DEG_S, STIFFNESSES_N_MM, cases, speed, stiffness
from hil.paper.claims import ETA_PCT, TARGET_N
from hil.paper.signals import Floats, Signals
from hil.paper.study import Study
from rigctl.ipc import output_file

_PANELS: dict[str, tuple[str, Callable[[Signals], Floats]]] = {
    "vertical": ("vertical tension, N", lambda run: run.vertical_n),
    "tangential": ("tangential inclination, deg", lambda run: run.tangential_deg),
    "normal": ("normal inclination, deg", lambda run: run.normal_deg),
    "pulley": ("pulley displacement, mm", lambda run: run.pulley_mm),
    "tension": ("tension in the rope, N", lambda run: run.tension_n),
}
_FIGURES: dict[str, tuple[str, Sequence[str], Sequence[str]]] = {
    "fig4": (
        "Figure 4: with (k = 6 N/mm) and without (k = 1000 N/mm) an elastic element",
        (stiffness(6.0), NO_SPRING),
        ("vertical", "normal", "tangential", "pulley"),
    ),
    "fig5": (
        "Figure 5: stiffness of the elastic element, 0.5 deg/s",
        tuple(map(stiffness, STIFFNESSES_N_MM)),
        ("vertical", "tangential", "normal", "pulley"),
    ),
    "fig7": (
        "Figure 7: deployment speed, k = 6 N/mm",
        tuple(map(speed, SPEEDS_DEG_S)),
        ("vertical", "tangential", "normal", "pulley"),
    ),
    "fig9": (
        "Figure 9: 13 deg out and back, with errors of level and vibration",
        (FIGURE_9,),
        ("tension", "vertical", "tangential", "normal"),
    ),
}


FIRST = "fig4.png"


def save(study: Study, folder: pathlib.Path) -> list[pathlib.Path]:
    """Write one PNG per figure; returns their names.

    Raises:
        OutputError: the folder cannot be written.
    """
    titles = {case.name: case.title for case in cases()}
    closed = {name: run.signals for name, run in study.closed.items()}
    written = []
    for name, (title, shown, panels) in _FIGURES.items():
        figure, axes = plt.subplots(len(panels), 2, figsize=(13, 3.0 * len(panels)), sharex=True, layout="constrained")
        figure.suptitle(title)
        for row, panel in enumerate(panels):
            for column, runs in enumerate((study.passive, closed)):
                _panel(axes[row, column], f"({'abcd'[row]})", panel, {titles[case]: runs[case] for case in shown})
        axes[0, 0].set_title("cylinder locked, as in the paper", fontsize=10)
        axes[0, 1].set_title("loop closed", fontsize=10)
        axes[0, 0].legend(fontsize=8, loc="lower right")
        for axis in axes[-1]:
            axis.set_xlabel("time, s")
        written.append(folder / f"{name}.png")
        with output_file.writing(written[-1]):
            figure.savefig(written[-1], dpi=110)
        plt.close(figure)
    written.append(folder / "fig6.png")
    _figure_6(study, written[-1])
    return written


def _panel(axis: Axes, letter: str, panel: str, runs: Mapping[str, Signals]) -> None:
    label, values = _PANELS[panel]
    for title, run in runs.items():
        axis.plot(run.t_s[::10], values(run)[::10], label=title, linewidth=1.0)
    axis.set_ylabel(f"{letter} {label}", fontsize=9)
    axis.ticklabel_format(axis="y", useOffset=False)
    axis.grid(visible=True, alpha=0.3)


def _figure_6(study: Study, file: pathlib.Path) -> None:
    figure, (errors, lags) = plt.subplots(1, 2, figsize=(13, 4.5), layout="constrained")
    figure.suptitle("Figure 6: influence of the elastic element's stiffness, 0.5 deg/s")
    k = list(STIFFNESSES_N_MM)
    passive = [study.passive[stiffness(x)] for x in k]
    errors.semilogy(k, [ETA_PCT[x] for x in k], "k--x", label="paper, simulated")
    errors.semilogy(k, [float(abs(run.eta_pct(TARGET_N)).max()) for run in passive], "-o", label="ours, locked")
    errors.semilogy(k, [study.closed[stiffness(x)].eta_max_pct for x in k], "-s", label="ours, loop closed")
    errors.set_ylabel("largest error of vertical tension, %")
    lags.plot(k, [float(run.tangential_deg.max()) for run in passive], "-o", label="largest lag")
    lags.plot(k, [float(run.plateau(run.tangential_deg).mean()) for run in passive], "-s", label="mean lag, plateau")
    lags.set_ylabel("tangential inclination, deg")
    for axis in (errors, lags):
        axis.set_xlabel("stiffness, N/mm")
        axis.grid(visible=True, alpha=0.3)
        axis.legend(fontsize=8)
    with output_file.writing(file):
        figure.savefig(file, dpi=110)
    plt.close(figure)
