"""Gains against closed forms, and against the running filter."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import Array, FilterModel, TensionFilter, filter_model
from rigctl.design.gains import OPEN, QUIET, DesignError, design, filter_gain, filter_gains
from rigctl.design.margins import design_and_check

Rig = Callable[..., RigSettings]


def test_gain_of_a_pure_integrator_has_its_closed_form(rig: Rig) -> None:
    # Without lag and (almost) without integral action the plant is x' = x + dt u for the stretch x.
    dt, q, r = 1e-3, 52.0, 1.0
    instant = rig(plant={"cylinder_lag_s": 1e-6}, design={"stretch_weight": q, "integral_weight": 1e-9})
    p = (q + math.sqrt(q**2 + 4 * q * r / dt**2)) / 2
    gains = design(instant)
    assert gains.k_tension * instant.plant.stiffness_n_mm == pytest.approx(p * dt / (r + p * dt**2), rel=1e-5)
    assert gains.k_speed == pytest.approx(0.0, abs=1e-5)  # K_x tau is 7e-6


def test_gains_of_a_fast_loop_tend_to_the_continuous_optimum(rig: Rig) -> None:
    # With x'' tau + x' = u, cost q x^2 + u^2: closed loop tau s^2 + (1 + K_v) s + K_x with K_x = sqrt(q) and
    # (1 + K_v)^2 = 1 + 2 tau sqrt(q), by spectral factorisation.
    q, tau = 52.0, 0.02
    fast = rig(loop={"rate_hz": 4000}, design={"stretch_weight": q, "integral_weight": 1e-9})
    gains = design(fast)
    # Sampled control acts half a period late: gains differ by that over the fastest closed-loop mode, 1 %.
    assert gains.k_tension * fast.plant.stiffness_n_mm == pytest.approx(math.sqrt(q), rel=0.01)
    assert gains.k_speed == pytest.approx(math.sqrt(1 + 2 * tau * math.sqrt(q)) - 1, rel=0.01)


@pytest.mark.parametrize("spring_n_mm", [6.0, 34.0])
def test_shape_of_the_loop_does_not_depend_on_the_spring(rig: Rig, spring_n_mm: float) -> None:
    soft, stiff = rig(plant={"spring_n_mm": 3.0}), rig(plant={"spring_n_mm": spring_n_mm})
    one, other = design(soft), design(stiff)
    ratio = stiff.plant.stiffness_n_mm / soft.plant.stiffness_n_mm
    # Two Riccati solutions of differently scaled matrices agree to solver accuracy.
    assert other.k_tension * ratio == pytest.approx(one.k_tension, rel=1e-6)
    assert other.k_integral * ratio == pytest.approx(one.k_integral, rel=1e-6)
    assert other.k_speed == pytest.approx(one.k_speed, rel=1e-6)


@pytest.mark.parametrize("rate_hz", [1000, 200])
def test_filter_settles_at_the_gain_the_margins_use(rig: Rig, rate_hz: int) -> None:
    model = filter_model(rig(loop={"rate_hz": rate_hz}))
    columns = []
    small = 0.01  # N, mm/s: within the filter's gate
    for sample in ((small, 0.0), (0.0, small)):
        running = TensionFilter(model)
        for _ in range(5000):
            running.update(0.0, 0.0)
            running.predict()
        running.update(*sample)  # an innovation adds the gain times itself to the state
        columns.append(np.array(running.state) / small)
    # The running filter freezes its gain when it changes by less than 1e-7 in a tick; some ten such changes are left.
    assert np.allclose(filter_gain(model), np.array(columns).T, rtol=1e-6, atol=5e-6)


def _spread(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(math.log10(low), math.log10(high)).map(lambda exponent: 10.0**exponent)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rate_hz=st.sampled_from([50, 100, 200, 500, 1000, 4000]),
    plant=st.fixed_dictionaries(
        {
            "spring_n_mm": _spread(0.1, 1e4),
            "rope_n_mm": _spread(1.0, 1e5),
            "cylinder_lag_s": _spread(1e-3, 1.0),
            "command_delay_s": st.floats(0.0, 0.004),
            "payload_kg": _spread(0.1, 1e3),
            "mechanism_n_mm": st.none() | _spread(0.1, 1e6),
        }
    ),
    estimator=st.fixed_dictionaries(
        {
            "speed_noise_mm_s": _spread(1e-3, 100.0),
            "tension_walk_n": _spread(1e-3, 1e3),
            "speed_walk_mm_s": _spread(1e-3, 1e3),
            "disturbance_walk_mm_s": _spread(1e-3, 1e4),
        }
    ),
    weights=st.fixed_dictionaries({"stretch_weight": _spread(1e-3, 1e6), "integral_weight": _spread(1e-3, 1e6)}),
)
def test_any_valid_rig_gets_finite_gains_and_a_verdict_or_a_clear_error(
    rig: Rig,
    rate_hz: int,
    plant: dict[str, float],
    estimator: dict[str, float],
    weights: dict[str, float],
) -> None:
    settings = rig(loop={"rate_hz": rate_hz}, plant=plant, estimator=estimator, design=weights)
    try:
        found = design_and_check(settings)
    except DesignError as error:
        assert str(error)
        assert "\n" not in str(error)
        return
    assert all(math.isfinite(g) for g in (found.gains.k_tension, found.gains.k_speed, found.gains.k_integral))
    assert found.ms_max >= 1.0
    assert found.accepted == (found.ms_max <= 1.6)
    assert all(member.stable == math.isfinite(member.ms) for member in found.margins)


def _settled_filter(model: FilterModel) -> Array:
    """The gain at which filterpy's filter ends, begun without any knowledge; no Riccati equation is solved."""
    kalman = KalmanFilter(dim_x=len(model.f), dim_z=2)
    kalman.F, kalman.Q, kalman.H = model.f, model.q, np.eye(2, len(model.f))
    kalman.R = np.diag([model.cell_variance_n2, model.speed_variance_mm2_s2])
    kalman.P *= 1e3
    for _ in range(2000):
        kalman.predict()
        kalman.update(np.zeros(2))
    return np.asarray(kalman.K)


def _optimal_gain(settings: RigSettings) -> Array:
    """Feedback of least cost over more and more ticks, from the last one backwards: dynamic programming in NumPy."""
    model, weights, k = filter_model(settings), settings.design, settings.plant.stiffness_n_mm
    a, b = np.eye(3), np.array([[*model.b[:2].ravel(), 0.0]]).T
    a[:2, :2], a[2, 0] = model.f[:2, :2], model.period_s
    q = np.diag([weights.stretch_weight / k**2, 0.0, weights.integral_weight / k**2])
    cost, gain = np.zeros((3, 3)), np.zeros((1, 3))
    for _ in range(20_000):
        gain = b.T @ cost @ a / (weights.command_weight + b.T @ cost @ b)
        cost = q + a.T @ cost @ (a - b @ gain)
        cost = 0.5 * (cost + cost.T)
    return np.asarray(gain[0])


@pytest.mark.parametrize("spring_n_mm", [6.0, 34.0])
def test_the_filters_gain_is_where_the_filter_settles(rig: Rig, spring_n_mm: float) -> None:
    quiet = {"quiet_tension_walk_n": 0.005, "quiet_disturbance_walk_mm_s": 4.0}
    model = filter_model(rig(plant={"spring_n_mm": spring_n_mm}, estimator=quiet))
    found = filter_gains(model)
    assert model.quiet_q is not None
    opened, rested = _settled_filter(model), _settled_filter(replace(model, q=model.quiet_q))
    assert found[OPEN] == pytest.approx(opened, rel=1e-9)
    assert found[QUIET][:, 0] == pytest.approx(rested[:, 0], rel=1e-9)
    assert not np.allclose(found[QUIET][:, 0], opened[:, 0], rtol=0.01)


@pytest.mark.parametrize("weights", [{}, {"stretch_weight": 400.0, "integral_weight": 4000.0, "command_weight": 0.5}])
def test_the_laws_gains_are_those_of_least_cost(rig: Rig, weights: dict[str, float]) -> None:
    settings = rig(design=weights)
    assert np.array(design(settings).in_order) == pytest.approx(_optimal_gain(settings), rel=1e-9)
