"""Drive lag and delay, stiffness, backlash and noise from the records of an excitation. Pure functions of arrays.

The excitation (`rigctl.control.excitation.trials.Excitation`) is a rest, then pairs of small steps of speed up and
down, the first of them shorter. Each quantity is fitted over all pairs and stated with its expanded uncertainty at 95 %
(JCGM 100, Student's t for the number of pairs). That has two parts: the scatter of the fits to single pairs, which
holds for any kind of noise, and errors that are the same in every pair (the screw's pitch error).

    tau dv/dt = u(t - Td) - v, ds/dt = v   fitted to the position, which the drive latches at the SYNC
    T = T0 + drift t + k q(s) + c v        q: the stroke behind a play of the width of the backlash

The speed a drive reports is not latched but a mean over some time before: its age is its delay less that of the
position. A sample latched by the SYNC of one tick is read in the next. On a busy computer a tick wakes late and sends
its SYNC late: command and sample are taken at the time of the SYNC. A pair in which the loop skipped a tick is left
out, for a drive may do as it likes with a command that does not come.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from rigctl.commission.motion import Array, HeldCommand, behind_play
from rigctl.devices.objects import MM_PER_POSITION_UNIT
from rigctl.model import quantity
from rigctl.model.unmeasured import Unmeasured

PITCH_ERROR_MM, PITCH_LEAD_MM = 0.003, 5.0  # of a screw of class C7, as a sine over a turn; no encoder shows it
PITCH_SHARE = 2.0 * math.pi * PITCH_ERROR_MM / PITCH_LEAD_MM  # of a small stroke, at most
SHORTEST = 0.5  # of the longest step: shorter steps are the careful first ones and are not fitted
MOVING_MM_S = 1e-6
FEWEST_PAIRS = 4
FEWEST_MOVING = 20  # ticks of a pair
_DELAYS_S = np.arange(0.0, 0.041, 0.002)  # start values of the search
_LAGS_S = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1)
_ITERATIONS = 12
_LOOKS, _PLAY_STEPS = 12, 16
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_NOISE_WINDOW_S = 0.1  # slower changes are motion, not noise
_DELAY_STEP_S = 5e-5  # of a slope


class IdentificationError(ValueError):
    """The records do not determine the plant; ``str()`` says why, in one line, ``reason`` its kind."""

    def __init__(self, why: str, reason: Unmeasured = Unmeasured.OTHER) -> None:
        super().__init__(why)
        self.reason = reason


@dataclass(frozen=True)
class Estimated:
    """A value and its expanded uncertainty at 95 %."""

    value: float
    error: float


@dataclass(frozen=True)
class TrialSignals:
    """Columns of the records, one value per tick: s, mm/s, mm, mm/s, N, A. ``speed`` and ``tension`` as measured.

    ``current``: newest of the motor, NaN where it is not known. ``at_s``: when the tick's SYNC was sent. ``late``: the
    loop skipped ticks just before the tick.
    """

    at_s: Array
    command: Array
    stroke: Array
    speed: Array
    tension: Array
    current: Array
    late: npt.NDArray[np.bool_]

    @property
    def latched_s(self) -> Array:
        """When the samples of each tick were latched: at the SYNC of the tick before."""
        return np.concatenate([[2.0 * self.at_s[0] - self.at_s[1]], self.at_s[:-1]])


@dataclass(frozen=True)
class Pairs:
    """Ticks of each pair of steps, in order, from its first command up to that of the next pair.

    ``kept``: those to fit; ``late``: how many were left out because the loop skipped ticks in them.
    """

    first: slice
    kept: tuple[slice, ...]
    late: int


@dataclass(frozen=True)
class Fitted:
    """The ticks of each pair that a fit uses."""

    parts: list[npt.NDArray[np.intp]]

    def centred(self, values: Array) -> Array:
        """The values over these ticks, each pair about its own mean."""
        return np.concatenate([values[part] - values[part].mean() for part in self.parts])

    def split(self, values: Array) -> list[Array]:
        """What `centred` has put together, pair by pair."""
        return np.split(values, np.cumsum([len(part) for part in self.parts])[:-1])

    def moving(self, stroke: Array) -> Fitted:
        """Without the rests, as far as a pair moves: there the rounding of the position is the same all the time."""
        found = []
        for part in self.parts:
            low, high = stroke[part].min() + MM_PER_POSITION_UNIT, stroke[part].max() - MM_PER_POSITION_UNIT
            moving = part[(stroke[part] > low) & (stroke[part] < high)]
            found.append(moving if len(moving) >= FEWEST_MOVING else part)
        return Fitted(found)


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


def pairs_of(signals: TrialSignals) -> Pairs:
    """The pairs of long steps.

    Raises:
        IdentificationError: there are too few pairs, or too few without a skipped tick.
    """
    command = signals.command
    moving = np.flatnonzero(np.abs(command) > MOVING_MM_S)
    if not len(moving):
        raise IdentificationError("nothing was commanded in these records")
    rises = moving[(moving > 0) & (np.abs(command[moving - 1]) <= MOVING_MM_S) & (command[moving] > 0.0)]
    if len(rises) < FEWEST_PAIRS:
        raise IdentificationError(f"{len(rises)} pairs of steps in these records, {FEWEST_PAIRS} are needed")
    ends = [*rises[1:].tolist(), min(len(command), int(2 * rises[-1] - rises[-2]))]
    found = [slice(int(rise), end) for rise, end in zip(rises, ends, strict=True)]
    strokes = [float(np.maximum(command[where], 0.0).sum()) for where in found]
    long = [where for where, stroke in zip(found, strokes, strict=True) if stroke >= SHORTEST * max(strokes)]
    kept = tuple(where for where in long if not signals.late[where.start + 1 : where.stop].any())
    late = len(long) - len(kept)
    if len(kept) < FEWEST_PAIRS:
        why = f"the computer had the loop skip ticks in {late} of {quantity.count(len(long), 'repetition')}"
        if not late:
            why = f"{quantity.count(len(long), 'pair')} of long steps in these records"
        raise IdentificationError(f"{why}, {FEWEST_PAIRS} are needed: repeat it", Unmeasured.SKIPPED)
    return Pairs(long[0], kept, late)


def drive(signals: TrialSignals, pairs: Pairs) -> Drive:
    """Fit lag, delay and gain of the drive."""
    held, latched_s = HeldCommand(signals.command, signals.at_s), signals.latched_s

    def moved(lag_s: float, delay_s: float) -> Array:
        """Of a drive with unit gain: the response and its integral, ds = u dt - tau dv."""
        when_s = latched_s - delay_s
        return held.integral(when_s) - lag_s * held.response(lag_s, when_s)

    whole = Fitted([np.arange(where.start, where.stop) for where in pairs.kept])
    starts = [(lag_s, float(delay_s)) for lag_s in _LAGS_S for delay_s in _DELAYS_S]
    lag_s, delay_s, _ = _fit_drive(whole, moved, signals.stroke, starts)
    swift = whole.moving(moved(lag_s, delay_s))
    lag_s, delay_s, gain = _fit_drive(swift, moved, signals.stroke, [(lag_s, delay_s)])
    everywhere = gain * moved(lag_s, delay_s)
    by_lag, by_delay = (gain * slope for slope in _slopes(moved, lag_s, delay_s))
    errors = _scatter(_moves(swift, (by_lag, by_delay, everywhere / gain), signals.stroke - everywhere))
    rounding_s = _rounding_s(signals, pairs)

    def slow(late_s: float) -> Array:
        return gain * held.response(lag_s, latched_s - late_s)

    def cost(late_s: float) -> float:
        return float(np.sum(whole.centred(signals.speed - slow(late_s)) ** 2))

    speed_s = _least(cost, max(0.0, delay_s - 0.005), delay_s + 0.02)
    by_age = (slow(speed_s + _DELAY_STEP_S) - slow(speed_s)) / _DELAY_STEP_S
    age_error = _scatter(_moves(whole, (by_age,), signals.speed - slow(speed_s)))
    fitted = everywhere - everywhere.mean() + signals.stroke.mean()
    exact = float(np.std(signals.stroke - fitted)) < MM_PER_POSITION_UNIT
    return Drive(
        Estimated(lag_s, math.hypot(float(errors[0]), rounding_s)),
        Estimated(delay_s, math.hypot(float(errors[1]), rounding_s)),
        Estimated(gain, float(errors[2])),
        Estimated(speed_s - delay_s, float(age_error[0])),
        fitted if exact else signals.stroke,
    )


def _rounding_s(signals: TrialSignals, pairs: Pairs) -> float:
    """How far off in time the position's rounding puts a fit, at 95 %: nearly the same in every pair of a small stroke.

    It is the standard deviation of a rounded position over the speed, over the root of the units that a step passes.
    """
    first = pairs.kept[0]
    speed_mm_s = float(np.abs(signals.command[first]).max())
    units = max(1.0, float(np.ptp(signals.stroke[first])) / MM_PER_POSITION_UNIT)
    return 2.0 * MM_PER_POSITION_UNIT / math.sqrt(12.0 * units) / speed_mm_s


def _moves(over: Fitted, slopes: tuple[Array, ...], residual: Array) -> Array:
    """By how much the fit to each pair alone differs from that to all, rows of values: one step of Gauss and Newton."""
    parts = zip(*(over.split(over.centred(each)) for each in (*slopes, residual)), strict=True)
    return np.array([np.linalg.lstsq(np.column_stack(part[:-1]), part[-1], rcond=None)[0] for part in parts])


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


_Shape = Callable[[float, float], Array]


def _fit_drive(
    over: Fitted, moved: _Shape, stroke: Array, starts: list[tuple[float, float]]
) -> tuple[float, float, float]:
    """Lag in s, delay in s, gain: least squares, Gauss-Newton in the first two from the best of ``starts``."""
    measured = over.centred(stroke)

    def residual(lag_s: float, delay_s: float) -> Array:
        shape = over.centred(moved(lag_s, delay_s))
        return measured - _gain(shape, measured) * shape

    def cost(lag_s: float, delay_s: float) -> float:
        left = residual(lag_s, delay_s)
        return float(left @ left)

    lag_s, delay_s = min(starts, key=lambda start: cost(*start))
    best = cost(lag_s, delay_s)
    for _ in range(_ITERATIONS):
        slopes = np.column_stack(_slopes(residual, lag_s, delay_s))
        move, *_ = np.linalg.lstsq(slopes, residual(lag_s, delay_s), rcond=None)
        for shorter in (1.0, 0.5, 0.25, 0.125):
            tried = max(lag_s - shorter * float(move[0]), 1e-4), max(delay_s - shorter * float(move[1]), 0.0)
            if (found := cost(*tried)) < best:
                (lag_s, delay_s), best = tried, found
                break
        else:
            break
    return lag_s, delay_s, _gain(over.centred(moved(lag_s, delay_s)), measured)


def _gain(shape: Array, stroke: Array) -> float:
    square = float(shape @ shape)
    return float(shape @ stroke) / square if square else 0.0


def _slopes(of: _Shape, lag_s: float, delay_s: float) -> tuple[Array, Array]:
    """Along lag and delay."""
    at, lag_step_s = of(lag_s, delay_s), 0.01 * lag_s
    by_lag = (of(lag_s + lag_step_s, delay_s) - at) / lag_step_s
    return by_lag, (of(lag_s, delay_s + _DELAY_STEP_S) - at) / _DELAY_STEP_S


def rope(signals: TrialSignals, pairs: Pairs, drive: Drive, noise_n: float) -> Rope:
    """Fit stiffness and backlash; the first pair is left out, since the nut's place in its play is unknown there.

    ``noise_n``: upper bound of the cell's noise. A larger residual means that the model of a spring behind a play does
    not fit, and adds to both uncertainties.
    """
    signals = replace(signals, stroke=drive.stroke)
    parts = [where for where in pairs.kept if where != pairs.first]
    reach_mm = max(float(np.ptp(signals.stroke[part])) for part in parts)
    stiffness, backlash, left_n, explained_n = _fit_rope(signals, parts, reach_mm)
    single = np.array([_fit_rope(signals, [part], reach_mm)[:2] for part in parts])
    errors = _scatter(single)
    # The pitch error is the same in every pair: at worst, the part of its sine that lies in this stroke.
    pitch_mm = 2.0 * PITCH_ERROR_MM * math.sin(min(0.5, reach_mm / PITCH_LEAD_MM) * math.pi)
    misfit = 2.0 * math.sqrt(max(0.0, left_n**2 - noise_n**2)) / explained_n if explained_n else math.inf
    shares = drive.gain.error / drive.gain.value, misfit
    random_n_mm = math.hypot(float(errors[0]), *(stiffness * share for share in shares))
    return Rope(
        Estimated(stiffness, random_n_mm + abs(stiffness) * pitch_mm / reach_mm),  # a bound adds linearly
        # The pitch error is the same function of the stroke up and down, which is no play. The stroke is the fitted one
        # where that is within a unit of the position.
        Estimated(backlash, math.hypot(float(errors[1]), MM_PER_POSITION_UNIT, reach_mm * misfit)),
    )


def _fit_rope(signals: TrialSignals, parts: list[slice], reach_mm: float) -> tuple[float, float, float, float]:
    """Stiffness, backlash, rms of the residual and rms explained by the stroke in N.

    The play is found by search for the least residual, the rest by linear least squares.
    """
    where = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    before = max(0, 2 * parts[0].start - parts[0].stop)  # the ticks before show the nut's place in its play
    stroke = signals.stroke[before : parts[-1].stop]
    time = signals.at_s[where] - signals.at_s[where].mean()

    def solve(play_mm: float) -> tuple[float, float, float]:
        nut = behind_play(stroke, play_mm)[where - before]
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
