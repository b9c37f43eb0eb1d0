"""Predict and update of a linear Kalman filter, in Joseph's form of the covariance; its settled covariance.

The operations and their order are those of ``filterpy.kalman.KalmanFilter``, with which the tests compare it to
the last bit. That library is not imported here: every process of the daemon would load ``scipy.stats`` at its start,
which takes longer than the rest together.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class KalmanFilter:
    """State and covariance, with the gain and the innovation's covariance of the last update.

    Attributes:
        x: state, (n, 1); ``p`` its covariance, (n, n); ``p_prior`` the same as of the last predict.
        f, q: transition and process noise (n, n) of one step.
        h, r: measurement (m, n) and its noise (m, m).
        k, s: gain (n, m) and covariance of the innovation (m, m) of the last update.
    """

    def __init__(self, h: Array, r: Array) -> None:
        measured, states = h.shape
        self.h, self.r = h, r
        self._eye = self.f = np.eye(states)
        self.p, self.q = np.eye(states), np.eye(states)
        self.p_prior = self.p
        self.x: Array = np.zeros((states, 1))
        self.k: Array = np.zeros((states, measured))
        self.s: Array = np.zeros((measured, measured))

    def predict(self) -> None:
        """Carry state and covariance on by one step."""
        self.x = np.dot(self.f, self.x)
        self.p = np.dot(np.dot(self.f, self.p), self.f.T) + self.q
        self.p_prior = self.p

    def update(self, z: Array) -> None:
        """Correct with a measurement, (m, 1)."""
        innovation = z - np.dot(self.h, self.x)
        pht = np.dot(self.p, self.h.T)
        self.s = np.dot(self.h, pht) + self.r
        self.k = np.dot(pht, np.linalg.inv(self.s))
        self.x = self.x + np.dot(self.k, innovation)
        left = self._eye - np.dot(self.k, self.h)
        self.p = np.dot(np.dot(left, self.p), left.T) + np.dot(np.dot(self.k, self.r), self.k.T)


TERMS = 20  # of the exponential's series, for a norm of at most 1/2: the next one is below the rounding
DOUBLINGS = 40  # 2^40 steps
STATIONARY_DOUBLINGS = 24  # 2^24 ticks are hours at the slowest rate, in which the slowest mode dies out


def exponential(a: Array) -> Array:
    """Matrix exponential by its series with scaling and squaring (scipy's takes 0.1 s to import)."""
    halvings = max(0, 1 + int(np.ceil(np.log2(max(np.abs(a).sum(axis=1).max(), 1e-300)))))
    small = a / 2.0**halvings
    term = total = np.eye(len(a))
    for n in range(1, TERMS):
        term = term @ small / n
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


def settled_covariance(f: Array, h: Array, q: Array, r: Array) -> Array:
    """Covariance before an update to which the filter settles, by doubling.

    Each pass doubles the number of steps: structure-preserving doubling algorithm (Chu, Fan, Lin, Wang, Int. J. Control
    77 (2004), 767-788). The design computes the same by SciPy; a test compares them.
    """
    eye = np.eye(len(f))
    a, g, p = f.T, h.T @ np.linalg.solve(r, h), q
    for _ in range(DOUBLINGS):
        inner = np.linalg.solve(eye + g @ p, np.hstack([a, g @ a.T]))
        step, spread = inner[:, : len(f)], inner[:, len(f) :]
        more = a.T @ p @ step
        a, g, p = a @ step, g + a @ spread, p + 0.5 * (more + more.T)
        if np.abs(more).max() <= 1e-15 * np.abs(p).max():
            break
    return np.asarray(p)


def stationary_covariance(a: Array, q: Array) -> Array:
    """Covariance of ``x' = a x + noise`` with noise covariance ``q``, of a stable ``a``.

    The sum of ``a^i q a^iT`` by doubling; unlike scipy's bilinear solver it cannot become negative by rounding.
    """
    total, power = q, a
    for _ in range(STATIONARY_DOUBLINGS):
        total = total + power @ total @ power.T
        power = power @ power
    return total
