"""How far the filter opens: quiet on white innovations, open on a mean, and back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import TensionFilter, filter_model
from rigctl.control.law.opening import mean_share, rest_variances
from tests.builders.paths import ROOT

SETTINGS = changed(
    config.load(ROOT / "config/paper_rig.yaml"),
    {
        "estimator.quiet_disturbance_walk_mm_s": 1.0,
        "estimator.quiet_after_ms": 100.0,
    },
)


def settled(settings: RigSettings) -> TensionFilter:
    """At rest on 300 N, its gain settled, quiet."""
    kalman = TensionFilter(filter_model(settings))
    kalman.reset(300.0, 0.0)
    for _ in range(4000):
        kalman.update(300.0, 0.0)
        kalman.predict()
    assert kalman.level == 0.0
    return kalman


def test_noise_alone_leaves_it_quiet_and_a_mean_opens_it() -> None:
    kalman, noise = settled(SETTINGS), np.random.default_rng(1).standard_normal((20_000, 2))
    model, levels, innovations = kalman.model, [], []
    cell_n, speed_mm_s = math.sqrt(model.cell_variance_n2), math.sqrt(model.speed_variance_mm2_s2)
    for a, b in noise:
        kalman.update(300.0 + cell_n * a, speed_mm_s * b)
        kalman.predict()
        levels.append(kalman.level)
        innovations.append(kalman.cell.innovation)
    # 3 sigma of a mean that changes over 100 samples: one in some seconds exceeds it, and then by little.
    assert np.mean(levels) < 0.03
    # NIS says whether the cell is as noisy as the file says: 1 at rest.
    assert np.mean(np.square(innovations)) == pytest.approx(kalman.cell.variance, rel=0.1)
    for a, b in noise[:300]:
        kalman.update(300.3 + cell_n * a, speed_mm_s * b)
        kalman.predict()
        levels.append(kalman.level)
    assert max(levels[-300:]) == 1.0


def test_the_variance_of_the_mean_is_that_of_the_filter_in_noise() -> None:
    f, gain = (
        np.array([[1.0, 0.01, 0.006], [0.0, 0.95, 0.0], [0.0, 0.0, 1.0]]),
        np.array([[0.05, 0.001], [0.001, 0.02], [0.8, 0.01]]),
    )
    r, share = np.diag([0.03**2, 0.1**2]), mean_share(30.0)
    noise, error, mean = np.random.default_rng(5), np.zeros(3), 0.0
    innovations, means = [], []
    for sample in noise.standard_normal((200_000, 2)) * np.sqrt(np.diag(r)):
        innovation = error[:2] + sample
        mean += share * (innovation[0] - mean)
        innovations.append(innovation[0])
        means.append(mean)
        error = f @ (error - gain @ innovation)
    variance, of_mean = rest_variances(f, gain, r, 30.0)
    assert np.var(innovations) == pytest.approx(variance, rel=0.02)
    assert np.var(means) == pytest.approx(of_mean, rel=0.1)


def test_a_jolt_opens_the_filter_within_a_tick() -> None:
    kalman = settled(SETTINGS)
    stretched = SETTINGS.plant.stiffness_n_mm * 50.0 * kalman.model.period_s  # N in a tick, at 50 mm/s
    kalman.update(300.0 + stretched, 0.0)
    assert kalman.level == 1.0


def test_a_slope_without_a_surprise_opens_it_by_its_mean() -> None:
    kalman = settled(SETTINGS)
    slope_n = SETTINGS.plant.stiffness_n_mm * 1.0 * kalman.model.period_s  # N in a tick, at 1 mm/s
    highest = 0.0
    for tick in range(1, 51):
        kalman.update(300.0 + slope_n * tick, 0.0)
        kalman.predict()
        assert not kalman.cell.surprised
        highest = max(highest, kalman.level)
    assert highest == 1.0


def test_an_absent_sample_opens_it_and_it_becomes_quiet_again() -> None:
    kalman = settled(SETTINGS)
    kalman.update(None, 0.0)
    kalman.predict()
    assert kalman.level == 1.0
    for _ in range(6000):
        kalman.update(300.0, 0.0)
        kalman.predict()
    assert kalman.level == 0.0


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_the_gain_in_use_lies_between_the_settled_ones(level: float, monkeypatch: pytest.MonkeyPatch) -> None:
    from rigctl.design.gains import OPEN, QUIET, filter_gains

    kalman = settled(SETTINGS)
    gains = filter_gains(kalman.model)
    expected = level * gains[OPEN] + (1.0 - level) * gains[QUIET]
    opening = kalman.opening
    assert opening is not None
    monkeypatch.setattr(type(opening), "look", lambda _self, _z: None)
    opening.level = level
    before, small = np.array(kalman.state), 0.01
    kalman.update(300.0 + small, 0.0)
    assert (np.array(kalman.state) - before) / small == pytest.approx(expected[:, 0], rel=1e-6, abs=1e-9)
