"""Inclination filter and stretch against signals whose angle, rate and stretch are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from rigctl.config import rig_file as config
from rigctl.control.law.inclination import InclinationFilter, Stretch
from rigctl.model.samples import Verdict
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
DT = 1.0 / SETTINGS.loop.rate_hz
NOISE = math.radians(SETTINGS.estimator.inclination_noise_deg)
WALK = math.radians(SETTINGS.estimator.inclination_walk_deg_s)


@pytest.mark.parametrize("every", [10, 40, 100])  # ticks between samples: 100, 25, 10 Hz
def test_it_knows_angle_and_rate_between_the_samples(every: int) -> None:
    subject = InclinationFilter(SETTINGS)
    rate = math.radians(0.2)
    for n in range(4000):
        if n % every == 0:
            subject.update(rate * n * DT, -0.5 * rate * n * DT)
        else:
            subject.absent()
        if n > 2000:
            tangential, tangential_rate, normal, normal_rate = subject.state
            assert tangential == pytest.approx(rate * n * DT, abs=1e-5)
            assert tangential_rate == pytest.approx(rate, rel=0.01)
            assert normal == pytest.approx(-0.5 * tangential, abs=1e-5)
            assert normal_rate == pytest.approx(-0.5 * tangential_rate, rel=1e-6)
        subject.pass_ticks(1)


def test_it_is_steadier_than_its_samples() -> None:
    subject, noise = InclinationFilter(SETTINGS), np.random.default_rng(2)
    errors = []
    for n in range(20_000):
        if n % 10 == 0:
            a, b = NOISE * noise.standard_normal(2)
            subject.update(0.01 + float(a), float(b))
            errors.append(subject.state[0] - 0.01)
        subject.pass_ticks(1)
    assert np.std(errors[200:]) < 0.75 * NOISE


def test_its_innovations_have_the_variance_it_gives_them() -> None:
    squares = []
    for seed in range(50):
        subject, noise = InclinationFilter(SETTINGS), np.random.default_rng(seed)
        x, step = np.zeros(2), 10 * DT
        root = np.linalg.cholesky(WALK**2 * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]))
        for n in range(300):
            subject.update(float(x[0] + NOISE * noise.standard_normal()), 0.0)
            if n >= 100:
                squares.append(subject.tangential.innovation**2 / subject.tangential.variance)
            subject.pass_ticks(10)
            x = np.array([[1.0, step], [0.0, 1.0]]) @ x + root @ noise.standard_normal(2)
    low, high = stats.chi2.ppf((0.025, 0.975), len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_the_settled_form_gives_what_the_full_recursion_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    noise = np.random.default_rng(5).standard_normal((2000, 2))

    def run() -> tuple[list[float], int]:
        subject, settled = InclinationFilter(SETTINGS), 0
        states: list[float] = []
        for n, (a, b) in enumerate(noise):
            late = 3 if n in (700, 1200) else 0  # one sample comes late, one is a spike
            subject.pass_ticks(10 + late)
            subject.update(0.01 * math.sin(0.01 * n) + NOISE * float(a), 0.4 if n == 900 else NOISE * float(b))
            settled += subject._settled is not None
            states += subject.state
        return states, settled

    fast, settled = run()
    monkeypatch.setattr("rigctl.control.law.inclination.SETTLED_GAIN", -1.0)
    full, never = run()
    assert settled > 1000
    assert never == 0
    np.testing.assert_allclose(fast, full, atol=1e-7)


def test_a_spike_is_left_out_and_a_tilted_rope_is_believed_in_time() -> None:
    subject = InclinationFilter(SETTINGS)
    for n in range(100):
        subject.update(0.0, 0.0 if n != 50 else 0.3)
        if n == 50:
            assert subject.normal.verdict == Verdict.REJECTED
            assert subject.state[0] == pytest.approx(0.0, abs=1e-9)
        subject.pass_ticks(10)
    for _ in range(100):
        subject.update(0.2, 0.0)
        subject.pass_ticks(10)
    assert subject.state[0] == pytest.approx(0.2, abs=0.01)


def test_without_samples_it_carries_on_for_a_tenth_of_a_second_only() -> None:
    subject = InclinationFilter(SETTINGS)
    for n in range(200):
        subject.update(0.001 * n, 0.0)
        subject.pass_ticks(10)
    last = subject.state[0]
    subject.pass_ticks(10_000)
    assert subject.state[0] - last < 0.1 * 0.11  # 0.1 rad/s


def test_the_stretch_speed_is_the_rate_of_the_low_passed_stretch() -> None:
    subject, length = Stretch(1800.0, DT), 1800.0
    for n in range(3000):
        angle = math.radians(0.2) * n * DT
        speed = subject.speed_mm_s(math.cos(angle))
    late = angle - math.radians(0.2) * Stretch.LOW_PASS_S
    assert speed == pytest.approx(length * late * math.radians(0.2), rel=0.01)  # d/dt L (1/cos - 1) = L theta theta'
    for _ in range(3000):
        speed = subject.speed_mm_s(math.cos(angle))
    assert speed == pytest.approx(0.0, abs=1e-9)


def test_the_stretch_starts_at_rest_wherever_the_rope_stands() -> None:
    assert Stretch(1800.0, DT).speed_mm_s(math.cos(0.1)) == 0.0


def test_the_first_sample_is_the_state_and_before_it_there_is_none() -> None:
    subject = InclinationFilter(SETTINGS)
    assert subject.state == (0.0, 0.0, 0.0, 0.0)
    subject.update(0.2, -0.1)
    assert subject.state == (0.2, 0.0, -0.1, 0.0)
