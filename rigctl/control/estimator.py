"""Kalman filter of tension, drive speed and disturbance speed.

State ``x = [tension N, drive speed mm/s, disturbance speed mm/s]``. The disturbance is every stretch of the spring not
made by the cylinder: lag of the upper point, level of the rail, motion of the payload.

    dT/dt = k (v + w + f),   dv/dt = (u(t - Td) - v) / tau,   dw/dt = white noise

with f the part of the disturbance known from inclination (`rigctl.control.inclination.Stretch`) and run-out table; the
law takes w + f.

A sample latched by the SYNC of tick n - 1 is read in tick n, and the command sent in tick n reaches the cylinder
``delay_ticks`` after the SYNC of tick n. ``update`` therefore corrects the state of tick n - 1, ``predict`` carries
it to tick n, and ``ahead`` to the instant at which the next command will act.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.control.gate import Gate
from rigctl.control.kalman import KalmanFilter

Array = npt.NDArray[np.float64]

SETTLED_GAIN = 1e-11  # change of the gain in one tick below which it counts as settled
_TENSION, _SPEED = slice(0, 1), slice(1, 2)  # of a measurement
MAX_CATCH_UP = 100  # periods predicted after an overrun; longer gaps end in a fault anyway


@dataclass(frozen=True)
class FilterModel:
    """Discrete model at the loop period; shapes (3, 3), (3, 1), (3, 3) and two variances."""

    f: Array
    b: Array
    q: Array
    cell_variance_n2: float
    speed_variance_mm2_s2: float
    delay_ticks: int
    period_s: float
    gate_sigma: float = 5.0
    burst_mm_s: float = math.inf  # disturbance speed beyond the model, one sigma, for the gate
    drive_burst_mm_s: float = math.inf  # the same per tick of drive speed


def filter_model(settings: RigSettings) -> FilterModel:
    """Exact discretisation of the equations above for a command held over one period."""
    plant, noise = settings.plant, settings.estimator
    dt = 1.0 / settings.loop.rate_hz
    k, tau = plant.stiffness_n_mm, plant.cylinder_lag_s
    a = math.exp(-dt / tau)
    f = np.array([[1.0, k * tau * (1.0 - a), k * dt], [0.0, a, 0.0], [0.0, 0.0, 1.0]])
    b = np.array([[k * (dt - tau * (1.0 - a))], [1.0 - a], [0.0]])
    qw = noise.disturbance_walk_mm_s**2
    q = np.diag([noise.tension_walk_n**2 * dt, noise.speed_walk_mm_s**2 * dt, qw * dt])
    q[0, 0] += k**2 * qw * dt**3 / 3.0
    q[0, 2] = q[2, 0] = k * qw * dt**2 / 2.0
    return FilterModel(
        f,
        b,
        q,
        (settings.tension_cell.noise_n * noise.cell_noise_scale) ** 2,
        noise.speed_noise_mm_s**2,
        round(plant.command_delay_s / dt),
        dt,
        noise.gate_sigma,
        noise.gate_speed_mm_s,
        settings.tension.acceleration_max_mm_s2 * dt,
    )


@dataclass(frozen=True)
class _SettledGain:
    """Gain (3 rows of 2) that no longer changes, covariance before an update, variances of the innovations."""

    gain: list[list[float]]
    prior: Array
    variances: tuple[float, float]


def _inverse(s: Array) -> Array:
    """Inverse of a 1 x 1 or 2 x 2 innovation covariance (numpy's costs three times as much)."""
    if s.shape == (1, 1):
        return 1.0 / s
    (a, b), (c, d) = s.tolist()
    det = a * d - b * c
    return np.array([[d / det, -b / det], [-c / det, a / det]])


class TensionFilter:
    """The filter; it skips absent samples and refuses non-finite ones.

    `KalmanFilter` carries state and covariance until the gain has settled (a tenth of a second). From then on, while
    both samples come, the covariance is constant, and the settled gain carries the state in plain floats: the same
    numbers in a tenth of the time. An absent sample or an overrun goes back to `KalmanFilter`.
    """

    def __init__(self, model: FilterModel) -> None:
        self.model = model
        noise = np.diag([model.cell_variance_n2, model.speed_variance_mm2_s2])
        self._kf = kf = KalmanFilter(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), noise, _inverse)
        kf.f, kf.b, kf.q = model.f, model.b, model.q
        self._transition = [(*row, b) for row, b in zip(model.f.tolist(), model.b[:, 0].tolist(), strict=True)]
        self._settled: _SettledGain | None = None
        self._x = (0.0, 0.0, 0.0)  # the state, once settled
        self._prior: Array = np.eye(3)
        self._sent: list[float] = [0.0] * (model.delay_ticks + 1)  # oldest first
        carry, forced = self._lookahead(model)
        self._carry, self._forced = carry.tolist(), forced.T.tolist()
        self.cell = Gate(model.gate_sigma, model.f.item(0, 2) * model.burst_mm_s)
        self.drive = Gate(model.gate_sigma, model.drive_burst_mm_s)
        self.known_mm_s = 0.0
        """f: the known part of the disturbance, from inclination and run-out table."""
        self.refused = 0
        self.reset(0.0, 0.0)

    @staticmethod
    def _lookahead(model: FilterModel) -> tuple[Array, Array]:
        """``x(n + d) = carry x(n) + forced [u(n - d) .. u(n - 1)]``; shapes (3, 3) and (3, d)."""
        carry = np.eye(3)
        columns: list[Array] = []
        for _ in range(model.delay_ticks):
            columns.insert(0, carry @ model.b)
            carry = model.f @ carry
        return carry, np.hstack(columns) if columns else np.zeros((3, 0))

    def reset(self, tension_n: float, speed_mm_s: float) -> None:
        """Start again from a measurement, with the disturbance at zero, as a slack rope does not show it."""
        kf = self._kf
        kf.x = np.array([[tension_n], [speed_mm_s], [0.0]])
        kf.p = np.diag([self.model.cell_variance_n2, self.model.speed_variance_mm2_s2, 1.0])
        kf.k = np.zeros((3, 1))  # so that the first gain after a reset never counts as settled
        self._settled = None
        self.cell.idle()
        self.drive.idle()

    def update(self, tension_n: float | None, speed_mm_s: float | None) -> None:
        """Correct with the newest samples; ``None`` is absent, a non-finite sample is counted and skipped."""
        tension_n, speed_mm_s = self._finite(tension_n), self._finite(speed_mm_s)
        t, v, w = self.state
        y0 = tension_n - t if tension_n is not None else None
        y1 = speed_mm_s - v if speed_mm_s is not None else None
        ticks = self.cell.since
        s00, s11 = self._variances()
        if not self._believed(self.cell, y0, s00):
            tension_n = None
        elif self.cell.surprised:
            self._follow(ticks)
        if not self._believed(self.drive, y1, s11):
            speed_mm_s = None
        if tension_n is None or speed_mm_s is None:
            self._update_one(tension_n, speed_mm_s)
        elif self._settled is not None:
            (a, b), (c, d), (e, f) = self._settled.gain
            assert y0 is not None
            assert y1 is not None
            self._x = t + a * y0 + b * y1, v + c * y0 + d * y1, w + e * y0 + f * y1
        else:
            self._update_both(tension_n, speed_mm_s)

    def _finite(self, value: float | None) -> float | None:
        if value is None or math.isfinite(value):
            return value
        self.refused += 1
        return None

    def _variances(self) -> tuple[float, float]:
        """Variances of the innovations of tension and speed."""
        if self._settled is not None:
            return self._settled.variances
        p, r = self._kf.p, self._kf.r
        return p.item(0, 0) + r.item(0, 0), p.item(1, 1) + r.item(1, 1)

    @staticmethod
    def _believed(gate: Gate, innovation: float | None, variance: float) -> bool:
        if innovation is None:
            gate.absent()
            return False
        return gate.believes(innovation, variance)

    def _follow(self, ticks: int) -> None:
        """Widen the covariance by a burst of disturbance, so that the filter follows a surprising tension."""
        kf, model = self._kf, self.model
        if self._settled is not None:
            self._unsettle()
            kf.p = self._prior
        speed = model.burst_mm_s
        burst = np.array([[model.f[0, 2] * speed * ticks], [0.0], [speed]])
        kf.p = kf.p + burst @ burst.T

    def _update_both(self, tension_n: float, speed_mm_s: float) -> None:
        kf = self._kf
        before = kf.k
        kf.update(np.array([[tension_n], [speed_mm_s]]))
        if before.shape == kf.k.shape and np.abs(kf.k - before).max() < SETTLED_GAIN:
            self._x = self.state
            self._settled = _SettledGain(kf.k.tolist(), kf.p_prior, (kf.s.item(0, 0), kf.s.item(1, 1)))
        else:
            kf.p = 0.5 * (kf.p + kf.p.T)

    def _update_one(self, tension_n: float | None, speed_mm_s: float | None) -> None:
        kf = self._kf
        if self._settled is not None:
            self._unsettle()
            kf.p = self._prior
        if tension_n is not None:
            kf.update(np.array([[tension_n]]), _TENSION)
        elif speed_mm_s is not None:
            kf.update(np.array([[speed_mm_s]]), _SPEED)
        kf.p = 0.5 * (kf.p + kf.p.T)

    def _unsettle(self) -> None:
        """Hand the state back to `KalmanFilter`, whose covariance is that after an update."""
        if self._settled is not None:
            self._prior, self._settled = self._settled.prior, None
            self._kf.x = np.array(self._x).reshape(3, 1)

    def predict(self, periods: int = 1) -> None:
        """Carry the state to this tick; ``periods`` > 1 after an overrun, under the last command."""
        sent = self._sent
        self.cell.pass_ticks(periods)
        self.drive.pass_ticks(periods)
        if periods == 1 and self._settled is not None:
            t, v, w = self._x
            u = sent[0]
            (a, b, c, d), (e, f, g, h), (i, j, k, m) = self._transition
            known = c * self.known_mm_s
            self._x = (
                a * t + b * v + c * w + d * u + known,
                e * t + f * v + g * w + h * u,
                i * t + j * v + k * w + m * u,
            )
            sent.append(sent[-1])
            del sent[0]
            return
        self._unsettle()
        for _ in range(min(periods, MAX_CATCH_UP)):
            self._kf.predict(u=sent[0])
            self._kf.x[0, 0] += self.model.f[0, 2] * self.known_mm_s
            sent.append(sent[-1])
            del sent[0]

    def ahead(self) -> tuple[float, float, float]:
        """Tension, drive speed and whole disturbance speed, w + f, when a command sent now will act."""
        t, v, w = self.state
        w += self.known_mm_s
        if not self.model.delay_ticks:
            return t, v, w
        # Plain floats: three rows of a handful of products cost numpy four times as much.
        (a, b, c), (d, e, f), (g, h, i) = self._carry
        tension_n, speed_mm_s, disturbance_mm_s = a * t + b * v + c * w, d * t + e * v + f * w, g * t + h * v + i * w
        for (to_tension, to_speed, to_disturbance), command in zip(self._forced, self._sent, strict=False):
            tension_n += to_tension * command
            speed_mm_s += to_speed * command
            disturbance_mm_s += to_disturbance * command
        return tension_n, speed_mm_s, disturbance_mm_s

    def command(self, speed_mm_s: float) -> None:
        """Store the limited command sent in this tick, which the drive will follow."""
        self._sent[-1] = speed_mm_s

    @property
    def state(self) -> tuple[float, float, float]:
        """Tension, drive speed and disturbance speed at this tick."""
        if self._settled is not None:
            return self._x
        (t,), (v,), (w,) = self._kf.x.tolist()
        return t, v, w

    @property
    def covariance(self) -> Array:
        """Covariance of the state, (3, 3)."""
        return np.array(self._kf.p)
