"""Long signals as lines for a chart: least and largest of every few samples, so that no spike is lost."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
BREAK_S = 0.05
"""A line is broken at a gap in the records of this length."""


def trace(t_s: npt.ArrayLike, values: npt.NDArray[Any], points: int) -> tuple[Floats, Floats]:
    """About ``points`` points that look like all samples; NaN where the line is broken.

    Args:
        t_s: times in s, rising, shape (n,).
        values: shape (n,), any number type.
        points: number of points over all pieces.
    """
    times, y = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    if not len(times):
        return times, y
    cuts = [0, *(np.flatnonzero(np.diff(times) > BREAK_S) + 1).tolist(), len(times)]
    pieces_t: list[Floats] = []
    pieces_y: list[Floats] = []
    for start, after in itertools.pairwise(cuts):
        share = max(4, round(points * (after - start) / len(times)))
        x, low_high = _envelope(times[start:after], y[start:after], share)
        pieces_t += [x, x[-1:]]
        pieces_y += [low_high, np.array([np.nan])]
    return np.concatenate(pieces_t[:-1]), np.concatenate(pieces_y[:-1])


def _envelope(t_s: Floats, y: Floats, points: int) -> tuple[Floats, Floats]:
    """Least and largest of each segment in order of occurrence, drawn at the segment's beginning and middle."""
    step = 2 * len(y) // points
    if step <= 2:
        return t_s, y
    starts = np.arange(0, len(y), step)
    low, high = np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)
    first = y[starts]
    up = np.abs(first - low) <= np.abs(high - first)
    pairs = np.stack([np.where(up, low, high), np.where(up, high, low)], axis=1).ravel()
    middles = np.minimum(starts + step // 2, len(y) - 1)
    times = np.stack([t_s[starts], t_s[middles]], axis=1).ravel()
    return times, pairs
