"""Kalman filter of tension, drive speed and disturbance speed.

State ``x = [tension N, drive speed mm/s, disturbance speed mm/s]``. The disturbance is every stretch of the spring not
made by the cylinder: lag of the upper point, level of the rail, motion of the payload.

    dT/dt = k (v + w + f),   dv/dt = (u(t - Td) - v) / tau,   dw/dt = white noise

with f the part of the disturbance known from inclination (`rigctl.control.law.inclination.Stretch`) and run-out table;
the law takes w + f. With `estimator.swing_hz` two states more follow (`rigctl.control.law.swing`): the first of them is
a part of the disturbance beside w and f.

With ``quiet_`` walks there are two settled gains, and `rigctl.control.law.opening` says how far to go from the quiet to
the open one. They differ in the column of the tension alone: one scalar that varies in time between fixed bounds, of
which the design proves that no variation makes the loop unstable (`rigctl.design.switching`).

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
from rigctl.control.law.gate import Gate
from rigctl.control.law.kalman import KalmanFilter, settled_covariance
from rigctl.control.law.opening import Opening, rest_variances
from rigctl.control.law.swing import DisturbanceSwing, NoSwing, Swing, SwingPeriod

Array = npt.NDArray[np.float64]

SETTLED_GAIN = 1e-11  # change of the gain in one tick below which it counts as settled
NEAR_GAIN = 0.02
"""Share of a state's larger gain, within which a filter with two settings takes its settled gain."""
_TENSION, _SPEED = slice(0, 1), slice(1, 2)  # of a measurement
MAX_CATCH_UP = 100  # periods predicted after an overrun; longer gaps end in a fault anyway


@dataclass(frozen=True)
class FilterModel:
    """Discrete model at the loop period; shapes (n, n), (n, 1), (n, n), and variances; n is 3, or 5 with a swing."""

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
    quiet_q: Array | None = None  # process noise while nothing happens; None: there is no quiet setting
    open_window_s: float = 0.1
    open_sigma: float = 4.0
    quiet_after_s: float = 0.5
    swing: SwingPeriod | None = None

    @property
    def disturbance(self) -> Array:
        """Row that gives the disturbance's speed of the states, (n,)."""
        return np.array([0.0, 0.0, 1.0, 1.0, 0.0][: len(self.f)])

    @property
    def lead(self) -> Array:
        """Row that gives what a command adds so that the drive's lag does not delay a swing, (n,)."""
        return np.array([0.0, 0.0, 0.0, *(self.swing.lead if self.swing is not None else ())])


def filter_model(settings: RigSettings) -> FilterModel:
    """Exact discretisation of the equations above for a command held over one period."""
    plant, noise = settings.plant, settings.estimator
    dt = 1.0 / settings.loop.rate_hz
    k, tau = plant.stiffness_n_mm, plant.cylinder_lag_s
    a = math.exp(-dt / tau)
    swing = SwingPeriod.of(settings)
    states = 3 if swing is None else 5
    f, b = np.eye(states), np.zeros((states, 1))
    f[0, 1:3], f[1, 1] = (k * tau * (1.0 - a), k * dt), a
    b[:2, 0] = k * (dt - tau * (1.0 - a)), 1.0 - a
    if swing is not None:
        f[0, 3:], f[3:, 3:] = swing.to_tension, swing.f
    quiet_q = _process_noise(
        settings,
        noise.quiet_tension_walk_n or noise.tension_walk_n,
        noise.quiet_disturbance_walk_mm_s or noise.disturbance_walk_mm_s,
    )
    return FilterModel(
        f,
        b,
        _process_noise(settings, noise.tension_walk_n, noise.disturbance_walk_mm_s),
        (settings.tension_cell.noise_n * noise.cell_noise_scale) ** 2,
        noise.speed_noise_mm_s**2,
        round(plant.command_delay_s / dt),
        dt,
        noise.gate_sigma,
        noise.gate_speed_mm_s,
        settings.tension.acceleration_max_mm_s2 * dt,
        quiet_q if noise.adapts else None,
        noise.open_window_ms * 1e-3,
        noise.open_sigma,
        noise.quiet_after_ms * 1e-3,
        swing,
    )


def _process_noise(settings: RigSettings, tension_walk: float, disturbance_walk: float) -> Array:
    """Covariance of one period's process noise, (n, n). A swing is a walk within a period."""
    dt, k, estimator = 1.0 / settings.loop.rate_hz, settings.plant.stiffness_n_mm, settings.estimator
    swings = estimator.swing_hz is not None
    walks = [disturbance_walk**2, *([estimator.swing_walk_mm_s**2] * 2 if swings else [])]
    q = np.diag([tension_walk**2 * dt, estimator.speed_walk_mm_s**2 * dt, *(qw * dt for qw in walks)])
    for at, qw in enumerate(walks[:2], 2):  # the second state of a swing does not move the tension
        q[0, 0] += k**2 * qw * dt**3 / 3.0
        q[0, at] = q[at, 0] = k * qw * dt**2 / 2.0
    return q


Row = tuple[float, float, float]
Rest = tuple[float, ...]
"""Of the states beyond the third."""


@dataclass(frozen=True)
class _SettledGain:
    """Gains that no longer change, covariance before an update, variances of the innovations."""

    tension: Row
    speed: Row
    rest: tuple[Rest, Rest]  # of tension and of speed, for the states of a swing
    prior: Array
    variances: tuple[float, float]
    to_quiet: Row = (0.0, 0.0, 0.0)  # of the tension: quiet less open
    rest_to_quiet: Rest = ()
    quiet_variance_n2: float = 0.0  # of the tension's innovation at rest, in the quiet setting

    @classmethod
    def of(cls, gain: Array, prior: Array, s: Array, quiet: Array | None = None, variance: float = 0.0) -> _SettledGain:
        """Of gains (n, 2), open and quiet, covariance before an update (n, n) and of the innovations (2, 2)."""
        change = quiet[:, 0] - gain[:, 0] if quiet is not None else np.zeros(len(gain))
        return cls(
            _row(gain[:3, 0]), _row(gain[:3, 1]), (tuple(gain[3:, 0].tolist()), tuple(gain[3:, 1].tolist())), prior,
            (s.item(0, 0), s.item(1, 1)), _row(change[:3]), tuple(change[3:].tolist()), variance,
        )  # fmt: skip


def _rows(f: Array, b: Array) -> tuple[float, ...]:
    """What is neither 0 nor 1 in a transition of the model, row by row, with the input's."""
    return f.item(0, 1), f.item(0, 2), b.item(0), f.item(1, 1), b.item(1)


def _row(column: Array) -> Row:
    a, b, c = column.tolist()
    return a, b, c


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
        self._kf = kf = KalmanFilter(np.eye(2, len(model.f)), noise, _inverse)
        kf.f, kf.b, kf.q = model.f, model.b, model.q
        self._rows = _rows(model.f, model.b[:, 0])
        self._settled: _SettledGain | None = None
        self.opening: Opening | None = None
        # A swing's covariance takes seconds to settle: its gain is computed, as that of two settings is.
        self._target = self._settled_gain() if model.quiet_q is not None or model.swing is not None else None
        self._x: Row = (0.0, 0.0, 0.0)  # the first three states, once settled
        self._prior: Array = np.eye(len(model.f))
        self._sent: list[float] = [0.0] * (model.delay_ticks + 1)  # oldest first
        carry, forced = self._lookahead(model)
        self._carry, self._forced = _rows(carry, np.zeros(3)), forced.T[:, :2].tolist()
        self._swing: DisturbanceSwing = NoSwing()
        if model.swing is not None:
            self._swing = Swing(model.swing, (carry.item(0, 3), carry.item(0, 4)), model.delay_ticks)
        self.cell = Gate(model.gate_sigma, model.f.item(0, 2) * model.burst_mm_s)
        self.drive = Gate(model.gate_sigma, model.drive_burst_mm_s)
        self.known_mm_s = 0.0
        """f, see `update`."""
        self.refused = 0
        self.reset(0.0, 0.0)

    @staticmethod
    def _lookahead(model: FilterModel) -> tuple[Array, Array]:
        """``x(n + d) = carry x(n) + forced [u(n - d) .. u(n - 1)]``; shapes (n, n) and (n, d)."""
        carry = np.eye(len(model.f))
        columns: list[Array] = []
        for _ in range(model.delay_ticks):
            columns.insert(0, carry @ model.b)
            carry = model.f @ carry
        return carry, np.hstack(columns) if columns else np.zeros((len(carry), 0))

    def _settled_gain(self) -> _SettledGain:
        """The settled gain from its equation, with the quiet setting's if there is one."""
        model, h, r = self.model, self._kf.h, self._kf.r

        def settled(q: Array) -> tuple[Array, Array, Array]:
            prior = settled_covariance(model.f, h, q, r)
            s = h @ prior @ h.T + r
            return prior, s, np.asarray(np.linalg.solve(s, h @ prior)).T

        prior, s, gain = settled(model.q)
        if model.quiet_q is None:
            return _SettledGain.of(gain, prior, s)
        _, _, quiet = settled(model.quiet_q)
        both = np.column_stack([quiet[:, 0], gain[:, 1]])
        window = model.open_window_s / model.period_s
        variance_n2, quiet_mean_n2 = rest_variances(model.f, both, r, window)
        _, open_mean_n2 = rest_variances(model.f, gain, r, window)
        mean_n2 = max(quiet_mean_n2, open_mean_n2)  # else noise alone would keep an open filter open
        self.opening = Opening(window, model.open_sigma, model.quiet_after_s / model.period_s, mean_n2)
        return _SettledGain.of(gain, prior, s, quiet, variance_n2)

    def reset(self, tension_n: float, speed_mm_s: float, known_mm_s: float = 0.0) -> None:
        """Start again from a measurement, with the disturbance at zero, as a slack rope does not show it."""
        self.known_mm_s = known_mm_s
        kf = self._kf
        states = len(self.model.f)
        kf.x = np.zeros((states, 1))
        kf.x[0, 0], kf.x[1, 0] = tension_n, speed_mm_s
        self._swing.take(kf.x[3:, 0])
        kf.p = np.eye(states)
        kf.p[0, 0], kf.p[1, 1] = self.model.cell_variance_n2, self.model.speed_variance_mm2_s2
        kf.k = np.zeros((states, 1))  # so that the first gain after a reset never counts as settled
        self._unused_gain()
        self.cell.idle()
        self.drive.idle()

    def settle(self) -> None:
        """Take the settled gain at once, quiet if there is such a setting: as after a long time at rest."""
        target = self._target or self._settled_gain()
        self._x, self._settled, self._prior = self._first, target, target.prior
        if self.opening is not None:
            self.opening.close()

    def take_over(self, other: TensionFilter) -> None:
        """Go on from the state of another filter with this one's settled gain, wholly open.

        The models may differ in stiffness and noise, not in their delay.
        """
        self._unused_gain()
        self._target = self._target or self._settled_gain()
        self._x, self._settled, self._prior = other._first, self._target, self._target.prior
        self._kf.x = np.array([*self._x, *other._swing.states]).reshape(-1, 1)
        self._swing.take(self._kf.x[3:, 0])
        self._kf.p = np.array(self._target.prior)
        self._sent[:] = other._sent
        self.known_mm_s, self.refused = other.known_mm_s, other.refused
        self.cell.go_on_from(other.cell)
        self.drive.go_on_from(other.drive)

    def _unused_gain(self) -> None:
        self._settled = None
        if self.opening is not None:
            self.opening.open()

    def update(
        self, tension_n: float | None, speed_mm_s: float | None, known_mm_s: float = 0.0, late_s: float = 0.0
    ) -> None:  # fmt: skip
        """Correct with the newest samples; ``None`` is absent, a non-finite sample is counted and skipped.

        Args:
            tension_n: of the cell.
            speed_mm_s: of the drive.
            known_mm_s: f from now on: the known part of the disturbance, from inclination and run-out table.
            late_s: how much later than the others these samples were latched.
        """
        self.known_mm_s = known_mm_s
        if not math.isfinite((tension_n or 0.0) + (speed_mm_s or 0.0)):
            tension_n, speed_mm_s = self._finite(tension_n), self._finite(speed_mm_s)
        t, v, w = self._first
        if late_s:  # what they moved on since the time of the state
            _, to_tension, _, kept, driven = self._rows
            periods = late_s / self.model.period_s
            if tension_n is not None:
                tension_n -= to_tension * (v + (w + self._swing.speed_mm_s) + self.known_mm_s) * periods
            if speed_mm_s is not None:
                speed_mm_s -= (driven * self._sent[0] - (1.0 - kept) * v) * periods
        y0 = tension_n - t if tension_n is not None else None
        y1 = speed_mm_s - v if speed_mm_s is not None else None
        ticks = self.cell.since
        s00, s11 = self._variances()
        if not self.cell.believes(y0, s00):
            tension_n = None
        elif self.cell.surprised:
            self._follow(ticks)
        if not self.drive.believes(y1, s11):
            speed_mm_s = None
        if tension_n is None or speed_mm_s is None:
            self._update_one(tension_n, speed_mm_s)
        elif self._settled is not None:
            assert y0 is not None
            assert y1 is not None
            (kt, kv, kw), (lt, lv, lw) = self._settled.tension, self._settled.speed
            (rest, by_speed), opening = self._settled.rest, self.opening
            if opening is not None:
                opening.look(y0)
                quiet = 1.0 - opening.level
                dt, dv, dw = self._settled.to_quiet
                kt, kv, kw = kt + quiet * dt, kv + quiet * dv, kw + quiet * dw
                rest = tuple(k + quiet * d for k, d in zip(rest, self._settled.rest_to_quiet, strict=True))
            self._x = t + kt * y0 + lt * y1, v + kv * y0 + lv * y1, w + kw * y0 + lw * y1
            self._swing.correct(rest, by_speed, y0, y1)
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
            s00, s11 = self._settled.variances
            if self.opening is not None:
                s00 += (1.0 - self.opening.level) * (self._settled.quiet_variance_n2 - s00)
            return s00, s11
        p, r = self._kf.p, self._kf.r
        return p.item(0, 0) + r.item(0, 0), p.item(1, 1) + r.item(1, 1)

    def _follow(self, ticks: int) -> None:
        """Widen the covariance by a burst of disturbance, so that the filter follows a surprising tension."""
        kf, model = self._kf, self.model
        if self._settled is not None:
            self._unsettle()
            kf.p = self._prior
        speed = model.burst_mm_s
        burst = np.zeros((len(model.f), 1))
        burst[0, 0], burst[2, 0] = model.f[0, 2] * speed * ticks, speed
        kf.p = kf.p + burst @ burst.T

    def _update_both(self, tension_n: float, speed_mm_s: float) -> None:
        kf = self._kf
        before = kf.k
        kf.update(np.array([[tension_n], [speed_mm_s]]))
        self._swing.take(kf.x[3:, 0])
        if self._target is not None:
            gain = np.array([self._target.tension, self._target.speed]).T
            if (np.abs(kf.k[:3] - gain) < NEAR_GAIN * np.abs(gain).max(axis=1, keepdims=True)).all():
                self._x, self._settled = self._first, self._target
                return
        elif before.shape == kf.k.shape and np.abs(kf.k - before).max() < SETTLED_GAIN:
            self._x, self._settled = self._first, _SettledGain.of(kf.k, kf.p_prior, kf.s)
            return
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
        self._swing.take(kf.x[3:, 0])
        kf.p = 0.5 * (kf.p + kf.p.T)

    def _unsettle(self) -> None:
        """Hand the state back to `KalmanFilter`, whose covariance is that after an update, in the open setting."""
        if self._settled is not None:
            self._prior = self._settled.prior
            self._kf.x = np.array([*self._x, *self._swing.states]).reshape(-1, 1)
            self._unused_gain()

    def predict(self, periods: int = 1) -> None:
        """Carry the state to this tick; ``periods`` > 1 after an overrun, under the last command."""
        sent = self._sent
        self.cell.pass_ticks(periods)
        self.drive.pass_ticks(periods)
        if periods == 1 and self._settled is not None:
            t, v, w = self._x
            u = sent[0]
            tv, tw, tu, vv, vu = self._rows
            known = tw * self.known_mm_s
            self._x = t + tv * v + tw * w + tu * u + known + self._swing.carry(), vv * v + vu * u, w
            sent.append(sent[-1])
            del sent[0]
            return
        self._unsettle()
        for _ in range(min(periods, MAX_CATCH_UP)):
            self._kf.predict(u=sent[0])
            self._kf.x[0, 0] += self.model.f[0, 2] * self.known_mm_s
            sent.append(sent[-1])
            del sent[0]
        self._swing.take(self._kf.x[3:, 0])

    def ahead(self) -> tuple[float, float, float, float]:
        """Tension, drive speed and whole disturbance speed when a command sent now will act; the lead of a swing."""
        (t, v, w), known = self._first, self.known_mm_s
        tv, tw, _, vv, _ = self._carry
        added_n, swing_mm_s, lead_mm_s = self._swing.ahead()
        tension_n, speed_mm_s, disturbance_mm_s = t + tv * v + tw * (w + known) + added_n, vv * v, w + known
        for (to_tension, to_speed), command in zip(self._forced, self._sent, strict=False):
            tension_n += to_tension * command
            speed_mm_s += to_speed * command
        return tension_n, speed_mm_s, disturbance_mm_s + swing_mm_s, lead_mm_s

    def command(self, speed_mm_s: float) -> None:
        """Store the limited command sent in this tick, which the drive will follow."""
        self._sent[-1] = speed_mm_s

    @property
    def _first(self) -> Row:
        """Tension, drive speed and walk at this tick."""
        return self._x if self._settled is not None else _row(self._kf.x[:3, 0])

    @property
    def state(self) -> Row:
        """Tension, drive speed and disturbance speed at this tick, without the known part."""
        t, v, w = self._first
        return t, v, w + self._swing.speed_mm_s

    @property
    def level(self) -> float:
        """How far the filter is open: 0 = quiet, 1 = open, or without a quiet setting."""
        return self.opening.level if self.opening is not None else 1.0

    @property
    def covariance(self) -> Array:
        """Covariance of the state, (n, n), in the open setting."""
        return np.array(self._kf.p)
