"""Plot of two commands on one time axis: the one given, and the one of other settings."""

from __future__ import annotations

import pathlib

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from rigctl.replay.compare import Against

POINTS = 4000
Floats = npt.NDArray[np.float64]


def draw(found: Against, file: pathlib.Path) -> None:
    """Write the picture in the format of its name's suffix.

    Raises:
        OutputError: it cannot be written.
    """
    from rigctl.ipc import output_file

    t_ns = np.concatenate(found.t_ns)
    then, now = np.concatenate(found.then_mm_s), np.concatenate(found.now_mm_s)
    t_s = (t_ns - t_ns[0]) * 1e-9
    figure = Figure(figsize=(10, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for values, label, colour in ((then, "commanded then", "tab:blue"), (now, "other settings", "tab:orange")):
        above.plot(*_envelope(t_s, values), label=label, color=colour, linewidth=0.8)
    above.set_ylabel("command, mm/s")
    above.legend(loc="upper right")
    below.plot(*_envelope(t_s, now - then), color="tab:red", linewidth=0.8)
    below.set_ylabel("difference, mm/s")
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
