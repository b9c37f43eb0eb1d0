"""Multisines: the frequencies asked for, whole periods, low peaks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rigctl.control.excitation.multisine import Band, Multisine, multisine

BAND = Band(4.0, 0.25, 40.0, 1.25)
LAG_S, RATE_HZ = 0.02, 1000


@pytest.fixture(scope="module")
def made() -> Multisine:
    return multisine(BAND, RATE_HZ, LAG_S, 0.5)


def speed(found: Multisine) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    stroke = np.array(found.stroke_mm)
    wave: np.ndarray[tuple[int], np.dtype[np.float64]] = (np.roll(stroke, -1) - stroke) * found.rate_hz
    return wave


def test_its_frequencies_are_odd_harmonics_on_a_quasi_logarithmic_grid() -> None:
    harmonics = np.array(BAND.harmonics)
    assert (harmonics % 2 == 1).all()
    assert harmonics[0] / BAND.period_s == pytest.approx(BAND.lowest_hz)
    assert harmonics[-1] / BAND.period_s <= BAND.highest_hz < 1.3 * harmonics[-1] / BAND.period_s
    steps = harmonics[1:] / harmonics[:-1]
    assert (steps[8:] == pytest.approx(BAND.ratio, abs=0.1)) and (np.diff(harmonics) >= 2).all()


@pytest.mark.parametrize(("power", "floor"), [(0.5, 0.0), (0.5, 0.45), (1.0, 0.0)])
def test_the_speed_has_the_amplitudes_asked_for_and_nothing_else(power: float, floor: float) -> None:
    found = multisine(BAND, RATE_HZ, LAG_S, power, floor)
    amplitudes = np.abs(np.fft.rfft(speed(found))) * 2.0 / found.ticks
    omega = 2.0 * math.pi * np.array(found.frequencies_hz)
    wanted = (omega * np.hypot(1.0, omega * LAG_S)) ** power
    assert amplitudes[list(found.harmonics)] == pytest.approx(np.maximum(floor, wanted / wanted.max()), rel=1e-4)
    amplitudes[list(found.harmonics)] = 0.0
    assert amplitudes.max() < 1e-5


def test_a_period_ends_where_it_began_and_its_peaks_are_those_stated(made: Multisine) -> None:
    assert made.ticks == 4000
    assert sum(made.stroke_mm) == pytest.approx(0.0, abs=1e-5)
    assert made.peak_mm == max(map(abs, made.stroke_mm))
    assert made.peak_mm_s == pytest.approx(np.abs(speed(made)).max())
    change = np.diff(np.append(speed(made), speed(made)[0])) * RATE_HZ
    assert made.peak_mm_s2 == pytest.approx(np.abs(change).max())
    assert made.peak_above_mm(0.0) == pytest.approx(made.peak_mm)
    assert made.peak_above_mm(1.0) < 0.8 * made.peak_mm


@pytest.mark.parametrize(("power", "floor"), [(0.5, 0.0), (0.5, 0.45)])
def test_its_peak_is_far_below_that_of_random_phases_and_of_schroeders(power: float, floor: float) -> None:
    found = multisine(BAND, RATE_HZ, LAG_S, power, floor)
    omega, draw = 2.0 * math.pi * np.array(found.frequencies_hz), np.random.default_rng(7)
    wanted = (omega * np.hypot(1.0, omega * LAG_S)) ** power
    amplitudes, time = np.maximum(floor, wanted / wanted.max()), np.arange(found.ticks) / RATE_HZ

    def crest(phases: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        wave = (amplitudes * np.cos(np.outer(time, omega) + phases)).sum(axis=1)
        return float(np.abs(wave).max() / wave.std())

    drawn = [crest(phases) for phases in draw.uniform(0.0, 2.0 * math.pi, (20, len(omega)))]
    assert found.crest < 0.92 * min(drawn)
    assert found.crest < 2.3  # a Gauss-Newton search for the least peak finds 2.2 for the steeper spectrum


def test_the_same_settings_give_the_same_numbers() -> None:
    """A replay compares commands exactly."""
    multisine.cache_clear()
    first = multisine(BAND, RATE_HZ, LAG_S, 0.5).stroke_mm
    multisine.cache_clear()
    assert multisine(BAND, RATE_HZ, LAG_S, 0.5).stroke_mm == first
    assert all(round(value, 9) == value for value in first)
