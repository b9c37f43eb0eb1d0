"""Stretch of the rope by its inclination, known ahead: a swing is predicted to when the cylinder has followed.

Per axis the rope swings about an angle that wanders (where the mechanism holds the payload), and the inclinometer shows
it through its low-pass m:

    theta'' = omega^2 (theta_0 - theta),   dtheta_0/dt = white noise,   dm/dt = (theta - m) / tau_m

The speed of the stretch ``L (1 / (cos theta_x cos theta_y) - 1)`` follows from angles and rates at any time:

    L / (cos theta_x cos theta_y) (tan theta_x theta_x' + tan theta_y theta_y')

so at that at which a command sent now has reached the cylinder: the drive's lag and delay ahead, and the tick by which
a sample is old. Constant velocity does not do: over 25 ms of noisy rate it loses as much as the lead gains.
"""

from __future__ import annotations

import math

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.kalman import Array, exponential, settled_covariance

MOST_AHEAD_S = 0.1
"""Longest time without a sample, after which the speed counts as unknown."""
Row = tuple[float, ...]


class StretchLead:
    """Speed of the stretch now and ahead; the samples of both axes come at the inclinometer's own interval.

    ``update`` with a sample that the gate of `InclinationFilter` believes, ``pass_ticks`` in every tick.
    """

    def __init__(self, settings: RigSettings) -> None:
        noise, dt = settings.estimator, 1.0 / settings.loop.rate_hz
        assert noise.inclination_swing_hz is not None
        omega2 = (2.0 * math.pi * noise.inclination_swing_hz) ** 2
        lag = 1e3 / noise.inclination_lag_ms
        model = np.array(
            [[-lag, lag, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -omega2, 0.0, omega2], [0.0, 0.0, 0.0, 0.0]]
        )
        self._length_mm = settings.plant.rope_length_mm
        ahead_s = settings.plant.cylinder_lag_s + settings.plant.command_delay_s + dt
        self._most = round(MOST_AHEAD_S / dt)
        carried = [exponential(model * (tick * dt)) for tick in range(self._most + 1)]
        ahead = exponential(model * ahead_s)
        self._carry = [[tuple(row) for row in each.tolist()] for each in carried]
        self._now = [_angle_and_rate(each) for each in carried]
        self._then = [_angle_and_rate(ahead @ each) for each in carried]
        interval = settings.loop.rate_hz // settings.inclinometer.rate_hz
        walk = np.diag([0.0, 0.0, 0.0, math.radians(noise.inclination_swing_walk_deg) ** 2])
        self._gain: Row = tuple(_gain(model, walk, interval * dt, math.radians(noise.inclination_noise_deg) ** 2))
        self._axes: tuple[Row, Row] | None = None
        self._ticks = 0

    def update(self, tangential_rad: float, normal_rad: float) -> None:
        """Correct with a sample; the first one, or one after a long gap, starts at rest there."""
        if self._axes is None or self._ticks > self._most:
            t, n = tangential_rad, normal_rad
            self._axes = (t, t, 0.0, t), (n, n, 0.0, n)
        else:
            carry, (one, other) = self._carry[self._ticks], self._axes
            self._axes = self._corrected(carry, one, tangential_rad), self._corrected(carry, other, normal_rad)
        self._ticks = 0

    def _corrected(self, carry: list[Row], x: Row, y: float) -> Row:
        a, b, c, d = x
        m, angle, rate, about = (e * a + f * b + g * c + h * d for e, f, g, h in carry)
        (km, ka, kr, k0), missed = self._gain, y - m
        return m + km * missed, angle + ka * missed, rate + kr * missed, about + k0 * missed

    def pass_ticks(self, periods: int) -> None:
        """Advance the time by ``periods`` ticks."""
        self._ticks += periods

    def speeds_mm_s(self) -> tuple[float, float]:
        """Speed of the stretch now, and its change until a command sent now has been followed; 0 if unknown."""
        if self._axes is None or self._ticks > self._most:
            return 0.0, 0.0
        now = self._speed(self._now[self._ticks])
        return now, self._speed(self._then[self._ticks]) - now

    def _speed(self, rows: Row) -> float:
        (_, a, b, c), (_, d, e, f) = self._axes  # type: ignore[misc]
        ta, tb, tc, ra, rb, rc = rows
        x, y = ta * a + tb * b + tc * c, ta * d + tb * e + tc * f
        towards = math.tan(x) * (ra * a + rb * b + rc * c) + math.tan(y) * (ra * d + rb * e + rc * f)
        return self._length_mm / (math.cos(x) * math.cos(y)) * towards


def _angle_and_rate(carry: Array) -> Row:
    """What makes the angle and its rate of the states, without the sensor's, on which they do not depend."""
    return (*carry[1, 1:].tolist(), *carry[2, 1:].tolist())


def _gain(model: Array, white: Array, interval_s: float, variance: float) -> list[float]:
    """Settled gain of the four states on the sensor's samples; the noise of an interval by Van Loan."""
    f = exponential(model * interval_s)
    both = np.block([[-model, white], [np.zeros((4, 4)), model.T]])
    q = f @ exponential(both * interval_s)[:4, 4:]
    h, r = np.eye(1, 4), np.array([[variance]])
    prior = settled_covariance(f, h, 0.5 * (q + q.T), r)
    gain: list[float] = (prior @ h.T / (h @ prior @ h.T + r))[:, 0].tolist()
    return gain
