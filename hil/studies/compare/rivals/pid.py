"""PID of the library simple-pid on the cell's tension, with the stretch of the inclined rope fed forward."""

from __future__ import annotations

import math

from simple_pid import PID

from hil.studies.compare.rivals.feedback import Feedback, Model, Sample
from hil.studies.compare.rivals.proportional import INTEGRAL_RATIO

FILTER_RATIO = 3.0
"""Derivative time over filter time; 2 to 20 is usual (Astrom, Haegglund: Advanced PID Control, 2006, section 3.3)."""
STRETCH_LAG_S = 0.1
"""Low-pass of the stretch: one quantum of 0.01 deg at 0.7 deg of lag, 4 um, then causes 0.04 mm/s."""


class PidFeedForward(Feedback):
    """SIMC-PID (Skogestad 2003) for an integrating process with lag, series form, tightest ``tau_c = theta``.

    ``Kc = 1 / (k (tau_c + theta))``, ``tau_I = 4 (tau_c + theta)``, ``tau_D = lag``; the measurement is filtered, and
    by the half rule half the filter counts as delay and half as lag. The rope's stretch is fed forward in position
    form, ``L (1 / cos theta - 1)``, low-passed; the cylinder follows its rate.
    """

    def __init__(
        self,
        model: Model,
        speed_max_mm_s: float,
        rope_length_mm: float,
        *,
        slowness_s: float | None = None,
        integral_ratio: float = INTEGRAL_RATIO,
        derivative_s: float | None = None,
        filter_s: float | None = None,
    ) -> None:
        """Each time, and ``slowness_s`` (``tau_c + theta``), replaces that of the rule."""
        # tau_F = tau_D / N and tau_D = lag + tau_F / 2
        self.filter_s = filter_s or model.lag_s / (FILTER_RATIO - 0.5)
        self.derivative_time_s = derivative_s or model.lag_s + 0.5 * self.filter_s
        slowness_s = slowness_s or 2.0 * (model.delay_s + 0.5 * self.filter_s)
        self.integral_time_s = integral_ratio * slowness_s
        series = 1.0 / (model.stiffness_n_mm * slowness_s)
        self.gain = series * (1.0 + self.derivative_time_s / self.integral_time_s)  # of the parallel form
        self._dt = model.period_s
        self._share = 1.0 - math.exp(-model.period_s / self.filter_s)
        self._length_mm = rope_length_mm
        self._pid = PID(
            self.gain,
            series / self.integral_time_s,
            series * self.derivative_time_s,
            sample_time=None,
            output_limits=(-speed_max_mm_s, speed_max_mm_s),  # simple-pid's anti-windup
            differential_on_measurement=False,  # the ramp is smooth, and known
            time_fn=lambda: 0.0,  # time comes with the tick
        )
        self._tension_n = self._stretch_mm = 0.0

    def start(self, sample: Sample) -> None:
        """See `Feedback`."""
        self._pid.reset()
        self._tension_n = sample.tension_n
        self._stretch_mm = self._stretch(sample)

    def wanted(self, sample: Sample) -> float:
        """See `Feedback`."""
        self._tension_n += self._share * (sample.tension_n - self._tension_n)
        self._pid.setpoint = sample.setpoint_n
        speed_mm_s = self._pid(self._tension_n, dt=self._dt)
        assert speed_mm_s is not None  # simple-pid is in automatic mode
        growth_mm_s = (self._stretch(sample) - self._stretch_mm) / STRETCH_LAG_S
        self._stretch_mm += growth_mm_s * self._dt
        return speed_mm_s - growth_mm_s

    def _stretch(self, sample: Sample) -> float:
        cosine = math.cos(sample.tangential_rad) * math.cos(sample.normal_rad)
        return self._length_mm * (1.0 / cosine - 1.0)
