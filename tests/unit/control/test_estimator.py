"""The filter against its equations."""

from __future__ import annotations

import math

import control
import filterpy.kalman
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.control.law.estimator import FilterModel, TensionFilter, filter_model
from rigctl.design.gains import OPEN, QUIET, filter_gains
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
MODEL = filter_model(SETTINGS)


def test_the_model_is_the_exact_discretisation() -> None:
    k, tau = SETTINGS.plant.stiffness_n_mm, SETTINGS.plant.cylinder_lag_s
    a = np.array([[0.0, k, k, 0.0], [0.0, -1 / tau, 0.0, 1 / tau], [0.0] * 4, [0.0] * 4])
    step = expm(a * MODEL.period_s)
    np.testing.assert_allclose(MODEL.f, step[:3, :3], atol=1e-14)
    np.testing.assert_allclose(MODEL.b, step[:3, 3:], atol=1e-14)
    assert MODEL.delay_ticks == 2


class Plant:
    """The model's own plant with the loop's timing: a sample of tick n - 1 is read in tick n."""

    def __init__(self, model: FilterModel, disturbance_mm_s: float) -> None:
        self.model = model
        self.x = np.array([[100.0], [0.0], [disturbance_mm_s]])
        self.pending = [0.0] * model.delay_ticks

    def sample(self) -> tuple[float, float]:
        return float(self.x[0, 0]), float(self.x[1, 0])

    def step(self, command: float) -> None:
        self.pending.append(command)
        self.x = self.model.f @ self.x + self.model.b * self.pending.pop(0)


def test_it_finds_the_disturbance_and_the_state_the_next_command_meets() -> None:
    kalman, plant = TensionFilter(MODEL), Plant(MODEL, 3.0)
    kalman.reset(100.0, 0.0)
    sample = plant.sample()
    for n in range(2000):
        kalman.update(*sample)
        kalman.predict()
        now, pending = plant.x.copy(), list(plant.pending)
        command = 2.0 * math.sin(0.01 * n)
        kalman.command(command)
        sample = plant.sample()
        plant.step(command)
    assert kalman.state == pytest.approx(now[:, 0].tolist(), abs=1e-3)
    assert len(pending) == MODEL.delay_ticks
    for command in pending:
        now = MODEL.f @ now + MODEL.b * command
    assert kalman.ahead()[:3] == pytest.approx(now[:, 0].tolist(), abs=1e-3)


def test_an_absent_sample_is_predicted_through() -> None:
    kalman, plant = TensionFilter(MODEL), Plant(MODEL, 1.0)
    kalman.reset(100.0, 0.0)
    sample = plant.sample()
    for n in range(3000):
        kalman.update(sample[0] if n % 5 else None, sample[1] if n % 3 else None)
        kalman.predict()
        kalman.command(0.5)
        sample = plant.sample()
        plant.step(0.5)
    assert kalman.state[2] == pytest.approx(1.0, abs=1e-3)


HISTORY = 8


def test_no_history_of_eight_samples_takes_the_gain_out_of_its_sector() -> None:
    """A good sample corrects by a gain between the quiet and the open one, whatever was before; a bad one by none."""
    model = filter_model(changed(SETTINGS, {"estimator.quiet_disturbance_walk_mm_s": 1.0}))
    gains, kalman = filter_gains(model), TensionFilter(model)
    low, high = np.sort([gains[QUIET][:, 0], gains[OPEN][:, 0]], axis=0)
    burst_n = model.gate_sigma * model.f[0, 2] * model.burst_mm_s
    innovations = {"good": 1e-3, "missing": None, "rejected": 100.0 * burst_n, "surprising": 0.9 * burst_n}
    opening, cell = kalman.opening, kalman.cell
    assert opening is not None

    def goes_on(left: int) -> None:
        """Every history of so many samples from here; the gate's and the opening's memory is restored after each."""
        memory = opening.level, opening._mean, cell.since
        for kind, by_n in innovations.items():
            before = kalman.state
            kalman.update(None if by_n is None else before[0] + by_n, before[1])
            moved = [now - then for now, then in zip(kalman.state, before, strict=True)]
            if kind == "good":
                assert all(a <= 1e3 * each <= b for a, each, b in zip(low - 1e-6, moved, high + 1e-6, strict=True))
            elif kind == "surprising":
                assert by_n is not None
                assert 0.5 * by_n < moved[0] <= by_n
            else:
                assert moved == [0.0, 0.0, 0.0]
                assert kalman.level == 1.0
            if left > 1:
                cell.pass_ticks(1)
                goes_on(left - 1)
            opening.level, opening._mean, cell.since = memory

    kalman.reset(300.0, 0.0)
    cell.pass_ticks(1)
    kalman.settle()
    goes_on(HISTORY)


def test_a_surprising_sample_has_the_gain_of_the_widened_covariance() -> None:
    kalman = TensionFilter(MODEL)
    kalman.reset(300.0, 0.0)
    kalman.cell.since = 1
    burst = np.array([MODEL.f[0, 2], 0.0, 1.0]) * MODEL.burst_mm_s
    filtered = filterpy.kalman.KalmanFilter(dim_x=3, dim_z=2)
    filtered.H, filtered.R = np.eye(2, 3), np.diag([MODEL.cell_variance_n2, MODEL.speed_variance_mm2_s2])
    filtered.P = control.dare(MODEL.f.T, filtered.H.T, MODEL.q, filtered.R)[0] + np.outer(burst, burst)
    by_n = MODEL.gate_sigma * burst[0]
    filtered.update(np.array([by_n, 0.0]))
    kalman.update(300.0 + by_n, 0.0)
    assert not kalman.cell.surprised, "one sample alone may be noise"
    kalman.update(300.0 + by_n, 0.0)
    assert kalman.cell.surprised
    assert np.array(kalman.state) - [300.0, 0.0, 0.0] == pytest.approx(filtered.x[:, 0], rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_non_finite_sample_is_counted_and_left_out(bad: float) -> None:
    kalman = TensionFilter(MODEL)
    kalman.reset(300.0, 0.0)
    kalman.update(bad, bad)
    kalman.predict()
    assert kalman.refused == 2
    assert kalman.state == (300.0, 0.0, 0.0)


def test_skipped_periods_are_predicted_with_the_command_that_stayed() -> None:
    one, many = TensionFilter(MODEL), TensionFilter(MODEL)
    for kalman in (one, many):
        kalman.reset(300.0, 0.0)
        for _ in range(4):
            kalman.predict()
            kalman.command(5.0)
    for _ in range(3):
        one.predict()
    many.predict(3)
    assert many.state == pytest.approx(one.state)
    assert many.ahead() == pytest.approx(one.ahead())


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats() | st.none(), st.floats(-1e6, 1e6) | st.none()), max_size=60))
def test_whatever_is_measured_the_state_stays_finite(samples: list) -> None:  # type: ignore[type-arg]
    kalman = TensionFilter(MODEL)
    for tension, speed in samples:
        kalman.update(None if tension is None or abs(tension) > 1e9 else tension, speed)
        kalman.predict()
    assert all(math.isfinite(value) for value in kalman.state)


@pytest.mark.parametrize("gap", [0, 4])
def test_a_jolt_is_followed_from_its_second_sample_as_the_disturbance_that_explains_it(gap: int) -> None:
    """What two surprising samples add to the tension is a stretch since the last good one: its speed is known then."""
    kalman, jolt_mm_s = TensionFilter(MODEL), 80.0
    kalman.reset(300.0, 0.0)
    for _ in range(1000):
        kalman.update(300.0, 0.0)
        kalman.predict()
    for _ in range(gap):
        kalman.update(None, 0.0)
        kalman.predict()
    a_tick_n = SETTINGS.plant.stiffness_n_mm * jolt_mm_s * MODEL.period_s
    stretched = 300.0 + a_tick_n * (gap + 2)
    kalman.update(stretched - a_tick_n, 0.0)
    assert kalman.state == (300.0, 0.0, 0.0)
    kalman.predict()
    kalman.update(stretched, 0.0)
    assert kalman.cell.surprised
    tension_n, speed_mm_s, disturbance_mm_s = kalman.state
    assert tension_n == pytest.approx(stretched, abs=0.1 * (stretched - 300.0))
    assert disturbance_mm_s == pytest.approx(jolt_mm_s, rel=0.1)
    assert speed_mm_s == pytest.approx(0.0, abs=1.0)
