"""Kalman filter of the rope's inclination, and the speed at which that inclination stretches the rope.

Per axis ``x = [angle rad, rate rad/s]`` with white angular acceleration. Samples come at the inclinometer's own rate,
10 to 100 Hz; between them the angle continues at the last estimated rate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import Array
from rigctl.control.law.gate import Gate
from rigctl.control.law.kalman import KalmanFilter

BURST_RAD_S = math.radians(5.0)
"""Change of rate within a sample interval that the gate allows, one sigma, as of a rope that is struck."""
MOST_AHEAD_S = 0.1
"""Longest extrapolation of the angle without a sample."""
SETTLED_GAIN = 1e-9  # relative change of the gain from one sample to the next below which it counts as settled


class _SettledSlope(NamedTuple):
    """Samples at one interval: gain on angle and rate, variance of the innovation, covariance before an update."""

    ticks: int
    angle: float
    rate: float
    variance: float
    prior: Array


class InclinationFilter:
    """Tangential and normal angle with their rates; both axes share one gain, and their samples are judged together.

    `KalmanFilter` carries state and covariance until the gain has settled at the samples' interval; from then on that
    gain gives the same numbers in plain floats, in a fiftieth of the time. Another interval goes back to it.
    """

    def __init__(self, settings: RigSettings) -> None:
        noise, self._dt = settings.estimator, 1.0 / settings.loop.rate_hz
        self._walk2 = math.radians(noise.inclination_walk_deg_s) ** 2
        variance = np.eye(2) * math.radians(noise.inclination_noise_deg) ** 2
        self._kf = KalmanFilter(np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]), variance)
        burst = BURST_RAD_S * self._dt
        self.tangential, self.normal = Gate(noise.gate_sigma, burst), Gate(noise.gate_sigma, burst)
        self._ticks = 0  # since the state's time
        self._known = False
        self._sampled = True  # in the tick before
        self._most_ahead = round(MOST_AHEAD_S / self._dt)
        self._x = (0.0, 0.0, 0.0, 0.0)
        self._gain = 0.0
        self._interval = self._last_interval = 0  # ticks between samples
        self._settled: _SettledSlope | None = None

    def update(self, tangential_rad: float, normal_rad: float) -> None:
        """Correct with a sample; the first one starts the filter."""
        self._sampled = True
        kf = self._kf
        if not self._known:
            self._start(tangential_rad, normal_rad)
            return
        settled = self._settled
        if settled is not None and settled.ticks != self._ticks:
            self._unsettle(settled)
            settled = None
        if settled is not None:
            (t, tr, n, nr), dt, variance = self._x, self._ticks * self._dt, settled.variance
            t, n = t + tr * dt, n + nr * dt
        else:
            self._carry()
            (t, tr, n, nr), variance = kf.x[:, 0].tolist(), kf.p.item(0, 0) + kf.r.item(0, 0)
        y0, y1 = tangential_rad - t, normal_rad - n
        believed = self.tangential.believes(y0, variance)
        believed &= self.normal.believes(y1, variance)
        if believed and (self.tangential.surprised or self.normal.surprised):
            self._start(tangential_rad, normal_rad)
        elif settled is not None:
            if believed:
                t, tr, n, nr = (
                    t + settled.angle * y0, tr + settled.rate * y0, n + settled.angle * y1, nr + settled.rate * y1,
                )  # fmt: skip
            self._x, self._ticks = (t, tr, n, nr), 0
            if not believed:  # a rejected sample leaves state and covariance as predicted
                kf.x, kf.p = np.array([[t], [tr], [n], [nr]]), settled.prior
                self._settled = None
        else:
            if believed:
                self._correct(tangential_rad, normal_rad)
            t, tr, n, nr = kf.x[:, 0].tolist()
            self._x = (t, tr, n, nr)

    def _correct(self, tangential_rad: float, normal_rad: float) -> None:
        """Correct with a sample, and detect a settled gain."""
        kf = self._kf
        kf.update(np.array([[tangential_rad], [normal_rad]]))
        kf.p = 0.5 * (kf.p + kf.p.T)
        before, self._gain = self._gain, kf.k.item(0, 0)
        if abs(self._gain - before) < SETTLED_GAIN and self._interval == self._last_interval:
            self._settled = _SettledSlope(
                self._interval, kf.k.item(0, 0), kf.k.item(1, 0), kf.s.item(0, 0), np.array(kf.p_prior)
            )

    def _unsettle(self, settled: _SettledSlope) -> None:
        """Hand state and covariance back to `KalmanFilter`: those after the last update."""
        kf = self._kf
        kf.x = np.array(self._x).reshape(4, 1)
        gain = np.array([[settled.angle, 0.0], [settled.rate, 0.0], [0.0, settled.angle], [0.0, settled.rate]])
        kf.p = (np.eye(4) - gain @ kf.h) @ settled.prior
        self._settled = None

    def _start(self, tangential_rad: float, normal_rad: float) -> None:
        """Begin at a sample, with unknown rates."""
        kf = self._kf
        kf.x = np.array([[tangential_rad], [0.0], [normal_rad], [0.0]])
        kf.p = np.diag([kf.r[0, 0], BURST_RAD_S**2, kf.r[1, 1], BURST_RAD_S**2])
        self._known, self._ticks, self._settled, self._gain = True, 0, None, 0.0
        self._x = (tangential_rad, 0.0, normal_rad, 0.0)

    def absent(self) -> None:
        """No sample in this tick."""
        if self._sampled:
            self._sampled = False
            self.tangential.absent()
            self.normal.absent()

    def pass_ticks(self, periods: int) -> None:
        """Advance the time by ``periods`` ticks."""
        self._ticks += periods
        self.tangential.pass_ticks(periods)
        self.normal.pass_ticks(periods)

    @property
    def believed(self) -> bool:
        """The last sample was used, on both axes."""
        return not (self.tangential.rejects or self.normal.rejects)

    @property
    def state(self) -> tuple[float, float, float, float]:
        """Tangential angle and rate, normal angle and rate, now; rad and rad/s."""
        t, tr, n, nr = self._x
        ahead = min(self._ticks, self._most_ahead) * self._dt
        return t + tr * ahead, tr, n + nr * ahead, nr

    def _carry(self) -> None:
        """Predict state and covariance to the present."""
        self._last_interval, self._interval = self._interval, max(1, self._ticks)
        kf, dt = self._kf, self._interval * self._dt
        one = np.array([[1.0, dt], [0.0, 1.0]])
        noise = self._walk2 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        none = np.zeros((2, 2))
        kf.f, kf.q = np.block([[one, none], [none, one]]), np.block([[noise, none], [none, noise]])
        kf.predict()
        self._ticks = 0


class Stretch:
    """Speed at which the inclination stretches the rope, from the stretch ``L (1/cos - 1)``.

    The difference of a low-pass' input and output over its time constant is the derivative of the low-passed stretch;
    the derivative of the angle itself would be all noise.

    Args:
        length_mm: between the lifting points.
        period_s: of the loop.
    """

    LOW_PASS_S = 0.1

    def __init__(self, length_mm: float, period_s: float) -> None:
        self._length = length_mm
        self._blend = -math.expm1(-period_s / self.LOW_PASS_S)
        self._slow_mm: float | None = None

    def speed_mm_s(self, cosine: float) -> float:
        """Advance one tick; ``cosine`` is the product of both inclinations' cosines."""
        stretch_mm = self._length * (1.0 / cosine - 1.0)
        if self._slow_mm is None:
            self._slow_mm = stretch_mm
        behind_mm = stretch_mm - self._slow_mm
        self._slow_mm += self._blend * behind_mm
        return behind_mm / self.LOW_PASS_S
