"""Rope force per ampere of the motor's current, and the cylinder's friction, from the steps of `identify` up and down.

While the stroke moves at a constant speed the motor carries the tension T and a friction R that is against the motion:

    K I_up = T_up + R        K I_down = T_down - R

so that a pair of steps has both K and R. T is the cell's: a cell of wrong scale gives a K that is wrong by as much. At
one tension a friction that grows with the load is part of R; the way up then has a force per ampere lower than K.

The drive sends its current at the rate of its status, so only the end of a step is taken: the drive has reached its
speed, and the newest status is of after that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rigctl.commission.identification import MOVING_MM_S, Drive, Estimated, Pairs, TrialSignals, student_t
from rigctl.commission.motion import Array
from rigctl.devices.objects import PER_CURRENT_UNIT

SETTLED_LAGS = 3.0  # after a step of the command: 95 % of the speed
FEWEST_TICKS = 10  # of each step
FEWEST_PAIRS = 4


class MotorForce(NamedTuple):
    """Rope force per ampere in N/A and friction in N, or ``why`` they are not known."""

    n_per_a: Estimated | None = None
    friction_n: Estimated | None = None
    why: str = ""


def motor_force(
    signals: TrialSignals, pairs: Pairs, drive: Drive, status_s: float, rated_a: float | None
) -> MotorForce:
    """``status_s``: period of the drive's status, 0 without one; ``rated_a``: of the motor."""
    if not status_s or rated_a is None:
        return MotorForce(why="the drive is not asked for its current: cylinder.status_rate_hz")
    wait_s = SETTLED_LAGS * drive.lag_s.value + drive.delay_s.value + status_s
    means = [_means(signals, where, wait_s, status_s) for where in pairs.kept]
    found = np.array([pair for pair in means if pair is not None])
    if len(found) < FEWEST_PAIRS:
        return MotorForce(why=f"the current is not known at the end of steps, {wait_s:.2g} s after their begin")
    up_a, up_n, down_a, down_n = found.T
    if float((up_a + down_a).min()) <= 0.0:
        return MotorForce(why="the motor's current does not carry the load")
    factor = (up_n + down_n) / (up_a + down_a)
    friction = 0.5 * (factor * (up_a - down_a) - (up_n - down_n))
    n_per_a = float(factor.mean())
    rounding_a = 0.5 * rated_a * PER_CURRENT_UNIT  # the same in every pair
    rounding_n = n_per_a * rounding_a
    error = _scatter(factor) + n_per_a * rounding_a / float(0.5 * (up_a + down_a).mean())
    return MotorForce(Estimated(n_per_a, error), Estimated(float(friction.mean()), _scatter(friction) + rounding_n))


def _means(signals: TrialSignals, where: slice, wait_s: float, status_s: float) -> list[float] | None:
    """Mean current and tension at the end of the step up and of that down; None where they are not known."""
    found = []
    for sign in (1.0, -1.0):
        ticks = where.start + np.flatnonzero(sign * signals.command[where] > MOVING_MM_S)
        ticks = ticks[signals.at_s[ticks] >= signals.at_s[ticks[:1]] + wait_s] if len(ticks) else ticks
        if len(ticks) < FEWEST_TICKS or not np.isfinite(signals.current[ticks]).all():
            return None
        # The current is half a period of the status old, in the mean.
        tension_n = np.interp(signals.at_s[ticks] - 0.5 * status_s, signals.at_s, signals.tension)
        found += [float(signals.current[ticks].mean()), float(tension_n.mean())]
    return found


def _scatter(values: Array) -> float:
    """Expanded uncertainty of the mean."""
    return student_t(len(values) - 1) * float(values.std(ddof=1)) / math.sqrt(len(values))
