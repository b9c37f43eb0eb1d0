"""Motion of a drive after its command, and of a nut on its screw. Pure functions of arrays, one value per tick."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class HeldCommand:
    """A command held from each SYNC to the next, ``at_s``; 0 before the first. The SYNCs need not be evenly spaced."""

    def __init__(self, command: Array, at_s: Array) -> None:
        self._command, self._at_s = command, at_s
        self._gaps_s = np.diff(at_s)
        self._passed = np.concatenate([[0.0], np.cumsum(command[:-1] * self._gaps_s)])
        self._lag_s, self._states = 0.0, command  # of the last response, at each SYNC

    def integral(self, when_s: Array) -> Array:
        """Integral of the command up to each time."""
        at = self._held_at(when_s)
        found = self._passed[at] + self._command[at] * (when_s - self._at_s[at])
        return np.where(when_s < self._at_s[0], 0.0, found)

    def response(self, lag_s: float, when_s: Array) -> Array:
        """First-order response with unit gain at each time."""
        if lag_s != self._lag_s:
            self._lag_s, self._states = lag_s, self._states_of(lag_s)
        at = self._held_at(when_s)
        held = self._command[at]
        found = held + (self._states[at] - held) * np.exp((self._at_s[at] - when_s) / lag_s)
        return np.where(when_s < self._at_s[0], 0.0, found)

    def _states_of(self, lag_s: float) -> Array:
        state, states = 0.0, [0.0]
        values, decays = self._command.tolist(), np.exp(self._gaps_s * (-1.0 / lag_s)).tolist()
        for value, decay in zip(values, decays, strict=False):
            state = value + (state - value) * decay
            states.append(state)
        return np.array(states)

    def _held_at(self, when_s: Array) -> npt.NDArray[np.intp]:
        return np.maximum(np.searchsorted(self._at_s, when_s, side="right") - 1, 0)


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
