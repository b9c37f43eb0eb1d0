"""Motion of a drive after its command, and of a nut on its screw. Pure functions of arrays, one value per tick."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def delayed(command: Array, delay: float) -> Array:
    """Integral in ticks of a command held over each tick, ``delay`` ticks late."""
    whole = math.ceil(delay)
    total = np.concatenate([[0.0], np.cumsum(command)])[: len(command)]
    found = total + command * (whole - delay)
    return np.concatenate([np.zeros(whole), found])[: len(command)]


def response(command: Array, share: float, delay: float) -> Array:
    """First-order response with unit gain to a command held over each tick, ``delay`` ticks late.

    ``share``: tick over lag. The response is exact for a fractional delay too.
    """
    decay = math.exp(-share)
    state, states = 0.0, []
    values: list[float] = command.tolist()
    for value in values:
        states.append(state)
        state = value + (state - value) * decay
    whole = math.ceil(delay)
    late_by = whole - delay
    held, reached = np.array(values), np.array(states)
    found = held + (reached - held) * math.exp(-share * late_by)
    return np.concatenate([np.zeros(whole), found])[: len(command)]


def behind_play(stroke: Array, play_mm: float) -> Array:
    """Position of a nut with ``play_mm`` of play, pushed by the screw from either side."""
    nut, found = float(stroke[0]), []
    half = 0.5 * play_mm
    values: list[float] = stroke.tolist()
    for value in values:
        if nut < value - half:
            nut = value - half
        elif nut > value + half:
            nut = value + half
        found.append(nut)
    return np.array(found)
