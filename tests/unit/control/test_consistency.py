"""Monte Carlo: the filter on the plant it assumes. NIS, NEES and whiteness over many seeds, in their 95 % bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import solve_discrete_are

from rigctl.config import rig_file as config
from rigctl.control.law.estimator import Array, FilterModel, TensionFilter, filter_model
from tests.builders.paths import ROOT

SEEDS = 40
TICKS = 1500
SETTLE = 500  # ticks until the gain has settled and the first covariance has no effect
MODEL = filter_model(config.load(ROOT / "config/paper_rig.yaml"))


class Run:
    """One seed: normalised squares and innovations (ticks, 2) after settling."""

    def __init__(self, model: FilterModel, seed: int, assumed: FilterModel) -> None:
        noise = np.random.default_rng(seed)
        kalman = TensionFilter(assumed)
        x = np.array([300.0, 0.0, 0.0])
        kalman.reset(300.0, 0.0)
        root = np.linalg.cholesky(model.q)
        deviation = np.sqrt([model.cell_variance_n2, model.speed_variance_mm2_s2])
        pending = [0.0] * (model.delay_ticks + 1)
        commands = np.sin(np.arange(TICKS) * 0.02)
        h = np.eye(2, 3)
        nees, nis, innovations = [], [], []
        noises = np.diag([assumed.cell_variance_n2, assumed.speed_variance_mm2_s2])
        prior = solve_discrete_are(assumed.f.T, h.T, assumed.q, noises)
        s = h @ prior @ h.T + noises
        after = prior - prior @ h.T @ np.linalg.solve(s, h @ prior)
        for n in range(TICKS):  # a sample latched in one tick is read in the next one
            y, v = x[:2] + deviation * noise.standard_normal(2)
            before = np.array(kalman.state)
            kalman.update(float(y), float(v))
            if n >= SETTLE:
                innovation = np.array([y, v]) - before[:2]
                error = x - np.array(kalman.state)
                nis.append(innovation @ np.linalg.solve(s, innovation))
                nees.append(error @ np.linalg.solve(after, error))
                innovations.append(innovation / np.sqrt(np.diag(s)))
            kalman.predict()
            kalman.command(float(commands[n]))
            pending.append(float(commands[n]))
            x = model.f @ x + model.b[:, 0] * pending.pop(0) + root @ noise.standard_normal(3)
        self.nis, self.nees = float(np.mean(nis)), float(np.mean(nees))
        self.running = (kalman.cell.nis, kalman.drive.nis)
        self.innovations: Array = np.array(innovations)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return [Run(MODEL, seed, MODEL) for seed in range(SEEDS)]


def interval(dimension: int, samples: int) -> tuple[float, float]:
    """95 % interval of the mean of ``samples`` chi-squares of so many degrees of freedom."""
    low, high = stats.chi2.ppf((0.025, 0.975), dimension * samples) / samples
    return float(low), float(high)


def test_mean_nis_over_the_seeds_is_inside_its_interval(runs: list[Run]) -> None:
    low, high = interval(2, SEEDS * (TICKS - SETTLE))  # innovations are white: every tick counts
    assert low < np.mean([run.nis for run in runs]) < high


def test_mean_nees_over_the_seeds_is_inside_its_interval(runs: list[Run]) -> None:
    # Errors of one seed are correlated over its ticks; seeds are not: their means have the spread of the mean of all.
    means = [run.nees for run in runs]
    assert abs(np.mean(means) - 3.0) < 1.96 * np.std(means, ddof=1) / np.sqrt(SEEDS)


def test_the_innovations_are_white(runs: list[Run]) -> None:
    lags, count = range(1, 21), TICKS - SETTLE
    outside = total = 0
    for run in runs:
        for axis in range(2):
            y = run.innovations[:, axis]
            power = float(y @ y)
            for lag in lags:
                outside += abs(float(y[lag:] @ y[:-lag])) / power > 1.96 / np.sqrt(count)
                total += 1
    spread = 1.96 * np.sqrt(0.05 * 0.95 / total)
    assert abs(outside / total - 0.05) < 2.0 * spread  # lags of one seed are not quite independent


def test_the_running_nis_of_each_sensor_is_about_one(runs: list[Run]) -> None:
    means = np.mean([run.running for run in runs], axis=0)
    np.testing.assert_allclose(means, 1.0, atol=0.05)  # of 60 runs with about a thousand samples each: sigma 0.006


@pytest.mark.parametrize(
    "wrong",
    [
        {"cell_variance_n2": 2.0 * MODEL.cell_variance_n2},
        {"speed_variance_mm2_s2": 0.5 * MODEL.speed_variance_mm2_s2},
        {"q": 4.0 * MODEL.q},
    ],
)
def test_a_filter_that_assumes_the_wrong_noise_is_found_out(wrong: dict[str, object]) -> None:
    assumed = replace(MODEL, **wrong)  # type: ignore[arg-type]
    runs = [Run(MODEL, seed, assumed) for seed in range(10)]
    low, high = interval(2, 10 * (TICKS - SETTLE))
    assert not low < np.mean([run.nis for run in runs]) < high
