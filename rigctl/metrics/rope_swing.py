"""The swing of the rope's stretch in a recording: frequency and damping for `estimator.swing_hz` and `swing_damping`.

The speed at which the rope is stretched is what the filter found of it and what inclination and run-out table gave.
From its largest value in a phase on, that is fitted by a damped oscillation about a line,

    s(t) = exp(-zeta w t) (A cos w_d t + B sin w_d t) + C + D t,    w_d = w sqrt(1 - zeta^2)

whose w and zeta alone are not linear: the least sum of squares on a grid of both, made finer about its least
(variable projection: Golub, Pereyra, SIAM J. Numer. Anal. 10 (1973), 413-432).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rigctl.metrics.phases import JudgedPhase

SIGNALS = ("disturbance_mm_s", "stretch_mm_s", "run_out_mm_s")
EVERY_S = 0.2
"""Means over this time are fitted: fast enough for 1.5 Hz, and of the cell's noise little is left."""
LEAST_S, MOST_S = 4.0, 12.0
"""Of a fit: two periods at 0.5 Hz; later the swing has died out."""
HZ, DAMPING = (0.2, 1.5), (0.002, 0.7)
GRID, FINER = 24, 6
"""Points of each side, and how often the grid is made finer about the least: by three each time."""
EXPLAINED = 0.7
"""Least share of the variance about a line that a swing explains, else there is none to speak of."""
Floats = npt.NDArray[np.float64]


class RopeSwing(NamedTuple):
    """A swing in a phase."""

    phase: int
    hz: float
    damping: float
    largest_mm_s: float
    explained: float
    """Share of the variance, 0 to 1."""

    def in_words(self) -> str:
        """``0.57 Hz, damping 0.05, 0.08 mm/s in phase 1``."""
        return f"{self.hz:.2g} Hz, damping {self.damping:.2g}, {self.largest_mm_s:.2g} mm/s in phase {self.phase}"


def rope_swing(records: npt.NDArray[Any], phases: Iterable[JudgedPhase], rate_hz: float) -> RopeSwing | None:
    """The swing of the phase in which it explains most of the stretch's speed; None where there is none."""
    if not set(SIGNALS) <= set(records.dtype.names or ()):
        return None
    found = [swing for phase in phases if (swing := _in_phase(records, phase, rate_hz)) is not None]
    return max(found, key=lambda swing: swing.explained, default=None)


def _in_phase(records: npt.NDArray[Any], phase: JudgedPhase, rate_hz: float) -> RopeSwing | None:
    part = records[phase.judged]
    speed: Floats = np.sum([np.nan_to_num(part[name]) for name in SIGNALS], axis=0)
    block = round(EVERY_S * rate_hz)
    means = speed[: len(speed) // block * block].reshape(-1, block).mean(axis=1)
    if len(means) < round(LEAST_S / EVERY_S):
        return None
    begin = int(np.argmax(np.abs(means[: len(means) - round(LEAST_S / EVERY_S) + 1])))
    fitted = means[begin : begin + round(MOST_S / EVERY_S)]
    t_s: Floats = np.arange(len(fitted), dtype=np.float64) * EVERY_S
    hz, damping = HZ, DAMPING
    for _ in range(FINER):
        grid = np.meshgrid(np.geomspace(*hz, GRID), np.geomspace(*damping, GRID))
        pairs = np.asarray(np.stack(grid, axis=-1).reshape(-1, 2), np.float64)
        left = _left(t_s, pairs, fitted)
        least = int(np.argmin(left))
        best_hz, best_damping = pairs[least].tolist()
        hz, damping = _about(best_hz, hz, HZ), _about(best_damping, damping, DAMPING)
    line = np.polynomial.Polynomial.fit(t_s, fitted, 1)
    about = float(np.sum((fitted - line(t_s)) ** 2))
    explained = 1.0 - float(left[least]) / about if about > 0.0 else 0.0
    if explained < EXPLAINED:
        return None
    return RopeSwing(phase.number, best_hz, best_damping, float(np.abs(fitted).max()), explained)


def _left(t_s: Floats, pairs: Floats, values: Floats) -> Floats:
    """Sum of squares that the fit leaves for each pair of frequency and damping, shapes (n, 2) and (n,)."""
    w, damping = 2.0 * math.pi * pairs[:, :1], pairs[:, 1:]
    fall, angle = np.exp(-damping * w * t_s), w * np.sqrt(1.0 - damping**2) * t_s
    ones = np.ones_like(fall)
    columns = np.stack([fall * np.cos(angle), fall * np.sin(angle), ones, ones * t_s], axis=1)
    inside = np.linalg.solve(columns @ columns.transpose(0, 2, 1), (columns @ values)[:, :, None])
    fits = (columns * inside).sum(axis=1)
    left: Floats = np.sum((values - fits) ** 2, axis=1)
    return left


def _about(at: float, ends: tuple[float, float], limits: tuple[float, float]) -> tuple[float, float]:
    """A third of the range between the ends, about a value."""
    reach = (ends[1] / ends[0]) ** (1.0 / 6.0)
    return max(at / reach, limits[0]), min(at * reach, limits[1])
