"""NIS and whiteness of innovations whose statistics are known."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.metrics.innovations import LAGS, InnovationStatistics, innovation_statistics
from rigctl.metrics.phases import JudgedPhase

COUNT = 20_000
PHASES = [
    JudgedPhase(1, 0, 0, COUNT // 2, 300.0, "by command", faulted=False),
    JudgedPhase(2, 0, COUNT // 2 + 100, COUNT, 300.0, "by command", faulted=False),
]


def found(innovation: np.ndarray, variance: float, refused: int = 0) -> InnovationStatistics:
    kind = [("innovation_n", "f8"), ("innovation_n2", "f8"), ("tension_verdict", "u1")]
    records = np.zeros(COUNT, kind)
    records["innovation_n"], records["innovation_n2"], records["tension_verdict"] = innovation, variance, 1
    records["tension_verdict"][:refused] = 2
    (only,) = innovation_statistics(records, PHASES)
    return only


def test_white_innovations_of_the_right_variance_fit() -> None:
    fits = found(0.03 * np.random.default_rng(1).standard_normal(COUNT), 0.03**2)
    assert fits.nis == pytest.approx(1.0, abs=1.96 * np.sqrt(2.0 / fits.samples))
    assert fits.beyond <= 0.12  # 5 % of 50 lags, with the spread of so few
    assert fits.refused == 0


def test_a_cell_twice_as_noisy_is_found_and_refused_samples_do_not_count() -> None:
    noise = 0.06 * np.random.default_rng(2).standard_normal(COUNT)
    noise[:30] = 100.0
    noisy = found(noise, 0.03**2, refused=30)
    assert noisy.nis == pytest.approx(4.0, rel=0.05)
    assert noisy.refused == 30


def test_a_disturbance_that_the_filter_leaves_is_found() -> None:
    white = np.random.default_rng(3).standard_normal(COUNT)
    swing = 0.5 * np.sin(2.0 * np.pi * np.arange(COUNT) / 200.0)
    left = found(0.03 * (white + swing), 0.03**2)
    assert left.beyond > 0.8
    expected = 0.125 / 1.125 * np.cos(2.0 * np.pi * np.arange(1, LAGS + 1) / 200.0)
    assert left.largest == pytest.approx(expected[left.largest_lag - 1], abs=0.03)
    assert "beyond 95 %" in left.white_words()
