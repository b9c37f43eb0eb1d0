"""Predict and update of a linear Kalman filter, in Joseph's form of the covariance.

The operations and their order are those of ``filterpy.kalman.KalmanFilter``, with which the tests compare it to
the last bit. That library is not imported here: every process of the daemon would load ``scipy.stats`` at its start,
which takes longer than the rest together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def _inverse(s: Array) -> Array:
    return np.asarray(np.linalg.inv(s))


class KalmanFilter:
    """State and covariance, with the gain and the innovation's covariance of the last update.

    Attributes:
        x: state, (n, 1); ``p`` its covariance, (n, n); ``p_prior`` the same as of the last predict.
        f, b, q: transition (n, n), input (n, u) and process noise (n, n) of one step.
        h, r: measurement (m, n) and its noise (m, m).
        k, s: gain (n, m) and covariance of the innovation (m, m) of the last update.
    """

    def __init__(self, h: Array, r: Array, inverse: Callable[[Array], Array] = _inverse) -> None:
        """``inverse``: of the innovation's covariance."""
        measured, states = h.shape
        self.h, self.r, self._inverse = h, r, inverse
        self._eye = self.f = np.eye(states)
        self.p, self.q = np.eye(states), np.eye(states)
        self.p_prior = self.p
        self.b: Array = np.zeros((states, 1))
        self.x: Array = np.zeros((states, 1))
        self.k: Array = np.zeros((states, measured))
        self.s: Array = np.zeros((measured, measured))

    def predict(self, u: float | None = None) -> None:
        """Carry state and covariance on by one step, under the input ``u``."""
        self.x = np.dot(self.f, self.x) if u is None else np.dot(self.f, self.x) + np.dot(self.b, u)
        self.p = np.dot(np.dot(self.f, self.p), self.f.T) + self.q
        self.p_prior = self.p

    def update(self, z: Array, rows: slice = slice(None)) -> None:
        """Correct with a measurement, (m, 1); with ``rows``, ``z`` has only these."""
        h, r = self.h[rows], self.r[rows, rows]
        innovation = z - np.dot(h, self.x)
        pht = np.dot(self.p, h.T)
        self.s = np.dot(h, pht) + r
        self.k = np.dot(pht, self._inverse(self.s))
        self.x = self.x + np.dot(self.k, innovation)
        left = self._eye - np.dot(self.k, h)
        self.p = np.dot(np.dot(left, self.p), left.T) + np.dot(np.dot(self.k, r), self.k.T)
