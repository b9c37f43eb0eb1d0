"""P and PI on the cell's tension."""

from __future__ import annotations

import math

from scipy.optimize import brentq

from hil.studies.compare.rivals.feedback import Feedback, Model, Sample

ULTIMATE_SHARE = 0.5
INTEGRAL_RATIO = 4.0
"""SIMC's integral time over ``tau_c + theta``."""


def ultimate(model: Model) -> tuple[float, float]:
    """Gain (mm/s per N) and frequency (rad/s) at which a proportional loop on the model oscillates steadily.

    The phase of ``1/s e^(-delay s)/(lag s + 1)`` is -180 deg where ``w delay + atan(w lag)`` is 90 deg.
    """

    def short_of(w: float) -> float:
        return w * model.delay_s + math.atan(w * model.lag_s) - 0.5 * math.pi

    w = float(brentq(short_of, 0.0, 0.5 * math.pi / model.delay_s))
    return w * math.hypot(1.0, w * model.lag_s) / model.stiffness_n_mm, w


class Proportional(Feedback):
    """P at half the ultimate gain (Ziegler, Nichols: Optimum settings for automatic controllers, Trans. ASME 1942)."""

    def __init__(self, model: Model, share: float = ULTIMATE_SHARE) -> None:
        """``share``: of the ultimate gain."""
        self.gain = share * ultimate(model)[0]  # mm/s per N

    def start(self, _sample: Sample) -> None:
        """See `Feedback`; the law has no memory."""

    def wanted(self, sample: Sample) -> float:
        """See `Feedback`."""
        return self.gain * (sample.setpoint_n - sample.tension_n)


class ProportionalIntegral(Feedback):
    """SIMC-PI (Skogestad: Simple analytic rules for model reduction and PID controller tuning, J. Proc. Control 2003).

    Half rule: half the drive's lag counts as delay, ``theta = delay + lag / 2``. Integrating process, tightest
    recommended ``tau_c = theta``: ``Kc = 1 / (k (tau_c + theta))``, ``tau_I = 4 (tau_c + theta)``.
    """

    def __init__(self, model: Model, slowness_s: float | None = None, integral_ratio: float = INTEGRAL_RATIO) -> None:
        """``slowness_s`` replaces the tightest ``tau_c + theta``; ``integral_ratio``: integral time over it."""
        slowness_s = slowness_s or 2.0 * (model.delay_s + 0.5 * model.lag_s)
        self.gain = 1.0 / (model.stiffness_n_mm * slowness_s)  # mm/s per N
        self.integral_time_s = integral_ratio * slowness_s
        self._per_tick = self.gain * model.period_s / self.integral_time_s
        self._integral_mm_s = 0.0

    def start(self, _sample: Sample) -> None:
        """See `Feedback`."""
        self._integral_mm_s = 0.0

    def wanted(self, sample: Sample) -> float:
        """See `Feedback`."""
        return self.gain * (sample.setpoint_n - sample.tension_n) + self._integral_mm_s

    def integrate(self, error_n: float) -> None:
        """See `Feedback`."""
        self._integral_mm_s += self._per_tick * error_n
