"""Linear active disturbance rejection control."""

from __future__ import annotations

import math
from collections import deque

from hil.studies.compare.rivals.feedback import Feedback, Model, Sample

BANDWIDTH_DELAY = 0.12
"""Controller's bandwidth times delay; at the observer's the delay then costs 28 deg of phase."""
OBSERVER_RATIO = 4.0
"""Observer's bandwidth over the controller's; Gao gives 3 to 5."""


class Adrc(Feedback):
    """Second-order ADRC by bandwidth parametrisation (Gao: Scaling and bandwidth-parameterization, ACC 2003).

    ``T'' = f + b0 u`` with ``b0 = k / lag``. The extended state observer (tension, its rate, f) has all its poles at
    ``omega_o``, the controller at ``omega_c``. Sampled as a current observer (Miklosovic, Radke, Gao, ACC 2006), its
    input delayed as the plant's is (Zhao, Gao, ISA Transactions 2014).
    """

    def __init__(
        self, model: Model, bandwidth_rad_s: float | None = None, observer_ratio: float = OBSERVER_RATIO
    ) -> None:
        """``bandwidth_rad_s`` of the controller, and ``observer_ratio``: that of the observer over it."""
        self.bandwidth_rad_s = bandwidth_rad_s or BANDWIDTH_DELAY / model.delay_s
        self.observer_rad_s = observer_ratio * self.bandwidth_rad_s
        self._dt = model.period_s
        self._b0 = model.stiffness_n_mm / model.lag_s
        beta = math.exp(-self.observer_rad_s * model.period_s)
        self.observer_gains = (
            1.0 - beta**3,
            1.5 * (1.0 - beta) ** 2 * (1.0 + beta) / self._dt,
            (1.0 - beta) ** 3 / self._dt**2,
        )
        self._under_way: deque[float] = deque([0.0] * model.command_delay_ticks, model.command_delay_ticks)
        self._z = (0.0, 0.0, 0.0)
        self._stiffness = model.stiffness_n_mm

    def start(self, sample: Sample) -> None:
        """See `Feedback`; the cylinder's speed stands for the earlier commands."""
        speed = sample.speed_mm_s
        self._under_way.extend([speed] * len(self._under_way))
        rate = self._stiffness * speed
        self._z = sample.tension_n - rate * self._dt, rate, -self._b0 * speed

    def wanted(self, sample: Sample) -> float:
        """See `Feedback`."""
        dt, (l1, l2, l3), (z1, z2, z3) = self._dt, self.observer_gains, self._z
        push = z3 + self._b0 * self._under_way[0]
        z1 += dt * (z2 + 0.5 * dt * push)
        z2 += dt * push
        missed = sample.tension_n - z1
        z1, z2, z3 = self._z = z1 + l1 * missed, z2 + l2 * missed, z3 + l3 * missed
        w = self.bandwidth_rad_s
        desired = w * w * (sample.setpoint_n - z1) + 2.0 * w * (sample.slope_n_s - z2)
        return (desired - z3) / self._b0 - sample.slope_n_s / self._stiffness

    def sent(self, command_mm_s: float) -> None:
        """See `Feedback`."""
        self._under_way.append(command_mm_s)
