"""Plot of two commands on one time axis: the one given, and the one of other settings."""

from __future__ import annotations

import pathlib

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from rigctl.replay.compare import Against

POINTS = 4000
LEAST_MM_S = 1.0  # half span of each axis, so that rounding does not fill the picture
Floats = npt.NDArray[np.float64]


def draw(found: Against, file: pathlib.Path, title: str, limit_mm_s: float) -> None:
    """Write the picture in the format of its name's suffix; ``limit_mm_s``: of the speed, by the other settings.

    Raises:
        OutputError: it cannot be written.
    """
    from rigctl.ipc import output_file

    t_ns = np.concatenate(found.t_ns)
    then, now = np.concatenate(found.then_mm_s), np.concatenate(found.now_mm_s)
    t_s = (t_ns - t_ns[0]) * 1e-9
    figure = Figure(figsize=(10, 6), layout="constrained")
    figure.suptitle(title, fontsize=11)
    above, below = figure.subplots(2, 1, sharex=True)
    for values, label, colour in ((then, "commanded then", "tab:blue"), (now, "other settings", "tab:orange")):
        above.plot(*_envelope(t_s, values), label=label, color=colour, linewidth=0.8)
    above.set_ylabel("command, mm/s")
    above.legend(loc="upper right")
    for bound in (-limit_mm_s, limit_mm_s):
        above.axhline(bound, color="tab:red", linestyle="--", linewidth=0.8)
    above.annotate(
        f"tension.speed_max_mm_s {limit_mm_s:g}", (0.01, limit_mm_s), xycoords=("axes fraction", "data"),
        xytext=(0, 2), textcoords="offset points", fontsize=8, color="tab:red", annotation_clip=True,
    )  # fmt: skip
    shown = max(LEAST_MM_S, 1.1 * float(np.max(np.abs(np.concatenate([then, now])), initial=0.0)))
    above.set_ylim(-shown, shown)
    below.plot(*_envelope(t_s, now - then), color="tab:red", linewidth=0.8)
    below.set_ylabel("difference, mm/s")
    apart = max(LEAST_MM_S, 1.1 * float(np.max(np.abs(now - then), initial=0.0)))
    below.set_ylim(-apart, apart)
    below.set_xlabel("time, s")
    for axis in (above, below):
        axis.grid(visible=True, alpha=0.3)
    with output_file.writing(file):
        figure.savefig(file)


def _envelope(t_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Least and largest of every few samples, so that no spike is lost."""
    step = max(1, 2 * len(values) // POINTS)
    whole = len(values) // step * step
    parts = values[:whole].reshape(-1, step)
    pairs = np.stack([parts.min(axis=1), parts.max(axis=1)], axis=1).ravel()
    return np.repeat(t_s[:whole:step], 2), pairs
