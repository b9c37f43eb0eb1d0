"""Drive lag and delay, stiffness, backlash and noise from the records of an excitation. Pure functions of arrays.

The excitation (`rigctl.control.trials.Excitation`) is a rest, then pairs of small steps of speed up and down. Each
quantity is fitted over all pairs; its standard error is the scatter of the fits to single pairs over the square root of
their number, so that it holds whatever the noise is like. What is the same in every pair is not in it: the screw's
pitch error over this stroke (0.003 mm of 0.75 mm is 0.4 % of the stiffness), or how the drive measures its speed (half
of its period counts as delay).

    tau dv/dt = u(t - Td) - v       fitted to the speed the drive reports, delay at any fraction of a tick
    T = T0 + drift t + k q(s) + c v  q: the stroke behind a play of the width of the backlash

As in the estimator, a sample latched by the SYNC of tick n - 1 is read in tick n: that one tick is not in ``Td``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LATCH_TICKS = 1.0
MOVING_MM_S = 1e-6
FEWEST_PAIRS = 3
_DELAYS = np.arange(0.0, 41.0, 2.0)  # ticks, where the search begins
_LAGS_S = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1)
_ITERATIONS = 12
_LOOKS, _PLAY_STEPS = 12, 16
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_NOISE_WINDOW_S = 0.1  # slower than this is motion, not noise


class IdentificationError(ValueError):
    """The records do not tell; ``str()`` says why, in one line."""


@dataclass(frozen=True)
class Estimate:
    """A value and its standard error."""

    value: float
    error: float


@dataclass(frozen=True)
class Signals:
    """Columns of the records, one value per tick: s, mm, mm/s, mm/s, N. ``speed`` and ``tension`` as measured."""

    period_s: float
    command: Array
    stroke: Array
    speed: Array
    tension: Array

    def part(self, where: slice) -> Signals:
        """Some of the ticks."""
        return Signals(self.period_s, self.command[where], self.stroke[where], self.speed[where], self.tension[where])


@dataclass(frozen=True)
class Drive:
    """Lag and delay in s, steady speed over commanded speed."""

    lag_s: Estimate
    delay_s: Estimate
    gain: Estimate


@dataclass(frozen=True)
class Rope:
    """Stiffness in N/mm and backlash in mm."""

    stiffness_n_mm: Estimate
    backlash_mm: Estimate


def pairs_of(command: Array) -> list[slice]:
    """Where each pair of steps is: from its first command up to that of the next.

    Raises:
        IdentificationError: there are too few.
    """
    moving = np.flatnonzero(np.abs(command) > MOVING_MM_S)
    if not len(moving):
        raise IdentificationError("nothing was commanded in these records")
    rises = moving[(moving > 0) & (np.abs(command[moving - 1]) <= MOVING_MM_S) & (command[moving] > 0.0)]
    if len(rises) < FEWEST_PAIRS:
        raise IdentificationError(f"{len(rises)} pairs of steps in these records, {FEWEST_PAIRS} are needed")
    length = int(np.min(np.diff(rises)))
    return [slice(int(rise), min(int(rise) + length, len(command))) for rise in rises]


def drive(signals: Signals) -> Drive:
    """Fit lag, delay and gain of the drive."""
    everything = _fit_drive(signals, None)
    # One pair sees the step before it in its first ticks only; half of a rest is far beyond that.
    single = np.array([_fit_drive(signals.part(where), everything) for where in pairs_of(signals.command)])
    errors = single.std(axis=0, ddof=1) / math.sqrt(len(single))
    (lag_s, delay, gain), (lag_error, delay_error, gain_error) = everything, errors.tolist()
    period = signals.period_s
    return Drive(
        Estimate(lag_s, lag_error),
        Estimate((delay - LATCH_TICKS) * period, delay_error * period),
        Estimate(gain, gain_error),
    )


def _fit_drive(signals: Signals, start: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """Lag in s, whole delay in ticks, gain: least squares, Gauss-Newton in the first two."""

    def solve(lag_s: float, delay: float) -> tuple[Array, float]:
        shape = response(signals.command, signals.period_s / lag_s, delay)
        columns = np.column_stack([shape, np.ones_like(shape)])
        weights, *_ = np.linalg.lstsq(columns, signals.speed, rcond=None)
        return signals.speed - columns @ weights, float(weights[0])

    def cost(lag_s: float, delay: float) -> float:
        residual, _ = solve(lag_s, delay)
        return float(residual @ residual)

    lag_s, delay = (
        start[:2] if start else min(((a, d) for a in _LAGS_S for d in _DELAYS.tolist()), key=lambda p: cost(*p))
    )
    best = cost(lag_s, delay)
    for _ in range(_ITERATIONS):
        residual, _ = solve(lag_s, delay)
        steps = 0.01 * lag_s, 0.05
        slopes = np.column_stack(
            [
                (residual - solve(lag_s + steps[0], delay)[0]) / steps[0],
                (residual - solve(lag_s, delay + steps[1])[0]) / steps[1],
            ]
        )
        move, *_ = np.linalg.lstsq(slopes, residual, rcond=None)
        for shorter in (1.0, 0.5, 0.25, 0.125):
            tried = max(lag_s + shorter * float(move[0]), 1e-4), max(delay + shorter * float(move[1]), 0.0)
            if (found := cost(*tried)) < best:
                (lag_s, delay), best = tried, found
                break
        else:
            break
    return lag_s, delay, solve(lag_s, delay)[1]


def response(command: Array, share: float, delay: float) -> Array:
    """First-order response with unit gain to a command held over each tick, ``delay`` ticks late.

    ``share``: tick over lag. Exact between the ticks too: the delay may be any number of them.
    """
    decay = math.exp(-share)
    state, states = 0.0, []
    values: list[float] = command.tolist()
    for value in values:
        states.append(state)
        state = value + (state - value) * decay
    whole = math.ceil(delay)
    late_by = whole - delay
    held, reached = np.array(values), np.array(states)
    found = held + (reached - held) * math.exp(-share * late_by)
    return np.concatenate([np.zeros(whole), found])[: len(command)]


def rope(signals: Signals) -> Rope:
    """Fit stiffness and backlash; the first pair is left out, for where in its play the nut begins is not known."""
    pairs = pairs_of(signals.command)[1:]
    after_first = slice(pairs[0].start, pairs[-1].stop)
    reach_mm = float(np.ptp(signals.stroke[after_first]))
    stiffness, backlash = _fit_rope(signals, after_first, reach_mm)
    single = np.array([_fit_rope(signals, part, reach_mm) for part in pairs])
    errors = single.std(axis=0, ddof=1) / math.sqrt(len(single))
    return Rope(Estimate(stiffness, float(errors[0])), Estimate(backlash, float(errors[1])))


def _fit_rope(signals: Signals, part: slice, reach_mm: float) -> tuple[float, float]:
    """Stiffness and backlash: the play that leaves least, by search; all else by linear least squares."""
    where = np.arange(part.start, part.stop)
    before = max(0, 2 * part.start - part.stop)  # as long again: the play there tells where in it the nut begins
    stroke = signals.stroke[before : part.stop]
    time = (where - where.mean()) * signals.period_s

    def solve(play_mm: float) -> tuple[float, float]:
        nut = behind_play(stroke, play_mm)[part.start - before :]
        columns = np.column_stack([nut - nut.mean(), signals.speed[where], time, np.ones(len(where))])
        weights, *_ = np.linalg.lstsq(columns, signals.tension[where], rcond=None)
        residual = signals.tension[where] - columns @ weights
        return float(residual @ residual), float(weights[0])

    play = _least(lambda b: solve(b)[0], 0.0, 0.9 * reach_mm)
    return solve(play)[1], play


def behind_play(stroke: Array, play_mm: float) -> Array:
    """Where a nut with ``play_mm`` of play is, pushed by the screw from either side."""
    nut, found = float(stroke[0]), []
    half = 0.5 * play_mm
    values: list[float] = stroke.tolist()
    for value in values:
        nut = min(max(nut, value - half), value + half)
        found.append(nut)
    return np.array(found)


def _least(cost: Callable[[float], float], low: float, high: float) -> float:
    """Where ``cost`` is least: a coarse look, then golden section."""
    looks = np.linspace(low, high, _LOOKS)
    best = int(np.argmin([cost(float(at)) for at in looks]))
    low, high = float(looks[max(best - 1, 0)]), float(looks[min(best + 1, len(looks) - 1)])
    for _ in range(_PLAY_STEPS):
        a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        low, high = (low, b) if cost(a) < cost(b) else (a, high)
    return 0.5 * (low + high)


def noise(values: Array, period_s: float) -> Estimate:
    """Rms at rest, about a straight line over each tenth of a second: slower than that is motion, not noise."""
    length = max(8, round(_NOISE_WINDOW_S / period_s))
    count = len(values) // length
    if count == 0:
        raise IdentificationError(f"{len(values)} samples at rest, {length} are needed")
    time = np.linspace(-1.0, 1.0, length)
    columns = np.column_stack([time, np.ones(length)])
    squares = 0.0
    for block in values[: count * length].reshape(count, length):
        weights, *_ = np.linalg.lstsq(columns, block, rcond=None)
        residual = block - columns @ weights
        squares += float(residual @ residual)
    freedom = count * (length - 2)
    rms = math.sqrt(squares / freedom)
    return Estimate(rms, rms / math.sqrt(2.0 * freedom))
