"""Statistics and spectrum against known errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rigctl.config import rig_file as config
from rigctl.control.law.estimator import filter_model
from rigctl.control.law.tension import Gains
from rigctl.design.closed_loop import controller
from rigctl.design.gains import filter_gain
from rigctl.design.performance import performance
from rigctl.metrics.error_statistics import ErrorStatistics, error_n, longest_beyond_s, statistics
from rigctl.metrics.phases import phases
from rigctl.model.states import Mode
from rigctl.report.spectrum import bandwidth_hz, named_lines, spectrum
from tests.builders import daemons
from tests.builders.synthetic import GAINS, RATE_HZ, Floats, compensating, run, stay

AMPLITUDE_N, LINE_HZ = 0.6, 3.0


def sine(t_s: Floats) -> Floats:
    return AMPLITUDE_N * np.sin(2 * np.pi * LINE_HZ * t_s)


def figures_of(records: np.ndarray[tuple[int], np.dtype[np.void]]) -> ErrorStatistics:
    found = statistics(records, phases(records), RATE_HZ)
    assert found is not None
    return found


def test_a_sine_has_its_amplitude_as_maximum_and_its_root_half_as_rms() -> None:
    found = figures_of(compensating(sine, 22.0))
    assert found.eta_max_pct == pytest.approx(100 * AMPLITUDE_N / 300.0, rel=1e-4)  # samples miss the crest
    assert found.eta_rms_pct == pytest.approx(100 * AMPLITUDE_N / 300.0 / math.sqrt(2), rel=1e-9)
    assert found.mean_n == pytest.approx(0.0, abs=1e-9)
    assert found.spread_n == pytest.approx(AMPLITUDE_N / math.sqrt(2), rel=1e-9)
    assert (found.samples, found.seconds) == (20_000, pytest.approx(20.0))
    assert found.vertical_max_n == pytest.approx(300.0 + AMPLITUDE_N, abs=1e-4)


def test_each_phase_is_held_against_its_own_target() -> None:
    def one_newton(t_s: Floats) -> Floats:
        return np.ones_like(t_s)

    records = run(
        stay(Mode.COMPENSATING, 4.0, one_newton), stay(Mode.HOLD, 1.0),
        stay(Mode.COMPENSATING, 4.0, one_newton, target_n=100.0),
    )  # fmt: skip
    found = figures_of(records)
    assert found.eta_max_pct == pytest.approx(1.0)
    assert found.eta_rms_pct == pytest.approx(math.sqrt((1.0 + 1.0 / 9.0) / 2.0))
    assert found.mean_n == pytest.approx(1.0)
    assert found.max_at_ns == records["t_ns"][7 * RATE_HZ]


def test_what_is_missing_or_has_no_value_is_counted() -> None:
    records = compensating(sine)
    records["vertical_n"][6000:6010] = np.nan
    records["tension_quality"][7000:7005] = 1
    records = np.delete(records, slice(8000, 8020))
    found = figures_of(records)
    assert (found.without_value, found.not_good, found.missing) == (10, 5, 20)
    assert found.eta_max_pct == pytest.approx(0.2, rel=1e-3)


def test_time_beyond_a_bound_is_the_longest_without_a_break() -> None:
    errors = np.zeros(1000)
    errors[100:150] = 2.0
    errors[149] = np.nan
    errors[300:320] = -2.0
    errors[990:] = 2.0
    assert longest_beyond_s(errors, 1.5, RATE_HZ) == pytest.approx(0.049)
    assert longest_beyond_s(errors, 2.0, RATE_HZ) == 0.0


def test_the_spectrum_shows_a_sine_at_its_frequency_with_its_amplitude() -> None:
    records = compensating(sine, 62.0)
    (phase,) = phases(records)
    found = spectrum([(np.arange(60_000) / RATE_HZ, error_n(records, phase))], RATE_HZ)
    assert found is not None
    hz, newtons = found.largest
    assert hz == pytest.approx(LINE_HZ, abs=found.resolution_hz)
    assert newtons == pytest.approx(AMPLITUDE_N, rel=1e-3)  # a flat-top window is flat to 0.01 dB


def test_the_spectrum_fills_in_ticks_that_were_skipped() -> None:
    t_s = np.delete(np.arange(60_000) / RATE_HZ, [5_000, 20_000, 20_001])
    found = spectrum([(t_s, sine(t_s))], RATE_HZ)
    assert found is not None
    assert found.largest == (pytest.approx(LINE_HZ, abs=0.07), pytest.approx(AMPLITUDE_N, rel=1e-3))


def test_a_phase_too_short_for_a_spectrum_has_none() -> None:
    assert spectrum([(np.arange(100) / RATE_HZ, np.zeros(100))], RATE_HZ) is None
    assert spectrum([], RATE_HZ) is None


def test_pendulum_and_bounce_are_those_of_the_notes_on_the_rig() -> None:
    lines = named_lines(config.load(daemons.PAPER), None)
    assert 1.0 / lines["pendulum"] == pytest.approx(2.69, abs=0.005)
    assert lines["bounce"] == pytest.approx(2.25, abs=0.01)  # 6 N/mm without the rope's own stretch
    assert "loop bandwidth" not in lines


def test_the_bandwidth_is_where_a_disturbance_is_no_longer_brought_down() -> None:
    settings = config.load(daemons.PAPER)
    model = filter_model(settings)
    figures = performance(settings, controller(model, Gains(**GAINS), filter_gain(model)))
    assert figures.sensitivity_3hz < math.sqrt(0.5) < figures.sensitivity_8hz
    wide = bandwidth_hz(settings, Gains(**GAINS))
    assert wide is not None
    assert 3.0 < wide < 8.0
    calm = settings.estimator.model_copy(update={"disturbance_walk_mm_s": 2.0})
    narrow = bandwidth_hz(settings.model_copy(update={"estimator": calm}), Gains(**GAINS))
    assert narrow is not None
    assert narrow < wide
