"""Tracks of moves with trapezoidal speed, in closed form."""

from __future__ import annotations

import math

import numpy as np

from hil.plant.inputs import Track

Row = tuple[float, float, float, float, float]


def leg(start_s: float, origin: float, target: float, speed: float, acceleration: float) -> tuple[list[Row], float]:
    """Segments of one move from rest to rest and the time it ends; too short for the speed, it is a triangle.

    Args:
        start_s: when it starts.
        origin, target: where from and where to (rad or mm).
        speed, acceleration: bounds, positive, per s and per s2.
    """
    way = abs(target - origin)
    if way == 0.0:
        return [(start_s, origin, 0.0, 0.0, 0.0)], start_s
    sign = math.copysign(1.0, target - origin)
    top = min(speed, math.sqrt(way * acceleration))
    ramp_s = top / acceleration
    cruise_s = max(0.0, way / top - ramp_s)  # of a triangle, rounding may make it negative
    bend = 0.5 * sign * acceleration
    ramp = bend * ramp_s * ramp_s
    end_s = start_s + 2.0 * ramp_s + cruise_s
    rows = [
        (start_s, origin, 0.0, bend, 0.0),
        (start_s + ramp_s, origin + ramp, sign * top, 0.0, 0.0),
        (start_s + ramp_s + cruise_s, target - ramp, sign * top, -bend, 0.0),
        (end_s, target, 0.0, 0.0, 0.0),
    ]
    return rows, end_s


def out_and_back(angle_rad: float, speed_rad_s: float, acceleration_rad_s2: float, start_s: float = 0.0) -> Track:
    """Out by an angle and back to the start, with a stop and a reversal between; the paper's section 2.3.

    Args:
        angle_rad: reversal point, positive.
        speed_rad_s: cruising speed, positive.
        acceleration_rad_s2: of every ramp, positive.
        start_s: when it starts.
    """
    out, turn_s = leg(start_s, 0.0, angle_rad, speed_rad_s, acceleration_rad_s2)
    back, end_s = leg(turn_s, angle_rad, 0.0, speed_rad_s, acceleration_rad_s2)
    return Track(segments=np.array(out[:-1] + back), end=end_s)
