"""Style of the report's charts, and their SVG text, which is the same for the same data."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

WIDTH_IN = 7.5
BLUE, RED, TEAL, ORANGE, VIOLET, GREEN = "#1b5e9e", "#b3261e", "#00796b", "#c2620a", "#6a3fa0", "#3c7a1f"
INK, GREY, PALE, BAND = "#20262d", "#6b7580", "#d5dae0", "#dfeede"
MODE_COLOURS = {
    "DISARMED": "#c3cad2", "HOLD": "#8fb4d9", "TENSIONING": "#f1c878", "COMPENSATING": "#86bf86",
    "RELEASING": "#d9b0d9", "FAULT": "#d9534a",
}  # fmt: skip
SEVERITY_COLOURS = {"info": GREY, "warning": ORANGE, "error": RED}
_STYLE = {
    "font.family": "DejaVu Sans", "font.size": 8.0, "axes.titlesize": 8.5, "axes.titleweight": "bold",
    "axes.titlelocation": "left", "axes.labelsize": 8.0, "axes.edgecolor": GREY, "axes.linewidth": 0.7,
    "axes.labelcolor": INK, "text.color": INK, "xtick.color": GREY, "ytick.color": GREY, "xtick.labelcolor": INK,
    "ytick.labelcolor": INK, "xtick.labelsize": 7.5, "ytick.labelsize": 7.5, "axes.grid": True, "grid.color": PALE,
    "grid.linewidth": 0.5, "axes.axisbelow": True, "legend.fontsize": 7.5, "legend.frameon": True,
    "legend.framealpha": 0.85, "legend.edgecolor": PALE, "lines.linewidth": 0.8, "axes.spines.top": False,
    "axes.spines.right": False, "svg.fonttype": "path", "svg.hashsalt": "rigctl", "axes.formatter.useoffset": False,
    "path.simplify": True, "path.simplify_threshold": 0.2, "figure.constrained_layout.h_pad": 0.05,
}  # fmt: skip
_META = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)
_HEAD = re.compile(r"^.*?(?=<svg )", re.DOTALL)
_PATH = re.compile(r' d="M [^"]*"')
_DIGITS = re.compile(r"(\.\d\d)\d+")


@dataclass(frozen=True)
class Chart:
    """A drawn chart: SVG text without external references, and a text for readers who cannot see it."""

    svg: str
    caption: str


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Use this module's style, whatever the user's matplotlib settings are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)  # type: ignore[arg-type]
        yield


def figure(height_in: float) -> Figure:
    """An empty figure as wide as the page."""
    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def finished(drawn: Figure, caption: str) -> Chart:
    """The figure as SVG: no date, no external fonts, lines to a hundredth of a point."""
    out = io.StringIO()
    drawn.savefig(out, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = _META.sub("", _HEAD.sub("", out.getvalue(), count=1))
    return Chart(_PATH.sub(lambda found: _DIGITS.sub(r"\1", found[0]), text), caption)


def unit_of_time(seconds: float) -> tuple[str, float]:
    """Unit of a time axis of this length, and the divisor of seconds."""
    return ("s", 1.0) if seconds <= 300.0 else ("min", 60.0) if seconds <= 4 * 3600.0 else ("h", 3600.0)


def legend(axes: Axes, **options: Any) -> None:
    """Add a legend above the axes, where there is room."""
    axes.legend(**({"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": 4, "borderaxespad": 0.1,
                    "frameon": False, "handlelength": 1.6, "columnspacing": 1.2} | options))  # fmt: skip
