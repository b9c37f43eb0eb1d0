"""PI with a disturbance observer."""

from __future__ import annotations

import math
from collections import deque

from hil.studies.compare.rivals.feedback import Feedback, Model, Sample
from hil.studies.compare.rivals.proportional import INTEGRAL_RATIO, ProportionalIntegral

BANDWIDTH_DELAY = 1.0 / 3.0
"""Bandwidth of Q times delay: there the delay costs 19 deg of phase."""
RATIO = 5.0
"""Bandwidth of Q over the PI's crossover: the PI does not reject again what the observer rejects."""


class DisturbanceObserver(Feedback):
    """SIMC-PI inside, and the disturbance observer of Ohnishi (1987; Sariyildiz, Oboe, Ohnishi, IEEE TIE 2020).

    ``d = Q (s (lag s + 1) / k T - e^(-delay s) u)`` with ``Q = (g / (s + g))^2``, subtracted from the PI's command:
    the disturbance's speed as if it were added to the command. The PI has SIMC's other parameter, ``tau_c``, so long
    that its crossover ``1 / (tau_c + theta)`` is a fifth of g; at ``tau_c = theta`` Ms would be 1.8.
    """

    def __init__(
        self,
        model: Model,
        bandwidth_rad_s: float | None = None,
        slowness_s: float | None = None,
        integral_ratio: float = INTEGRAL_RATIO,
    ) -> None:
        """``bandwidth_rad_s`` of Q, and the two parameters of the PI, replace those of the rules."""
        self.bandwidth_rad_s = bandwidth_rad_s or BANDWIDTH_DELAY / model.delay_s
        self._inner = ProportionalIntegral(model, slowness_s or RATIO / self.bandwidth_rad_s, integral_ratio)
        self._share = 1.0 - math.exp(-self.bandwidth_rad_s * model.period_s)
        self._rate = self._share / model.period_s  # of the sampled low-pass: its own difference is its derivative
        self._stiffness, self._lag_s = model.stiffness_n_mm, model.lag_s
        self._under_way: deque[float] = deque([0.0] * model.command_delay_ticks, model.command_delay_ticks)
        self._tension = [0.0, 0.0]
        self._command = [0.0, 0.0]

    def start(self, sample: Sample) -> None:
        """See `Feedback`; the cylinder's speed stands for the earlier commands."""
        self._inner.start(sample)
        speed = sample.speed_mm_s
        self._under_way.extend([speed] * len(self._under_way))
        slope = self._stiffness * speed
        first = sample.tension_n - slope / self._rate
        self._tension = [first, first - slope / self._rate]
        self._command = [speed, speed]

    def wanted(self, sample: Sample) -> float:
        """See `Feedback`."""
        (t1, t2), (u1, u2), share = self._tension, self._command, self._share
        first_rate = self._rate * (sample.tension_n - t1)
        rate = self._rate * (t1 - t2)
        bend = self._rate * (first_rate - rate)
        u1 += share * (self._under_way[0] - u1)
        u2 += share * (u1 - u2)
        t2 += share * (t1 - t2)
        t1 += share * (sample.tension_n - t1)
        self._tension, self._command = [t1, t2], [u1, u2]
        disturbance_mm_s = (rate + self._lag_s * bend) / self._stiffness - u2
        return self._inner.wanted(sample) - disturbance_mm_s

    def sent(self, command_mm_s: float) -> None:
        """See `Feedback`."""
        self._under_way.append(command_mm_s)

    def integrate(self, error_n: float) -> None:
        """See `Feedback`."""
        self._inner.integrate(error_n)
