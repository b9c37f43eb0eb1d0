"""A run as stretches: how far the load is, N, from where the modes mean it to be."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.faults.judging.judge import away_n
from rigctl.model.states import Mode

STOP_S = 0.15
"""Stated time from a reaction to standstill: ramp, lag and brake."""
RETURNS_S = 1.0
"""The law brings the load back within it from what the rope has given."""

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
KEEPS = (Mode.DISARMED, Mode.HOLD, Mode.FAULT)


class IntentionRows(NamedTuple):
    """Rows of one intention: a mode that moves the stroke, or all modes in a row that keep it in place."""

    begin: int
    end: int
    keeps: bool


class Deviation(NamedTuple):
    """Of each row, N: ``off`` where the load is meant to be; ``own``: what brake and rope have given of themselves."""

    off: Floats
    own: Floats
    stretches: list[IntentionRows]


def keeping(mode: npt.NDArray[Any]) -> Flags:
    """Whether each row's mode keeps the stroke in place."""
    return np.isin(mode, KEEPS)


def parts(values: npt.NDArray[Any]) -> list[tuple[int, int]]:
    """Rows from and to of each stretch of one value."""
    return list(itertools.pairwise([0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]))


def own_mm(rows: npt.NDArray[Any]) -> tuple[Floats, Floats]:
    """Way that the closed brake, and the rope, have given by themselves since power-on."""
    brake = np.abs(np.diff(rows["stroke_mm"], prepend=rows["stroke_mm"][0]))
    brake[~(rows["braked"] & ~rows["powered"])] = 0.0
    rope = np.abs(np.diff(rows["free_mm"], prepend=rows["free_mm"][0]))
    return np.cumsum(brake), np.cumsum(rope)


def deviation(
    rows: npt.NDArray[Any], twin: npt.NDArray[Any], k: float, target_n: float, allowed_n: float, period_s: float
) -> Deviation:
    """Where the load is against where it is meant to be; ``twin``: rows of the run without the fault.

    A stroke is kept where the load was when the keeping began: how far off it was then goes on to count. On the way
    to a standstill it may move by ``allowed_n``.
    """
    off, own = np.zeros(len(rows)), np.zeros(len(rows))
    brake_mm, rope_mm = own_mm(rows)
    stroke, tension = rows["stroke_mm"], rows["tension_n"]
    same = rows["mode"] == twin["mode"]
    stretches = _stretches(rows["mode"])
    for begin, end, keeps in stretches:
        part = slice(begin, end)
        if keeps:
            settled = min(begin + (round(STOP_S / period_s) if begin else 0), end - 1)
            base_n, own_n = (off[begin - 1], own[begin - 1]) if begin else (0.0, 0.0)
            way_n = k * (stroke[settled] - stroke[begin])
            kept = base_n + way_n - np.clip(way_n, -allowed_n, allowed_n) + k * (stroke[part] - stroke[settled])
            kept[: settled - begin] = base_n
            beside = k * (stroke[part] - twin["stroke_mm"][part])  # a trial in HOLD moves the stroke of both
            off[part] = np.where(same[part] & (np.abs(beside) < np.abs(kept)), beside, kept)
            own[part] = own_n + k * (brake_mm[part] - brake_mm[begin])
        elif (mode := Mode(int(rows["mode"][begin]))) is Mode.COMPENSATING:
            off[part] = tension[part] - np.where(same[part], twin["tension_n"][part], target_n)
            before = np.maximum(np.arange(begin, end) - round(RETURNS_S / period_s), begin)
            own[part] = k * (rope_mm[part] - rope_mm[before])
        else:
            rises = mode is Mode.TENSIONING
            low, high = (tension[begin], max(tension[begin], target_n)) if rises else (0.0, tension[begin])
            off[part] = np.maximum(tension[part] - high, 0.0) - np.maximum(low - tension[part], 0.0)
            own[part] = k * (rope_mm[part] - rope_mm[begin])
    return Deviation(off, own, stretches)


def _stretches(mode: npt.NDArray[Any]) -> list[IntentionRows]:
    keeps = keeping(mode)
    return [
        IntentionRows(begin, end, bool(keeps[begin])) for begin, end in parts(np.where(keeps, -1, mode.astype(int)))
    ]


def moved(found: Deviation, first: int, stop: int) -> Floats:
    """Way of the load, N, from row ``first`` on, without what brake and rope have given.

    A law that regulates brings the load back: there, what leads back is no motion. Nothing else may move it.
    """
    moved_n = np.zeros(max(stop - first, 0))
    before_n = 0.0
    for stretch in found.stretches:
        begin, end = max(stretch.begin, first), min(stretch.end, stop)
        if begin >= end:
            continue
        off, own = found.off[begin:end], found.own[begin:end]
        from_n = off[0]
        way = np.abs(off - from_n) if stretch.keeps else away_n(off, from_n)
        way = np.maximum(way - np.maximum(own - own[0], 0.0), 0.0)
        moved_n[begin - first : end - first] = way + (before_n if stretch.keeps else 0.0)
        before_n = float(moved_n[end - first - 1])
    return moved_n
