"""Figures against numbers calculated by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rigctl.ipc.record import RECORD
from rigctl.metrics import tension_error as metrics
from rigctl.model.states import Mode


def test_percentiles_are_in_microseconds() -> None:
    assert metrics.percentiles_us(np.arange(1, 1001) * 1000) == {
        "p50": 500.5,
        "p99": pytest.approx(990.0, abs=0.1),
        "p999": pytest.approx(999.0, abs=0.1),
        "max": 1000.0,
    }
    assert set(metrics.percentiles_us(np.array([])).values()) == {0.0}


def test_eta_is_equation_16() -> None:
    peak, rms = metrics.largest_and_rms_pct(np.array([300.0, 303.0, 297.0, 300.0]), 300.0)
    assert peak == pytest.approx(1.0)
    assert rms == pytest.approx(math.sqrt(0.5))
    assert all(math.isnan(value) for value in metrics.largest_and_rms_pct(np.array([]), 300.0))


def test_windows_are_the_time_in_the_closed_loop_without_its_beginning() -> None:
    records = np.zeros(10, RECORD.dtype)
    records["t_ns"] = np.arange(10) * 1_000_000_000
    records["mode"] = [Mode.HOLD, *[Mode.COMPENSATING] * 5, Mode.HOLD, *[Mode.COMPENSATING] * 3]
    assert metrics.compensating_windows(records, 2.0) == [(3_000_000_000, 5_000_000_000)]
    assert metrics.compensating_windows(records, 1.0) == [
        (2_000_000_000, 5_000_000_000),
        (8_000_000_000, 9_000_000_000),
    ]
    inside = metrics.within(records["t_ns"], [(3_000_000_000, 5_000_000_000)])
    assert list(np.flatnonzero(inside)) == [3, 4, 5]
