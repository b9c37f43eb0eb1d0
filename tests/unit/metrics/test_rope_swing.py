"""The swing found in records whose swing is known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from rigctl.metrics.phases import JudgedPhase
from rigctl.metrics.rope_swing import SIGNALS, rope_swing

RATE_HZ = 1000.0
SECONDS, BREAK_S = 14, 4.0


def _records(hz: float, damping: float, speed_mm_s: float, noise_mm_s: float = 0.1) -> npt.NDArray[Any]:
    """A rope that is pulled along until its rail breaks loose, and then swings; found in part, known in part."""
    records = np.zeros(SECONDS * int(RATE_HZ), [(name, "f8") for name in SIGNALS])
    t, w = np.arange(len(records)) / RATE_HZ, 2.0 * math.pi * hz
    since = np.maximum(t - BREAK_S, 0.0)
    swing = np.exp(-damping * w * since) * np.cos(w * math.sqrt(1.0 - damping**2) * since)
    speed = speed_mm_s * np.where(t < BREAK_S, t / BREAK_S, swing)
    records["stretch_mm_s"] = 0.7 * speed
    records["disturbance_mm_s"] = 0.3 * speed + noise_mm_s * np.random.default_rng(1).standard_normal(len(records))
    records["run_out_mm_s"] = math.nan  # no table
    return records


def _phase(records: npt.NDArray[Any], number: int = 1) -> JudgedPhase:
    return JudgedPhase(number, 0, 0, len(records), 300.0, "", faulted=False)


@pytest.mark.parametrize(("hz", "damping"), [(0.59, 0.006), (0.4, 0.05), (1.1, 0.02), (0.57, 0.15)])
def test_frequency_and_damping_are_those_of_the_swing(hz: float, damping: float) -> None:
    records = _records(hz, damping, 0.08)
    found = rope_swing(records, [_phase(records)], RATE_HZ)
    assert found is not None
    assert found.hz == pytest.approx(hz, rel=0.03)
    assert found.damping == pytest.approx(damping, rel=0.25, abs=0.003)
    assert found.in_words().startswith(f"{found.hz:.2g} Hz, damping ")


@pytest.mark.parametrize("speed_mm_s", [0.0, 0.005])
def test_noise_is_no_swing(speed_mm_s: float) -> None:
    records = _records(0.59, 0.006, speed_mm_s, noise_mm_s=1.0)
    assert rope_swing(records, [_phase(records)], RATE_HZ) is None


def test_a_short_phase_or_records_without_the_signals_have_none() -> None:
    records = _records(0.59, 0.006, 0.08)
    short = records[:3000]
    assert rope_swing(short, [_phase(short)], RATE_HZ) is None
    assert rope_swing(records[["stretch_mm_s"]], [_phase(records)], RATE_HZ) is None
    assert rope_swing(np.zeros_like(records), [_phase(records)], RATE_HZ) is None
