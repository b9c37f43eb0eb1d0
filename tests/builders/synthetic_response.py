"""Records of a frequency response of a linear rig with known noise, made from its equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.commission.frequency_response import Spectra, spectra
from rigctl.control.excitation.multisine import Band, Multisine, multisine
from rigctl.ipc.record import RECORD
from tests.builders.linear_plant import Array, ComplexArray, TruePlant

TICK_S = 1e-3
BAND = Band(4.0, 0.75, 40.0, 1.25, 100.0, 0.12)
PLANT = TruePlant(6.0, 0.05, 0.02, 0.002, None, 0.02, 30.0, 500.0, TICK_S)
Sensitivity = Callable[[Array], ComplexArray]
"""Frequencies in Hz to the command over the excitation, and to the command per tension noise; shape (2, n)."""


def open_loop(hz: Array) -> ComplexArray:
    """Nothing feeds back."""
    return np.stack([np.ones(len(hz)), np.zeros(len(hz))]).astype(np.complex128)


def usual_signal(power: float = 0.5, floor: float = 0.45) -> Multisine:
    return multisine(BAND, round(1.0 / TICK_S), 0.02, power, floor)


def records(
    plant: TruePlant = PLANT,
    *,
    speed_mm_s: float = 5.0,
    noise_n: float = 0.03,
    periods: int = 12,
    seed: int = 1,
    sensitivity: Sensitivity = open_loop,
    signal: Multisine | None = None,
) -> npt.NDArray[Any]:
    """One record more than whole periods, as the loop writes them: a sample of one tick is in the next one's record."""
    shape, draw = signal or usual_signal(), np.random.default_rng(seed)
    ticks = shape.ticks
    count = periods * ticks
    wave = np.tile((np.roll(shape.stroke_mm, -1) - np.array(shape.stroke_mm)), periods) / TICK_S
    excitation = wave * speed_mm_s / shape.peak_mm_s
    hz: Array = np.fft.rfftfreq(count, TICK_S).astype(np.float64)
    kept = hz.copy()
    kept[0] = hz[1]
    reading, stroke, speed = plant.response(kept)
    at_command, per_noise = sensitivity(kept)
    noise = np.fft.rfft(noise_n * draw.standard_normal(count))
    command = at_command * np.fft.rfft(excitation) + per_noise * noise
    command[0] = 0.0

    def wave_of(response: ComplexArray) -> Array:
        found: Array = np.fft.irfft(response * command, count)
        return found

    found = np.zeros(count + 1, RECORD.dtype)
    found["seq"] = np.arange(len(found))
    found["excitation_mm_s"][:-1] = excitation
    found["command_mm_s"][:-1] = np.fft.irfft(command, count)
    found["tension_n"][1:] = 300.0 + wave_of(reading) + np.fft.irfft(noise, count)
    found["stroke_mm"][1:] = np.round(50.0 + wave_of(stroke), 3)
    found["speed_mm_s"][1:] = np.round(wave_of(speed), 2)
    return found


def amplitudes(found: npt.NDArray[Any], **options: int) -> Spectra:
    """`spectra` of such records."""
    return spectra(found, BAND.harmonics, round(BAND.period_s / TICK_S), TICK_S, **options)
