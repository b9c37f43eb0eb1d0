"""Pictures of the studies, in one style."""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING, Any

from rigctl.ipc import output_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DOTS_PER_INCH = 110


def panels(
    rows: int, columns: int, size_inches: tuple[float, float], title: str = "", **shared: Any
) -> tuple[Figure, Any]:
    """An empty figure and its axes, shape (rows, columns); ``shared`` as in ``Figure.subplots``."""
    from matplotlib.figure import Figure  # 0.5 s: only where a picture is drawn

    figure = Figure(figsize=size_inches, layout="constrained")
    if title:
        figure.suptitle(title)
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def label(axis: Axes, /, x: str = "", y: str = "", **grid: Any) -> None:
    """Labels of an axis, with a grid."""
    axis.set_xlabel(x, fontsize=9)
    axis.set_ylabel(y, fontsize=9)
    axis.grid(visible=True, **{"alpha": 0.3, **grid})


def save(figure: Figure, file: pathlib.Path) -> pathlib.Path:
    """Write a figure; returns its name.

    Raises:
        OutputError: the file cannot be written.
    """
    with output_file.writing(file):
        figure.savefig(file, dpi=DOTS_PER_INCH)
    return file
