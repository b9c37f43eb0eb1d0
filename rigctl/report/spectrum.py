"""Amplitude spectrum of the error, and the frequencies marked in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.control.law.tension import Gains
from rigctl.design.closed_loop import closed_loop, controller
from rigctl.design.gains import DesignError, filter_gain
from rigctl.design.performance import SHAKE_HZ
from rigctl.design.plant_family import member

Floats = npt.NDArray[np.float64]
SEGMENT_S, SHORTEST = 16.384, 256
"""Length of a segment in s, which separates pendulum and bounce, at most that of the longest phase; least samples."""
WINDOW = "flattop"
"""Shows the true amplitude of a line anywhere between two bins."""
LINE_WIDTH_BINS = 5.0
GRAVITY_MM_S2 = 9806.65


@dataclass(frozen=True)
class Spectrum:
    """Amplitude of a sine at each frequency; noise appears in the bandwidth of the window's bin, ``noise_hz``."""

    frequency_hz: Floats
    amplitude_n: Floats
    resolution_hz: float
    noise_hz: float
    segments: int

    @property
    def largest(self) -> tuple[float, float]:
        """Frequency and amplitude of the largest line; drift below the window's width does not count as a line."""
        above = np.flatnonzero(self.frequency_hz >= LINE_WIDTH_BINS * self.resolution_hz)
        at = above[np.argmax(self.amplitude_n[above])] if len(above) else 0
        return float(self.frequency_hz[at]), float(self.amplitude_n[at])


def spectrum(parts: list[tuple[Floats, Floats]], rate_hz: float) -> Spectrum | None:
    """Welch's average over phases.

    Args:
        parts: times in s and error in N of each phase; skipped ticks are interpolated linearly.
        rate_hz: of the loop.

    Returns:
        The spectrum, or None if no phase has enough samples.
    """
    even = [_even(t_s[np.isfinite(error)], error[np.isfinite(error)], rate_hz) for t_s, error in parts]
    longest = max((len(error) for error in even), default=0)
    if longest < SHORTEST:
        return None
    size = min(1 << round(math.log2(SEGMENT_S * rate_hz)), 1 << int(math.log2(longest)))
    window = signal.get_window(WINDOW, size)
    total, segments = np.zeros(size // 2 + 1), 0
    frequency_hz: Floats = np.asarray(np.fft.rfftfreq(size, 1.0 / rate_hz), np.float64)
    for error in even:
        if len(error) >= size:
            count = (len(error) - size) // (size // 2) + 1
            _, power = signal.welch(error, rate_hz, window, size, detrend="linear", scaling="spectrum")
            total += count * power
            segments += count
    amplitude = np.sqrt(2.0 * total / segments)
    wide = rate_hz * float(np.sum(window**2) / np.sum(window) ** 2)
    return Spectrum(frequency_hz, amplitude, rate_hz / size, wide, segments)


def _even(t_s: Floats, error_n: Floats, rate_hz: float) -> Floats:
    """Samples on the loop's grid."""
    if len(t_s) < 2:
        return error_n
    count = round((t_s[-1] - t_s[0]) * rate_hz) + 1
    if count == len(t_s):
        return error_n
    filled: Floats = np.interp(t_s[0] + np.arange(count) / rate_hz, t_s, error_n)
    return filled


def named_lines(settings: RigSettings, gains: Gains | None) -> dict[str, float]:
    """Frequencies marked in the chart, in Hz: pendulum, free bounce, shake of floor and building, loop bandwidth."""
    plant = settings.plant
    found = {
        "pendulum": math.sqrt(GRAVITY_MM_S2 / plant.rope_length_mm) / (2.0 * math.pi),
        "bounce": math.sqrt(plant.stiffness_n_mm * 1000.0 / plant.payload_kg) / (2.0 * math.pi),
        **{f"shake {hz:g} Hz": hz for hz in SHAKE_HZ},
    }
    bandwidth = bandwidth_hz(settings, gains) if gains is not None else None
    return found | ({"loop bandwidth": bandwidth} if bandwidth is not None else {})


def bandwidth_hz(settings: RigSettings, gains: Gains) -> float | None:
    """Frequency up to which the loop keeps a disturbance of the tension below 1/sqrt(2) of that of a locked stroke."""
    model = filter_model(settings)
    plant = member(settings, settings.plant.mechanism_n_mm)
    try:
        loop = closed_loop(plant, controller(model, gains, filter_gain(model)))
    except DesignError:
        return None
    rate = settings.loop.rate_hz
    frequency = np.geomspace(0.05, 0.4 * rate, 600)
    z = np.exp(2j * np.pi * frequency / rate)
    pencil = z[:, None, None] * np.eye(len(loop.a)) - loop.a
    driven = np.broadcast_to(loop.b[:, 2:].astype(np.complex128), (len(z), len(loop.b), 1))
    try:
        closed = np.abs(np.linalg.solve(pencil, driven)[:, 0, 0])
    except np.linalg.LinAlgError:
        return None
    sensitivity = closed / np.abs(plant.response(z)[2])
    above = np.flatnonzero(sensitivity >= math.sqrt(0.5))
    if not len(above) or above[0] == 0:
        return None
    at = int(above[0])
    x = np.log(frequency[at - 1 : at + 1])
    y = np.log(sensitivity[at - 1 : at + 1])
    return float(np.exp(np.interp(math.log(math.sqrt(0.5)), y, x)))
