"""Drive lag and delay, stiffness, backlash and noise from the records of an excitation. Pure functions of arrays.

The excitation (`rigctl.control.trials.Excitation`) is a rest, then pairs of small steps of speed up and down, the first
of them shorter. Each quantity is fitted over all pairs and stated with its expanded uncertainty at 95 % (JCGM 100,
Student's t for the number of pairs). That has two parts: the scatter of the fits to single pairs, which holds for any
kind of noise, and errors that are the same in every pair (the screw's pitch error, the drive's own cycle).

    tau dv/dt = u(t - Td) - v, ds/dt = v   fitted to the position, which the drive latches at the SYNC
    T = T0 + drift t + k q(s) + c v        q: the stroke behind a play of the width of the backlash

The speed a drive reports is not latched but a mean over some time before: its age is its delay less that of the
position. As in the estimator, a sample latched by the SYNC of tick n - 1 is read in tick n; ``Td`` does not include
that tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rigctl.commission.motion import Array, behind_play, delayed, response
from rigctl.config import quantity
from rigctl.devices.objects import MM_PER_POSITION_UNIT

LATCH_TICKS = 1.0
PITCH_ERROR_MM, PITCH_LEAD_MM = 0.003, 5.0  # of a screw of class C7, as a sine over a turn; no encoder shows it
PITCH_SHARE = 2.0 * math.pi * PITCH_ERROR_MM / PITCH_LEAD_MM  # of a small stroke, at most
DRIVE_CYCLE_S = 0.125e-3  # a servo drive takes a command at its own cycle, which is not in phase with the bus
ROUNDING_MM = 2.0 * MM_PER_POSITION_UNIT / math.sqrt(12.0)  # at 95 %, taken as normal
SHORTEST = 0.5  # of the longest step: shorter steps are the careful first ones and are not fitted
MOVING_MM_S = 1e-6
FEWEST_PAIRS = 3
_DELAYS = range(0, 41, 2)  # ticks, start values of the search
_LAGS_S = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1)
_ITERATIONS = 12
_LOOKS, _PLAY_STEPS = 12, 16
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_NOISE_WINDOW_S = 0.1  # slower changes are motion, not noise


class IdentificationError(ValueError):
    """The records do not determine the plant; ``str()`` says why, in one line."""


@dataclass(frozen=True)
class Estimated:
    """A value and its expanded uncertainty at 95 %."""

    value: float
    error: float


@dataclass(frozen=True)
class TrialSignals:
    """Columns of the records, one value per tick: s, mm, mm/s, mm/s, N. ``speed`` and ``tension`` as measured."""

    period_s: float
    command: Array
    stroke: Array
    speed: Array
    tension: Array

    def part(self, where: slice) -> TrialSignals:
        """The signals over some of the ticks."""
        return TrialSignals(
            self.period_s, self.command[where], self.stroke[where], self.speed[where], self.tension[where]
        )


@dataclass(frozen=True)
class Drive:
    """Lag and delay in s, steady speed over commanded speed, age of the reported speed in s; fitted stroke in mm."""

    lag_s: Estimated
    delay_s: Estimated
    gain: Estimated
    speed_age_s: Estimated
    stroke: Array


@dataclass(frozen=True)
class Rope:
    """Stiffness in N/mm and backlash in mm."""

    stiffness_n_mm: Estimated
    backlash_mm: Estimated


def pairs_of(command: Array) -> list[slice]:
    """Ticks of each pair of steps: from its first command up to that of the next pair.

    Raises:
        IdentificationError: there are too few pairs.
    """
    moving = np.flatnonzero(np.abs(command) > MOVING_MM_S)
    if not len(moving):
        raise IdentificationError("nothing was commanded in these records")
    rises = moving[(moving > 0) & (np.abs(command[moving - 1]) <= MOVING_MM_S) & (command[moving] > 0.0)]
    if len(rises) < FEWEST_PAIRS:
        raise IdentificationError(f"{len(rises)} pairs of steps in these records, {FEWEST_PAIRS} are needed")
    ends = [*rises[1:].tolist(), min(len(command), int(2 * rises[-1] - rises[-2]))]
    found = [slice(int(rise), end) for rise, end in zip(rises, ends, strict=True)]
    strokes = [float(np.maximum(command[where], 0.0).sum()) for where in found]
    return [where for where, stroke in zip(found, strokes, strict=True) if stroke >= SHORTEST * max(strokes)]


def drive(signals: TrialSignals) -> Drive:
    """Fit lag, delay and gain of the drive."""
    everything = _fit_drive(signals, None)
    # A pair is affected by the step before it only in its first ticks, much less than half of a rest.
    pairs = pairs_of(signals.command)
    single = np.array([_fit_drive(signals.part(where), everything) for where in pairs])
    ages = np.array([_speed_delay(signals.part(where), everything) - everything[1] for where in pairs])
    (lag_s, delay, gain), errors, period = everything, _scatter(single), signals.period_s
    moved = gain * _moved(signals, lag_s, delay)
    fitted = moved - moved.mean() + signals.stroke.mean()
    exact = float(np.std(signals.stroke - fitted)) < MM_PER_POSITION_UNIT
    # The rounding of the position is nearly the same in every pair, so the scatter does not show it.
    rounded_s = ROUNDING_MM / float(np.abs(signals.command).max())
    rounded_share = ROUNDING_MM / float(np.ptp(fitted)) / math.sqrt(len(pairs))
    return Drive(
        Estimated(lag_s, math.hypot(float(errors[0]), DRIVE_CYCLE_S, rounded_s)),
        Estimated((delay - LATCH_TICKS) * period, math.hypot(float(errors[1]) * period, DRIVE_CYCLE_S, rounded_s)),
        Estimated(gain, math.hypot(float(errors[2]), gain * rounded_share)),
        Estimated(float(ages.mean()) * period, float(_scatter(ages[:, None])[0]) * period),
        fitted if exact else signals.stroke,
    )


def _scatter(single: Array) -> Array:
    """Expanded uncertainty of the mean of fits to single pairs (rows), from their scatter."""
    count = len(single)
    expanded: Array = student_t(count - 1) * single.std(axis=0, ddof=1) / math.sqrt(count)
    return expanded


def student_t(freedom: int) -> float:
    """97.5 % point of Student's t, by Cornish and Fisher's expansion (to 2 % from 3 degrees of freedom on)."""
    z = 1.959964
    terms = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96, (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    return float(z + sum(term / freedom**power for power, term in enumerate(terms, 1)))


def _moved(signals: TrialSignals, lag_s: float, delay: float) -> Array:
    """Stroke in mm of a drive with unit gain: the response and its integral, ds = u dt - tau dv."""
    held = delayed(signals.command, delay)
    swift = response(signals.command, signals.period_s / lag_s, delay)
    return held * signals.period_s - lag_s * swift


def _speed_delay(signals: TrialSignals, known: tuple[float, float, float]) -> float:
    """Delay in ticks of the reported speed, with lag and gain known."""
    lag_s, delay, gain = known

    def cost(tried: float) -> float:
        residual = signals.speed - gain * response(signals.command, signals.period_s / lag_s, tried)
        return float(residual @ residual)

    return _least(cost, max(0.0, delay - 5.0), delay + 20.0)


def _fit_drive(signals: TrialSignals, start: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """Lag in s, whole delay in ticks, gain: least squares, Gauss-Newton in the first two."""

    def solve(lag_s: float, delay: float) -> tuple[Array, float]:
        return _scaled(_moved(signals, lag_s, delay), signals.stroke)

    def cost(lag_s: float, delay: float) -> float:
        residual, _ = solve(lag_s, delay)
        return float(residual @ residual)

    lag_s, delay = start[:2] if start else _first_look(signals)
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


def _scaled(shape: Array, stroke: Array) -> tuple[Array, float]:
    """Residual of the measured stroke after a fit of ``shape`` by scale and offset; and the scale."""
    columns = np.column_stack([shape, np.ones_like(shape)])
    weights, *_ = np.linalg.lstsq(columns, stroke, rcond=None)
    return stroke - columns @ weights, float(weights[0])


def _first_look(signals: TrialSignals) -> tuple[float, float]:
    """Best lag in s and delay in ticks of a coarse grid; whole ticks, so that one response serves all delays."""
    left: dict[tuple[float, float], float] = {}
    for lag_s in _LAGS_S:
        prompt = _moved(signals, lag_s, 0.0)
        for delay in _DELAYS:
            shape = np.concatenate([np.zeros(delay), prompt])[: len(prompt)]
            residual, _ = _scaled(shape, signals.stroke)
            left[lag_s, float(delay)] = float(residual @ residual)
    return min(left, key=left.__getitem__)


def rope(signals: TrialSignals, drive: Drive, noise_n: float) -> Rope:
    """Fit stiffness and backlash; the first pair is left out, since the nut's place in its play is unknown there.

    ``noise_n``: upper bound of the cell's noise. A larger residual means that the model of a spring behind a play does
    not fit, and adds to both uncertainties.
    """
    signals = replace(signals, stroke=drive.stroke)
    pairs = pairs_of(signals.command)[1:]
    after_first = slice(pairs[0].start, pairs[-1].stop)
    reach_mm = float(np.ptp(signals.stroke[after_first]))
    stiffness, backlash, left_n, explained_n = _fit_rope(signals, after_first, reach_mm)
    single = np.array([_fit_rope(signals, part, reach_mm)[:2] for part in pairs])
    errors = _scatter(single)
    # The pitch error is the same in every pair: at worst, the part of its sine that lies in this stroke.
    pitch_mm = 2.0 * PITCH_ERROR_MM * math.sin(min(0.5, reach_mm / PITCH_LEAD_MM) * math.pi)
    misfit = 2.0 * math.sqrt(max(0.0, left_n**2 - noise_n**2)) / explained_n if explained_n else math.inf
    shares = drive.gain.error / drive.gain.value, misfit
    random_n_mm = math.hypot(float(errors[0]), *(stiffness * share for share in shares))
    return Rope(
        Estimated(stiffness, random_n_mm + abs(stiffness) * pitch_mm / reach_mm),  # a bound adds linearly
        Estimated(backlash, math.hypot(float(errors[1]), pitch_mm, reach_mm * misfit)),
    )


def _fit_rope(signals: TrialSignals, part: slice, reach_mm: float) -> tuple[float, float, float, float]:
    """Stiffness, backlash, rms of the residual and rms explained by the stroke in N.

    The play is found by search for the least residual, the rest by linear least squares.
    """
    where = np.arange(part.start, part.stop)
    before = max(0, 2 * part.start - part.stop)  # the ticks before show the nut's place in its play
    stroke = signals.stroke[before : part.stop]
    time = (where - where.mean()) * signals.period_s

    def solve(play_mm: float) -> tuple[float, float, float]:
        nut = behind_play(stroke, play_mm)[part.start - before :]
        columns = np.column_stack([nut - nut.mean(), signals.speed[where], time, np.ones(len(where))])
        weights, *_ = np.linalg.lstsq(columns, signals.tension[where], rcond=None)
        residual = signals.tension[where] - columns @ weights
        return float(residual @ residual), float(weights[0]), abs(float(weights[0])) * float(nut.std())

    play = _least(lambda b: solve(b)[0], 0.0, 0.9 * reach_mm)
    left, stiffness, explained_n = solve(play)
    return stiffness, play, math.sqrt(left / len(where)), explained_n


def _least(cost: Callable[[float], float], low: float, high: float) -> float:
    """The minimum of ``cost``, by a coarse grid, then golden section."""
    looks = np.linspace(low, high, _LOOKS)
    best = int(np.argmin([cost(float(at)) for at in looks]))
    low, high = float(looks[max(best - 1, 0)]), float(looks[min(best + 1, len(looks) - 1)])
    a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    cost_a, cost_b = cost(a), cost(b)
    for _ in range(_PLAY_STEPS):
        if cost_a < cost_b:
            high, b, cost_b = b, a, cost_a
            a = high - _GOLDEN * (high - low)
            cost_a = cost(a)
        else:
            low, a, cost_a = a, b, cost_b
            b = low + _GOLDEN * (high - low)
            cost_b = cost(b)
    return 0.5 * (low + high)


def noise(values: Array, period_s: float) -> Estimated:
    """Rms at rest about a straight line over each ``_NOISE_WINDOW_S``; slower changes are motion, not noise."""
    length = max(8, round(_NOISE_WINDOW_S / period_s))
    count = len(values) // length
    if count == 0:
        raise IdentificationError(f"{quantity.count(len(values), 'sample')} at rest, {length} are needed")
    time = np.linspace(-1.0, 1.0, length)
    columns = np.column_stack([time, np.ones(length)])
    squares = 0.0
    for block in values[: count * length].reshape(count, length):
        weights, *_ = np.linalg.lstsq(columns, block, rcond=None)
        residual = block - columns @ weights
        squares += float(residual @ residual)
    freedom = count * (length - 2)
    rms = math.sqrt(squares / freedom)
    return Estimated(rms, 2.0 * rms / math.sqrt(2.0 * freedom))
