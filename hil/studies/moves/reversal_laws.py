"""Our law with what was tried against friction at the reversal; none of it is in the product (docs/reversal.md)."""

from __future__ import annotations

import math
from typing import Literal

from rigctl.config.settings import RigSettings
from rigctl.control.bus.inbox import Inbox
from rigctl.control.law.inclination import InclinationFilter
from rigctl.control.law.tension import Estimate, Gains, TensionLaw

ACCELERATION_S = 0.1
"""Low-pass of the angular acceleration: the difference of a filtered rate is mostly noise."""


class Dithered(TensionLaw):
    """A sine on the stroke while COMPENSATING; the command is larger by what the drive's lag takes away."""

    def __init__(self, settings: RigSettings, gains: Gains, amplitude_mm: float, frequency_hz: float) -> None:
        super().__init__(settings, gains)
        omega = 2.0 * math.pi * frequency_hz
        self._turn = omega / settings.loop.rate_hz
        self._amplitude_mm_s = amplitude_mm * omega * math.hypot(1.0, omega * settings.plant.cylinder_lag_s)
        self._phase = 0.0

    def compensating(self, estimate: Estimate, cosine: float, added_mm_s: float = 0.0) -> float:
        """The law's command with the sine added."""
        self._phase = (self._phase + self._turn) % math.tau
        return super().compensating(estimate, cosine, added_mm_s + self._amplitude_mm_s * math.cos(self._phase))


class Predicting(TensionLaw):
    """The stretch by inclination, fed forward as it will be when the cylinder follows.

    With the stretch's speed ``L x x'`` of an axis, its change within the delay and the lag is ``L (x'^2 + x x'')``
    times that time; ``by`` says whether x'' is taken from the rate's low-passed slope or left out.
    """

    def __init__(self, settings: RigSettings, gains: Gains, inbox: Inbox, by: Literal["rate", "acceleration"]) -> None:
        super().__init__(settings, gains)
        self._inbox, self._slope = inbox, InclinationFilter(settings)
        plant = settings.plant
        self._length_s_mm = plant.rope_length_mm * (plant.command_delay_s + plant.cylinder_lag_s)
        self._dt = 1.0 / settings.loop.rate_hz
        self._bends = by == "acceleration"
        self._slow = [0.0, 0.0]

    def compensating(self, estimate: Estimate, cosine: float, added_mm_s: float = 0.0) -> float:
        """The law's command with the disturbance ahead of the filter's."""
        inbox, slope = self._inbox, self._slope
        if inbox.slope_fresh:
            slope.update(inbox.slope.tangential_rad, inbox.slope.normal_rad)
        else:
            slope.absent()
        slope.pass_ticks(1)
        tangential, tangential_rate, normal, normal_rate = slope.state
        change = 0.0
        for axis, (angle, rate) in enumerate(((tangential, tangential_rate), (normal, normal_rate))):
            acceleration = (rate - self._slow[axis]) / ACCELERATION_S
            self._slow[axis] += acceleration * self._dt
            change += rate * rate + (angle * acceleration if self._bends else 0.0)
        ahead = estimate.disturbance_mm_s + self._length_s_mm * change
        return super().compensating(estimate._replace(disturbance_mm_s=ahead), cosine, added_mm_s)
