"""First-order low-pass in continuous time, sampled at any times."""

from __future__ import annotations

import math


class LowPass:
    """``tau dy/dt = x - y``, exact for an input that is a straight line between updates.

    Args:
        tau_s: time constant, > 0.
        value: input and output at the start.
    """

    __slots__ = ("_input", "_tau_s", "value")

    def __init__(self, tau_s: float, value: float = 0.0) -> None:
        self._tau_s = tau_s
        self._input = value
        self.value = value

    def update(self, value: float, elapsed_s: float) -> float:
        """The output, ``elapsed_s`` after the last update, with the input now at ``value``; 0 s changes nothing."""
        if elapsed_s > 0.0:
            ratio = elapsed_s / self._tau_s
            reached = -math.expm1(-ratio)
            lag = self._input - self.value
            self.value = value - (value - self._input) * reached / ratio - lag * (1.0 - reached)
            self._input = value
        return self.value


def time_constant_s(corner_hz: float) -> float:
    """Time constant of a first-order low-pass that is 3 dB down at ``corner_hz``."""
    return 1.0 / (2.0 * math.pi * corner_hz)
