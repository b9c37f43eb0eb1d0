"""How far the filter is open: quiet while nothing happens, open within a tick of a surprise.

At rest the innovations are the sensors' noise and what the filter makes of it: their mean m over a short time has a
variance s_m^2 that follows from the filter's gain alone (`rest_variances`; the larger one of both settings). A
disturbance that the filter does not follow shows as a mean. The filter is open by

    level = max(min(((m / s_m)^2 - sigma^2) / sigma^2, 1), kept level),  0 <= level <= 1

the chart of the exponentially weighted mean (Roberts, Technometrics 1 (1959), 239-250) with the variance of correlated
samples. It opens in one tick and becomes quiet again over a time constant, so that a swing keeps it open. The level may
change in any way: the design refuses a loop without a Lyapunov function that is common to all levels
(`rigctl.design.switching`).
"""

from __future__ import annotations

import math

import numpy as np

from rigctl.control.law.kalman import Array, stationary_covariance

FULL = 2.0  # (m / s_m)^2 is this many times sigma^2 where the filter is wholly open
LEAST = 1e-3  # below this the filter is quiet


def mean_share(window_ticks: float) -> float:
    """Share of the newest sample in an exponential mean."""
    return -math.expm1(-1.0 / window_ticks)


def rest_variances(f: Array, gain: Array, r: Array, window_ticks: float) -> tuple[float, float]:
    """Variances of the tension's innovation and of its mean, of a filter with a fixed gain and nothing but noise r.

    Shapes: (n, n), (n, 2), (2, 2).
    """
    n, share = len(f), mean_share(window_ticks)
    h = np.eye(2, n)
    a, b = np.zeros((n + 1, n + 1)), np.zeros((n + 1, 2))
    a[:n, :n] = f @ (np.eye(n) - gain @ h)  # of the error before an update; the last row is the mean
    a[n, :n], a[n, n] = share * h[0], 1.0 - share
    b[:n], b[n, 0] = -f @ gain, share
    found = stationary_covariance(a, b @ r @ b.T)
    return float(found[0, 0] + r[0, 0]), float(found[n, n])


class Opening:
    """The level of opening, from the tension's innovation of each tick.

    Args:
        window: of the mean, in ticks.
        sigma: standard deviations of the mean at which the filter begins to open.
        keep: time constant of becoming quiet again, in ticks.
        mean_variance_n2: of the mean at rest.
    """

    __slots__ = ("_begin", "_keep", "_mean", "_share", "_slope", "level")

    def __init__(self, window: float, sigma: float, keep: float, mean_variance_n2: float) -> None:
        self._share = mean_share(window)
        self._begin = sigma * sigma * mean_variance_n2
        self._slope = 1.0 / ((FULL - 1.0) * self._begin)
        self._keep = math.exp(-1.0 / keep)
        self._mean = 0.0
        self.level = 1.0
        """0 = quiet, 1 = open."""

    def open(self) -> None:
        """Open wholly: the filter starts again, or a sample was a surprise or is missing."""
        self._mean, self.level = 0.0, 1.0

    def close(self) -> None:
        """Quiet at once, as after a long time at rest."""
        self.level = 0.0

    def look(self, innovation_n: float) -> None:
        """Take the innovation of this tick."""
        mean = self._mean = self._mean + self._share * (innovation_n - self._mean)
        wanted = (mean * mean - self._begin) * self._slope
        level = self.level * self._keep
        if wanted > level:
            level = wanted if wanted < 1.0 else 1.0
        self.level = level if level > LEAST else 0.0
