"""The stretch ahead of time, against a swing whose angle and rate are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.control.law.stretch_lead import MOST_AHEAD_S, StretchLead
from tests.builders.paths import ROOT

SETTINGS = changed(config.load(ROOT / "config/paper_rig.yaml"), {"estimator.inclination_swing_hz": 0.58})
DT = 1.0 / SETTINGS.loop.rate_hz
LENGTH_MM = SETTINGS.plant.rope_length_mm
OMEGA = 2.0 * math.pi * 0.58
SENSOR_S = 1e-3 * SETTINGS.estimator.inclination_lag_ms
AHEAD_S = SETTINGS.plant.cylinder_lag_s + SETTINGS.plant.command_delay_s + DT


def stretch_speed(t: float) -> float:
    """Of 0.5 deg about 1 deg on one axis, mm/s."""
    angle = math.radians(1.0 + 0.5 * math.sin(OMEGA * t))
    rate = math.radians(0.5) * OMEGA * math.cos(OMEGA * t)
    return LENGTH_MM / math.cos(angle) * math.tan(angle) * rate


def shown(t: float) -> float:
    """The angle behind the sensor's low-pass, rad, after it has settled."""
    gain, late = 1.0 / math.hypot(1.0, OMEGA * SENSOR_S), math.atan(OMEGA * SENSOR_S)
    return math.radians(1.0 + 0.5 * gain * math.sin(OMEGA * t - late))


@pytest.mark.parametrize("noise_deg", [0.0, 0.006])
def test_it_knows_the_speed_now_and_when_a_command_has_been_followed(noise_deg: float) -> None:
    subject, noise = StretchLead(SETTINGS), np.random.default_rng(3)
    now, then = [], []
    for n in range(12_000):
        if n % 10 == 0:
            subject.update(shown(n * DT) + math.radians(noise_deg) * noise.standard_normal(), 0.0)
        speed, change = subject.speeds_mm_s()
        subject.pass_ticks(1)
        if n > 5000:
            now.append(speed - stretch_speed(n * DT))
            then.append(speed + change - stretch_speed(n * DT + AHEAD_S))
    largest = max(stretch_speed(i * DT) for i in range(2000))
    # Without the lead the error would be omega times 23 ms, 8 % of the amplitude.
    assert np.std(now) < (1e-9 if not noise_deg else 0.02) * largest
    assert np.std(then) < (1e-9 if not noise_deg else 0.02) * largest


def test_both_axes_count_and_a_sign_does_not() -> None:
    speeds = []
    for axes in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)):
        subject = StretchLead(SETTINGS)
        for n in range(3001):
            if n % 10 == 0:
                subject.update(*(axis * shown(n * DT) for axis in axes))
            found = subject.speeds_mm_s()
            subject.pass_ticks(1)
        speeds.append(found)
    assert speeds[0] == pytest.approx(speeds[1])
    assert speeds[0] == pytest.approx(speeds[2])


def test_without_samples_it_knows_nothing_and_starts_again_at_rest() -> None:
    subject = StretchLead(SETTINGS)
    assert subject.speeds_mm_s() == (0.0, 0.0)
    for n in range(300):
        if n % 10 == 0:
            subject.update(shown(n * DT), 0.0)
        subject.pass_ticks(1)
    assert subject.speeds_mm_s() != (0.0, 0.0)
    subject.pass_ticks(200)
    assert subject.speeds_mm_s() == (0.0, 0.0)
    subject.update(shown(0.0), 0.0)
    assert subject.speeds_mm_s() == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(("beyond", "known"), [(0, True), (1, False)])
def test_a_gap_up_to_the_longest_is_bridged_and_a_longer_one_is_a_new_start(beyond: int, known: bool) -> None:
    subject, gap = StretchLead(SETTINGS), round(MOST_AHEAD_S / DT) + beyond
    for n in range(0, 3000, 10):
        subject.update(shown(n * DT), 0.0)
        subject.pass_ticks(10)
    subject.pass_ticks(gap - 10)  # since the last sample
    assert (subject.speeds_mm_s() != (0.0, 0.0)) == known
    subject.update(shown((2990 + gap) * DT), 0.0)
    assert (abs(subject.speeds_mm_s()[0]) > 1e-3) == known
