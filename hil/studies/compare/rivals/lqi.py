"""LQI: the linear-quadratic state feedback with integral action, and a Kalman filter without a disturbance state."""

from __future__ import annotations

import numpy as np

from hil.studies.compare.rivals.feedback import Feedback, Sample
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import Array, filter_model
from rigctl.control.law.tension import Gains
from rigctl.design.gains import design

STRETCH_MM = 0.05
"""Largest error to be accepted, as stretch, so that the loop's shape does not depend on the spring; at 6 N/mm it is the
0.1 % of 300 N of the demo and of the settling time ..."""
HELD_S = 0.1
"""... for this long."""


class Lqi(Feedback):
    """Weights by Bryson's rule (Bryson, Ho: Applied Optimal Control, 1975): 1 / (largest value accepted)^2.

    The accepted values are 0.05 mm of stretch, that error for 0.1 s, and the speed limit as a command. With the
    weights of our own law, which leaves disturbances to its feed-forward, LQI would be a tenth as good. In the filter a
    disturbance is white noise, as in the standard LQG problem: another speed in every tick, rms the speed limit.
    The measured error is integrated, so that the filter's model errors leave no bias.
    """

    def __init__(
        self,
        settings: RigSettings,
        stretch_mm: float = STRETCH_MM,
        held_s: float = HELD_S,
        disturbance_mm_s: float | None = None,
    ) -> None:
        """``disturbance_mm_s``: rms that the filter expects, the speed limit by default."""
        model = filter_model(settings)
        self.gains = bryson(settings, stretch_mm, held_s)
        self._dt, self._stiffness = model.period_s, settings.plant.stiffness_n_mm
        # Plain floats: numpy takes ten times as long for two rows.
        self._kalman = kalman_gain(settings, disturbance_mm_s).tolist()
        rows = np.hstack([model.f[:2, :2], model.b[:2, :1]])
        self._step = tuple(tuple(row) for row in rows.tolist())
        self._under_way = [0.0] * (model.delay_ticks + 1)
        self._x = (0.0, 0.0)
        self._integral_mm_s = 0.0

    def start(self, sample: Sample) -> None:
        """See `Feedback`."""
        self._x = (sample.tension_n, sample.speed_mm_s)
        self._under_way = [sample.speed_mm_s] * len(self._under_way)
        self._integral_mm_s = 0.0

    def wanted(self, sample: Sample) -> float:
        """See `Feedback`; the state is predicted to the instant at which the command acts, as in our law."""
        (a, b), (c, d) = self._kalman
        tension_n, speed_mm_s = self._x
        missed_n, missed_mm_s = sample.tension_n - tension_n, sample.speed_mm_s - speed_mm_s
        corrected = tension_n + a * missed_n + b * missed_mm_s, speed_mm_s + c * missed_n + d * missed_mm_s
        self._x = tension_n, speed_mm_s = self._carried(*corrected, self._under_way[0])
        for command in self._under_way[1:]:
            tension_n, speed_mm_s = self._carried(tension_n, speed_mm_s, command)
        gains, ramp_mm_s = self.gains, sample.slope_n_s / self._stiffness
        return float(
            -gains.k_tension * (tension_n - sample.setpoint_n)
            - gains.k_speed * (speed_mm_s - ramp_mm_s)
            - self._integral_mm_s
        )

    def _carried(self, tension_n: float, speed_mm_s: float, command_mm_s: float) -> tuple[float, float]:
        """A tick on, under a command."""
        (a, b, c), (d, e, f) = self._step
        return (
            a * tension_n + b * speed_mm_s + c * command_mm_s,
            d * tension_n + e * speed_mm_s + f * command_mm_s,
        )

    def sent(self, command_mm_s: float) -> None:
        """See `Feedback`."""
        self._under_way = [*self._under_way[1:], command_mm_s]

    def integrate(self, error_n: float) -> None:
        """See `Feedback`."""
        self._integral_mm_s -= self.gains.k_integral * error_n * self._dt


def bryson(settings: RigSettings, stretch_mm: float = STRETCH_MM, held_s: float = HELD_S) -> Gains:
    """Gains by Bryson's rule; our weights apply to stretch, with a weight of 1 on the command."""
    weight = (settings.tension.speed_max_mm_s / stretch_mm) ** 2
    weights = {"stretch_weight": weight, "integral_weight": weight / held_s**2, "command_weight": 1.0}
    return design(changed(settings, {f"design.{key}": value for key, value in weights.items()}))


def kalman_gain(settings: RigSettings, disturbance_mm_s: float | None = None) -> Array:
    """Settled gain, states by (tension, speed), shape (2, 2): ``x += gain (y - x)``."""
    import control  # 0.5 s: only where a law is made

    model = filter_model(settings)
    moved_n = settings.plant.stiffness_n_mm * (disturbance_mm_s or settings.tension.speed_max_mm_s) * model.period_s
    q = np.diag([moved_n**2, model.q[1, 1]])
    r = np.diag([model.cell_variance_n2, model.speed_variance_mm2_s2])
    _, before, _ = control.dlqe(model.f[:2, :2], np.eye(2), np.eye(2), q, r, method="scipy")
    gain: Array = np.linalg.solve(before + r, before).T
    return gain
