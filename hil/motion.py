"""Prescribed moves of the mechanism, in closed form: angle and speed at any time, no integration."""

from __future__ import annotations

import math
from typing import Protocol


class Motion(Protocol):
    """A move about the mechanism's shaft."""

    @property
    def duration_s(self) -> float:
        """Time from start to standstill."""

    def at(self, t_s: float) -> tuple[float, float]:
        """Angle (rad, from the start) and speed (rad/s) ``t_s`` after the start."""


class OutAndBack:
    """Out by an angle and back to the start, each way with a trapezoidal speed, a stop and a reversal between.

    The paper's section 2.3 is 13 deg at 0.5 deg/s. An angle too short for the speed is run as a triangle.

    Args:
        angle_rad: reversal point, positive.
        speed_rad_s: cruising speed, positive.
        acceleration_rad_s2: of every ramp, positive.
    """

    __slots__ = ("_acceleration", "_angle", "_leg_s", "_ramp_s", "_speed", "duration_s")

    def __init__(self, angle_rad: float, speed_rad_s: float, acceleration_rad_s2: float) -> None:
        self._angle = angle_rad
        self._acceleration = acceleration_rad_s2
        self._speed = min(speed_rad_s, math.sqrt(angle_rad * acceleration_rad_s2))
        self._ramp_s = self._speed / acceleration_rad_s2
        self._leg_s = angle_rad / self._speed + self._ramp_s
        self.duration_s = 2.0 * self._leg_s

    def at(self, t_s: float) -> tuple[float, float]:
        """Angle (rad) and speed (rad/s); at rest at angle 0 before the start and after the end."""
        if t_s <= 0.0 or t_s >= self.duration_s:
            return 0.0, 0.0
        if t_s <= self._leg_s:
            return self._leg(t_s)
        angle, speed = self._leg(self.duration_s - t_s)
        return angle, -speed

    def _leg(self, t_s: float) -> tuple[float, float]:
        if t_s > 0.5 * self._leg_s:  # the second half is the first one seen from the other end
            angle, speed = self._leg(self._leg_s - t_s)
            return self._angle - angle, speed
        if t_s < self._ramp_s:
            return 0.5 * self._acceleration * t_s * t_s, self._acceleration * t_s
        return self._speed * (t_s - 0.5 * self._ramp_s), self._speed
