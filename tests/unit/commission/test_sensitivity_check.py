"""Measured against predicted sensitivity, line by line."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.commission.sensitivity_check import SensitivityDifference, difference

HZ = np.array([5.0, 20.0, 60.0])
LOW, HIGH = np.array([0.3, 1.0, 1.1]), np.array([0.5, 1.2, 1.5])


def found(*measured: float, error: float = 0.02) -> SensitivityDifference | None:
    return difference(HZ, np.array(measured), np.full(3, error), LOW, HIGH)


def test_inside_its_band_nothing_differs() -> None:
    assert found(0.4, 1.1, 1.3) is None
    assert found(0.4, 1.1, 1.56) is None, "within twice the half width of its interval"


def test_the_line_furthest_from_its_band_is_named() -> None:
    worst = found(0.4, 1.5, 1.9)
    assert worst is not None
    assert (worst.hz, worst.measured, worst.low, worst.high) == (60.0, 1.9, 1.1, 1.5)
    assert "|S| is 1.90 +- 0.02 at 60 Hz" in worst.in_words()
    low = difference(HZ, np.array([0.4, 1.1, 1.45]), np.full(3, 0.02), LOW, HIGH + 1.0)
    assert low is None
    assert difference(HZ, np.array([0.4, 1.1, 1.45]), np.full(3, 0.02), LOW + 0.6, HIGH + 1.0) is not None, "below it"


def test_where_the_sensitivity_cannot_reach_1_4_nothing_is_said() -> None:
    assert found(0.9, 1.1, 0.9) is None
    assert found(0.9, 1.35, 1.3, error=0.01) is None
    at = found(0.9, 1.395, 1.3, error=0.01)
    assert at is not None, "1.405 is within its interval"
    assert at.hz == 20.0


@pytest.mark.parametrize("error", [0.5, float("nan"), float("inf")])
def test_what_is_not_known_differs_from_nothing(error: float) -> None:
    assert found(0.4, 1.1, 1.9, error=error) is None
