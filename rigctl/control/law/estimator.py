"""Kalman filter of tension, drive speed and disturbance speed.

State ``x = [tension N, drive speed mm/s, disturbance speed mm/s]``. The disturbance is every stretch of the spring not
made by the cylinder: lag of the upper point, level of the rail, motion of the payload.

    dT/dt = k (v + w + f),   dv/dt = (u(t - Td) - v) / tau,   dw/dt = white noise

with f the part of the disturbance known from inclination (`rigctl.control.law.inclination.Stretch`) and run-out table;
the law takes w + f. With `estimator.swing_hz` two states more follow (`rigctl.control.law.swing`): the first of them is
a part of the disturbance beside w and f.

The gain is the settled one of these equations in every tick, from the first on, so that it is no matter of what was
measured before: the design proves the loop with it. A sample that is missing or rejected corrects nothing. Only a
tension beyond the model, believed as the burst of a jolt, has a gain of its own, that of the covariance widened by the
burst, for its one tick.

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
from rigctl.control.law.kalman import settled_covariance
from rigctl.control.law.opening import Opening, rest_variances
from rigctl.control.law.swing import DisturbanceSwing, FilteredSwing, NoSwing, SwingPeriod

Array = npt.NDArray[np.float64]

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
class _Gain:
    """The settled gain on the innovation of one sensor: of the first three states, and of a swing's."""

    first: Row
    rest: Rest

    @classmethod
    def of(cls, column: Array) -> _Gain:
        a, b, c, *rest = column.tolist()
        return cls((a, b, c), tuple(rest))


def _rows(f: Array, b: Array) -> tuple[float, ...]:
    """What is neither 0 nor 1 in a transition of the model, row by row, with the input's."""
    return f.item(0, 1), f.item(0, 2), b.item(0), f.item(1, 1), b.item(1)


class TensionFilter:
    """The filter; it skips absent samples and refuses non-finite ones."""

    def __init__(self, model: FilterModel) -> None:
        self.model = model
        self._rows = _rows(model.f, model.b[:, 0])
        self.opening: Opening | None = None
        self._settle_gains()
        self._x: Row = (0.0, 0.0, 0.0)
        self._sent: list[float] = [0.0] * (model.delay_ticks + 1)  # oldest first
        carry, forced = self._lookahead(model)
        self._carry, self._forced = _rows(carry, np.zeros(3)), forced.T[:, :2].tolist()
        self._swing: DisturbanceSwing = NoSwing()
        if model.swing is not None:
            self._swing = FilteredSwing(model.swing, (carry.item(0, 3), carry.item(0, 4)), model.delay_ticks)
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

    def _settle_gains(self) -> None:
        """The settled gains from their equation, with the quiet setting's if there is one."""
        model = self.model
        h = np.eye(2, len(model.f))
        r = np.diag([model.cell_variance_n2, model.speed_variance_mm2_s2])

        def settled(q: Array) -> tuple[Array, Array, Array]:
            prior = settled_covariance(model.f, h, q, r)
            s = h @ prior @ h.T + r
            return prior, s, np.asarray(np.linalg.solve(s, h @ prior)).T

        self._prior, s, gain = settled(model.q)
        """Covariance before an update in the open setting, (n, n)."""
        self.gain: Array = gain
        """In the open setting, states by (tension, speed), (n, 2)."""
        self._of_tension, self._of_speed = _Gain.of(gain[:, 0]), _Gain.of(gain[:, 1])
        self._variance_n2, self._variance_mm2_s2 = self._quiet_variance_n2, _ = s.item(0, 0), s.item(1, 1)
        self._to_quiet = _Gain.of(np.zeros(len(gain)))
        if model.quiet_q is None:
            return
        _, _, quiet = settled(model.quiet_q)
        both = np.column_stack([quiet[:, 0], gain[:, 1]])
        window = model.open_window_s / model.period_s
        self._quiet_variance_n2, quiet_mean_n2 = rest_variances(model.f, both, r, window)
        _, open_mean_n2 = rest_variances(model.f, gain, r, window)
        mean_n2 = max(quiet_mean_n2, open_mean_n2)  # else noise alone would keep an open filter open
        self.opening = Opening(window, model.open_sigma, model.quiet_after_s / model.period_s, mean_n2)
        self._to_quiet = _Gain.of(quiet[:, 0] - gain[:, 0])

    def reset(self, tension_n: float, speed_mm_s: float, known_mm_s: float = 0.0) -> None:
        """Start again from a measurement, with the disturbance at zero, as a slack rope does not show it."""
        self.known_mm_s = known_mm_s
        self._x = (tension_n, speed_mm_s, 0.0)
        self._swing.take((0.0, 0.0))
        self._open()
        self.cell.idle()
        self.drive.idle()

    def settle(self) -> None:
        """Be quiet at once, if there is such a setting: as after a long time at rest."""
        if self.opening is not None:
            self.opening.close()

    def take_over(self, other: TensionFilter) -> None:
        """Go on from the state of another filter with this one's gain, wholly open.

        The models may differ in stiffness and noise, not in their delay.
        """
        self._open()
        self._x = other._x
        self._swing.take(other._swing.states)
        self._sent[:] = other._sent
        self.known_mm_s, self.refused = other.known_mm_s, other.refused
        self.cell.go_on_from(other.cell)
        self.drive.go_on_from(other.drive)

    def _open(self) -> None:
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
        t, v, w = self._x
        if late_s:  # what they moved on since the time of the state
            _, to_tension, _, kept, driven = self._rows
            periods = late_s / self.model.period_s
            if tension_n is not None:
                tension_n -= to_tension * (v + (w + self._swing.speed_mm_s) + self.known_mm_s) * periods
            if speed_mm_s is not None:
                speed_mm_s -= (driven * self._sent[0] - (1.0 - kept) * v) * periods
        y0 = tension_n - t if tension_n is not None else None
        y1 = speed_mm_s - v if speed_mm_s is not None else None
        ticks, s00, opening = self.cell.since, self._variance_n2, self.opening
        if opening is not None:
            s00 += (1.0 - opening.level) * (self._quiet_variance_n2 - s00)
        if not self.cell.believes(y0, s00):
            y0 = None
        if not self.drive.believes(y1, self._variance_mm2_s2):
            y1 = None
        surprised = self.cell.surprised
        gain = self._of_tension if not surprised else self._of_burst(ticks)
        kt, kv, kw = gain.first
        (lt, lv, lw), by_speed = self._of_speed.first, self._of_speed.rest
        if y0 is None or y1 is None or surprised:
            self._open()
        elif opening is not None:
            opening.look(y0)
            quiet = 1.0 - opening.level
            dt, dv, dw = self._to_quiet.first
            kt, kv, kw = kt + quiet * dt, kv + quiet * dv, kw + quiet * dw
            self._swing.correct(self._to_quiet.rest, by_speed, quiet * y0, 0.0)
        y0, y1 = y0 or 0.0, y1 or 0.0
        self._x = t + kt * y0 + lt * y1, v + kv * y0 + lv * y1, w + kw * y0 + lw * y1
        self._swing.correct(gain.rest, by_speed, y0, y1)

    def _finite(self, value: float | None) -> float | None:
        if value is None or math.isfinite(value):
            return value
        self.refused += 1
        return None

    def _of_burst(self, ticks: int) -> _Gain:
        """The gain that follows a surprising tension: of the covariance widened by a burst of disturbance."""
        model, speed = self.model, self.model.burst_mm_s
        burst = np.zeros(len(model.f))
        burst[0], burst[2] = model.f[0, 2] * speed * ticks, speed
        prior = self._prior + np.outer(burst, burst)
        s = prior[:2, :2] + np.diag([model.cell_variance_n2, model.speed_variance_mm2_s2])
        return _Gain.of(np.linalg.solve(s, prior[:2])[0])

    def predict(self, periods: int = 1) -> None:
        """Carry the state to this tick; ``periods`` > 1 after an overrun, under the last command."""
        sent = self._sent
        self.cell.pass_ticks(periods)
        self.drive.pass_ticks(periods)
        if periods > 1:
            self._open()
        tv, tw, tu, vv, vu = self._rows
        known = tw * self.known_mm_s
        for _ in range(min(periods, MAX_CATCH_UP)):
            t, v, w = self._x
            u = sent[0]
            self._x = t + tv * v + tw * w + tu * u + known + self._swing.carry(), vv * v + vu * u, w
            sent.append(sent[-1])
            del sent[0]

    def ahead(self) -> tuple[float, float, float, float]:
        """Tension, drive speed and whole disturbance speed when a command sent now will act; the lead of a swing."""
        (t, v, w), known = self._x, self.known_mm_s
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
    def state(self) -> Row:
        """Tension, drive speed and disturbance speed at this tick, without the known part."""
        t, v, w = self._x
        return t, v, w + self._swing.speed_mm_s

    @property
    def level(self) -> float:
        """How far the filter is open: 0 = quiet, 1 = open, or without a quiet setting."""
        return self.opening.level if self.opening is not None else 1.0
