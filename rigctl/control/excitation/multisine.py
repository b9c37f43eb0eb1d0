"""Sums of sines over whole periods, with a low crest factor: speeds that excite the plant at chosen frequencies.

Frequencies are odd harmonics of the period on a quasi-logarithmic grid; even harmonics, and odd ones left out, then
show what is not linear. Phases: Schroeder's, then clipping and restoring the spectrum again and again (van der Ouderaa,
Schoukens, Renneboog, IEEE Trans. Instrum. Meas. 37 (1988) 145-147). A table is made once; a tick only reads it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_CLIPPINGS = 250  # twice as many take 2 % off the crest factor
_LEAST_CLIP, _LAST_CLIP = 0.5, 0.99  # of the peak
_DIGITS = 9  # of a table: the last bits of an FFT differ between computers, and a replay compares commands exactly


@dataclass(frozen=True)
class Band:
    """Frequencies of a multisine: from ``lowest_hz`` to ``highest_hz``, each about ``ratio`` times the one before.

    Between any two beyond the second an odd harmonic is left out, where a nonlinearity such as a dead band shows.
    """

    period_s: float
    lowest_hz: float
    highest_hz: float
    ratio: float
    tail_hz: float = 0.0
    """Frequencies go on up to here, as weak as ``tail`` of the largest amplitude."""
    tail: float = 0.0

    @property
    def harmonics(self) -> tuple[int, ...]:
        """Odd harmonics of the period."""
        found, harmonic = [], max(1, round(self.lowest_hz * self.period_s)) | 1
        while harmonic <= max(self.highest_hz, self.tail_hz) * self.period_s:
            found.append(harmonic)
            least = harmonic + (2 if len(found) == 1 else 4)
            harmonic = max(least, round((harmonic * self.ratio - 1.0) / 2.0) * 2 + 1)
        return tuple(found)


@dataclass(frozen=True)
class Multisine:
    """One period: strokes in mm with mean zero, one per tick; the speed of a tick leads to the next one.

    The scale is free: the peaks below are those of the table as it is.
    """

    rate_hz: int
    harmonics: tuple[int, ...]
    stroke_mm: tuple[float, ...]

    @property
    def ticks(self) -> int:
        """Length of the period."""
        return len(self.stroke_mm)

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Of its sines."""
        return tuple(harmonic * self.rate_hz / self.ticks for harmonic in self.harmonics)

    @functools.cached_property
    def peak_mm(self) -> float:
        """Largest distance from the mean stroke."""
        return max(map(abs, self.stroke_mm))

    def peak_above_mm(self, corner_hz: float) -> float:
        """Largest distance from the mean stroke, its slower part taken away by a high-pass of first order."""
        stroke = np.array(self.stroke_mm)
        frequencies_hz = np.fft.rfftfreq(self.ticks, 1.0 / self.rate_hz)
        kept = frequencies_hz / np.maximum(np.hypot(frequencies_hz, corner_hz), 1e-12)
        return float(np.abs(np.fft.irfft(np.fft.rfft(stroke) * kept, self.ticks)).max())

    @functools.cached_property
    def peak_mm_s(self) -> float:
        """Largest speed."""
        return float(np.abs(self._speed).max())

    @functools.cached_property
    def peak_mm_s2(self) -> float:
        """Largest change of speed from tick to tick, per second."""
        return float(np.abs(self._speed - np.roll(self._speed, 1)).max()) * self.rate_hz

    @property
    def crest(self) -> float:
        """Peak of the speed over its rms."""
        return self.peak_mm_s / float(np.sqrt(np.mean(self._speed**2)))

    @functools.cached_property
    def _speed(self) -> Array:
        stroke = np.array(self.stroke_mm)
        speed: Array = (np.roll(stroke, -1) - stroke) * self.rate_hz
        return speed


@functools.lru_cache(maxsize=16)
def multisine(band: Band, rate_hz: int, lag_s: float, power: float, floor: float = 0.0) -> Multisine:
    """The multisine of a band, with amplitudes of speed that are ``gain ** -power``, at least ``floor`` of the largest.

    ``gain``: of speed command to tension of a drive with this lag and a rigid mechanism, 1 / (w sqrt(1 + (w lag)^2)).
    With power 1 the tension answers evenly; with less, low frequencies answer more, where disturbances are.
    """
    ticks = round(band.period_s * rate_hz)
    harmonics = np.array(band.harmonics)
    omega = 2.0 * math.pi * harmonics / band.period_s
    amplitudes = (omega * np.hypot(1.0, omega * lag_s)) ** power
    strong = harmonics <= band.highest_hz * band.period_s
    amplitudes = np.where(strong, np.maximum(floor, amplitudes / amplitudes[strong].max()), band.tail)
    phases = _clipped(harmonics, amplitudes, _schroeder(amplitudes), ticks)
    held = 1j * omega * np.sinc(harmonics / ticks) * np.exp(1j * math.pi * harmonics / ticks)  # of a speed held a tick
    stroke = _wave(harmonics, amplitudes * np.exp(1j * phases) / held, ticks)
    return Multisine(rate_hz, tuple(band.harmonics), tuple(np.round(stroke, _DIGITS).tolist()))


def _schroeder(amplitudes: Array) -> Array:
    """Schroeder's phases for a given spectrum (IEEE Trans. Inf. Theory 16 (1970) 85-89, equation 11)."""
    power = amplitudes**2 / np.sum(amplitudes**2)
    places = np.arange(len(power))
    phases: Array = np.array([-2.0 * math.pi * float(((k - places[:k]) * power[:k]).sum()) for k in places])
    return phases


def _clipped(harmonics: Array, amplitudes: Array, phases: Array, ticks: int) -> Array:
    """Phases in rad with a low peak of the sum."""
    best = math.inf, phases
    for clipping in range(_CLIPPINGS):
        wave = _wave(harmonics, amplitudes * np.exp(1j * phases), ticks)
        peak = float(np.abs(wave).max())
        if peak < best[0]:
            best = peak, phases
        bound = peak * (_LEAST_CLIP + (_LAST_CLIP - _LEAST_CLIP) * clipping / _CLIPPINGS)
        phases = np.angle(np.fft.rfft(np.clip(wave, -bound, bound))[harmonics])
    return best[1]


def _wave(harmonics: Array, amplitudes: npt.NDArray[np.complex128], ticks: int) -> Array:
    """A period of the sum of sines with these complex amplitudes."""
    spectrum = np.zeros(ticks // 2 + 1, np.complex128)
    spectrum[harmonics] = 0.5 * ticks * amplitudes
    wave: Array = np.fft.irfft(spectrum, ticks)
    return wave
