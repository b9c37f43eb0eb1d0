"""Frequency response of plant and loop from the records of a multisine. Pure functions of arrays.

Over M whole periods each excited frequency has one complex amplitude per period. The ratio of two signals is that of
their means over the periods, and its variance follows from what each period departs from it, as the period-to-period
covariance does (Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, chapter 2):

    G = Y / U,   var G = sum |Y_m - G U_m|^2 / (M (M - 1) |U|^2)

In a closed loop the means keep only what the multisine caused, so that G is the plant's and not biased by the feedback.
What the plant answers at harmonics that are not excited is not linear; its mean square near a frequency adds to the
variance there, because it does not differ from period to period. It is taken at even and at odd harmonics, as it is and
as a disturbance of the command would make it, and the largest counts: a dead band makes odd ones, before the plant.

As in `rigctl.commission.identification`, a sample latched by the SYNC of tick n - 1 is read in tick n. All responses
are from the command sent with a SYNC to the value latched by that SYNC, as in `rigctl.design.plant_family`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from rigctl.commission.identification import PITCH_SHARE, IdentificationError, student_t
from rigctl.commission.motion import Array
from rigctl.devices.objects import MM_PER_POSITION_UNIT, MM_S_PER_VELOCITY_16_UNIT
from rigctl.model.quantity import count
from rigctl.model.states import Flag
from rigctl.model.unmeasured import Unmeasured

ComplexArray = npt.NDArray[np.complex128]

FEWEST_PERIODS = 6
_LIMITED = (Flag.LIMITED_SPEED | Flag.LIMITED_ACCELERATION | Flag.LIMITED_STROKE).value
LIMITED_SHARE = 0.005  # of a period's ticks; the cell's noise alone reaches the limit of acceleration now and then
LEAST_MM_S = 1e-6  # of a sine
_NEIGHBOURS = 4  # harmonics of a kind that are not excited, from which what is not linear is taken


@dataclass(frozen=True)
class Spectra:
    """Complex amplitudes, shape (M periods, harmonics 0 to the highest excited): mm/s, mm/s, N, mm, mm/s.

    ``excited``: the harmonics of the multisine. ``tension``, ``stroke``, ``speed``: at the SYNC of the command.
    ``left_out``: how many more periods there were, in which the loop skipped ticks or the law's limits acted.
    """

    period_s: float
    tick_s: float
    excited: npt.NDArray[np.intp]
    excitation: ComplexArray
    command: ComplexArray
    tension: ComplexArray
    stroke: ComplexArray
    speed: ComplexArray
    left_out: int = 0

    @property
    def frequencies_hz(self) -> Array:
        """Of the multisine."""
        return self.excited / self.period_s

    @property
    def periods(self) -> int:
        """Number of periods."""
        return len(self.command)


@dataclass(frozen=True)
class Ratio:
    """Ratio of two signals at the excited frequencies: ``value`` complex, ``variance`` of it, ``coherence`` 0 to 1.

    ``share``: of the magnitude, a bound of what is wrong with it in every period alike.
    """

    value: ComplexArray
    variance: Array
    coherence: Array
    freedom: int
    share: float = 0.0

    @property
    def gain_error(self) -> Array:
        """Half width of the 95 % interval of the magnitude."""
        return self._random + self.share * np.abs(self.value)  # a bound adds linearly

    @property
    def phase_error_deg(self) -> Array:
        """Half width of the 95 % interval of the phase, 180 where the phase is not known."""
        share = np.minimum(self._random / np.maximum(np.abs(self.value), 1e-300), 1.0)
        return np.where(share < 1.0, np.degrees(np.arcsin(share)), 180.0)

    @property
    def _random(self) -> Array:
        return student_t(self.freedom) * np.sqrt(0.5 * self.variance)


def spectra(
    records: npt.NDArray[np.void], harmonics: tuple[int, ...], ticks: int, tick_s: float, *, spare: int = 0
) -> Spectra:
    """Amplitudes per period of the last whole periods before the last ``spare`` records.

    A period in which the loop skipped a tick, or the law's limits acted in more than a few, is left out, and the one
    after it, in which the effect dies away.

    Args:
        records: of the measured time, with one record before it at least; in the order of the loop.
        harmonics: excited, of a period of ``ticks`` ticks of ``tick_s`` seconds.
        spare: records at the end that do not belong to the measurement.

    Raises:
        IdentificationError: records are missing, or too few periods are left.
    """
    stop = len(records) - spare - 1
    whole = stop // ticks if stop > 0 else 0
    if whole < FEWEST_PERIODS:
        raise IdentificationError(f"{count(whole, 'period')} on record, {FEWEST_PERIODS} are needed")
    start = stop - whole * ticks
    sent, latched = slice(start, stop), slice(start + 1, stop + 1)
    if int(records["seq"][stop] - records["seq"][start]) != stop - start:
        raise IdentificationError("records of the measurement are missing")
    skips = np.diff(records["skipped"][start : stop + 1].astype(np.int64)).reshape(whole, ticks).max(axis=1) > 0
    limits = ((records["flags"][start:stop] & _LIMITED) != 0).reshape(whole, ticks).mean(axis=1) > LIMITED_SHARE
    bad = skips | limits
    good = ~bad
    good[1:] &= ~bad[:-1]
    if np.count_nonzero(good) < FEWEST_PERIODS:
        many = np.count_nonzero(limits) > np.count_nonzero(skips)
        why = "the command was limited" if many else "the computer had the loop skip periods"
        raise IdentificationError(
            f"{why} in {np.count_nonzero(bad)} of {whole} periods of the excitation: repeat it",
            Unmeasured.LIMITED if many else Unmeasured.SKIPPED,
        )
    kept = np.arange(max(harmonics) + 2)

    def amplitudes(name: str, where: slice) -> ComplexArray:
        values = records[name][where].astype(np.float64)
        values = values - _drift(values, ticks)
        found: ComplexArray = np.fft.rfft(values.reshape(whole, ticks)[good], axis=1)[:, kept] * (2.0 / ticks)
        return found

    excitation = amplitudes("excitation_mm_s", sent)
    if np.abs(excitation.mean(axis=0)[list(harmonics)]).min() < LEAST_MM_S:
        raise IdentificationError("the records show no excitation at some of its frequencies")
    return Spectra(
        ticks * tick_s,
        tick_s,
        np.array(harmonics),
        excitation,
        amplitudes("command_mm_s", sent),
        amplitudes("tension_n", latched),
        amplitudes("stroke_mm", latched),
        amplitudes("speed_mm_s", latched),
        whole - int(np.count_nonzero(good)),
    )


def _drift(values: Array, ticks: int) -> Array:
    """The straight line through the means of the periods, in which what repeats with them has no part."""
    means = values.reshape(-1, ticks).mean(axis=1)
    time = np.arange(len(means)) - 0.5 * (len(means) - 1.0)
    slope = float(time @ means) / float(time @ time) / ticks
    return np.asarray(values.mean() + slope * (np.arange(len(values)) - 0.5 * (len(values) - 1.0)), np.float64)


def ratio(
    found: Spectra, output: ComplexArray, source: ComplexArray, *, share: float = 0.0, unit: float = 0.0
) -> Ratio:
    """Ratio of two of the signals of ``found``, see above.

    ``unit``: in which the output is sent; its rounding is much the same in every period, so no period shows it.
    The coherence is the lesser one of excitation with output and with source, over the periods.
    """
    at, periods = found.excited, found.periods
    y, u, d = output[:, at], source[:, at], found.excitation[:, at]
    base = np.maximum(np.abs(u.mean(axis=0)), 1e-300)
    value = y.mean(axis=0) / np.where(base > 1e-300, u.mean(axis=0), 1e-300)
    between = _between(found, value)
    left = output - between * source
    scatter = np.sum(np.abs(left[:, at]) ** 2, axis=0) / (periods * (periods - 1.0))
    scatter += unit**2 / 12.0 * 4.0 * found.tick_s / found.period_s
    variance = (scatter + _distortion(found, left, np.abs(between) ** 2)) / base**2
    coherence = np.minimum(_coherence(d, y), _coherence(d, u))
    return Ratio(value, variance, coherence, 2 * (periods - 1), share)


def _coherence(a: ComplexArray, b: ComplexArray) -> Array:
    both = np.abs(np.sum(np.conj(a) * b, axis=0)) ** 2
    alone = np.sum(np.abs(a) ** 2, axis=0) * np.sum(np.abs(b) ** 2, axis=0)
    return np.asarray(both / np.maximum(alone, 1e-300))


def _between(found: Spectra, value: ComplexArray) -> ComplexArray:
    """A ratio at all harmonics, by straight lines between the excited ones: enough for the little that is there."""
    every = np.arange(found.command.shape[1])
    between: ComplexArray = np.interp(every, found.excited, value.real) + 1j * np.interp(
        every, found.excited, value.imag
    )
    between[found.excited] = value
    return between


def _distortion(found: Spectra, left: ComplexArray, squared_gain: Array) -> Array:
    """Mean square of what is the same in each period, and yet not excited, at each excited harmonic."""
    periods, harmonics = left.shape
    mean = left.mean(axis=0)
    steady = np.abs(mean) ** 2 - np.sum(np.abs(left - mean) ** 2, axis=0) / (periods * (periods - 1.0))  # less noise
    at_command = steady / np.maximum(squared_gain, 1e-300)
    free = np.setdiff1d(np.arange(1, harmonics), found.excited)
    even, odd = free[free % 2 == 0], free[free % 2 == 1]
    squares = []
    for at in found.excited:
        kinds = [kind[np.argsort(np.abs(kind - at), kind="stable")[:_NEIGHBOURS]] for kind in (even, odd)]
        direct = [float(steady[near].mean()) for near in kinds]
        before = [float(at_command[near].mean() * squared_gain[at]) for near in kinds]
        squares.append(max(0.0, *direct, *before))
    return np.array(squares)


@dataclass(frozen=True)
class PlantResponse:
    """Responses to the command: tension N s/mm, stroke s, speed 1; and the command's to the excitation, S at the input.

    The screw's pitch error is in the tension and in no stroke that the drive's encoder shows.

    ``sensitivity`` is 1 in HOLD, where nothing feeds back.
    """

    frequencies_hz: Array
    tick_s: float
    tension: Ratio
    stroke: Ratio
    speed: Ratio
    sensitivity: Ratio


def plant_response(found: Spectra) -> PlantResponse:
    """Responses at the excited frequencies."""
    command = found.command
    return PlantResponse(
        found.frequencies_hz,
        found.tick_s,
        ratio(found, found.tension, command, share=PITCH_SHARE),
        ratio(found, found.stroke, command, unit=MM_PER_POSITION_UNIT),
        ratio(found, found.speed, command, unit=MM_S_PER_VELOCITY_16_UNIT),
        ratio(found, command, found.excitation),
    )


def without(found: Spectra, period: int) -> Spectra:
    """The same without one of the periods, for a jackknife."""
    kept = np.delete(np.arange(found.periods), period)
    parts = ("excitation", "command", "tension", "stroke", "speed")
    return replace(found, **{name: getattr(found, name)[kept] for name in parts})
