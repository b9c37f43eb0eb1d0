"""The swing as a state of the filter: its model, its prediction, and the tension it leaves, each by other code."""

from __future__ import annotations

import math
import pathlib

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import StateSpace, lsim

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import FilterModel, TensionFilter, filter_model
from rigctl.control.law.swing import SwingPeriod
from rigctl.control.law.tension import Estimate, TensionLaw
from rigctl.design.gains import design, filter_gain
from rigctl.design.plant_family import member
from tests.builders.paths import ROOT

HZ, DAMPING, WALK = 0.57, 0.05, 1.0
RIG = config.load(ROOT / "config/paper_rig.yaml")
WITH = {
    "estimator.inclination_swing_hz": None, "estimator.swing_hz": HZ, "estimator.swing_damping": DAMPING,
    "estimator.swing_walk_mm_s": WALK,
}  # fmt: skip
SWINGING = changed(RIG, WITH)
MODEL = filter_model(SWINGING)


def test_a_period_of_the_model_is_the_exponential_of_its_equations() -> None:
    plant, w = SWINGING.plant, 2.0 * math.pi * HZ
    decay, turn = DAMPING * w, w * math.sqrt(1.0 - DAMPING**2)
    k, tau = plant.stiffness_n_mm, plant.cylinder_lag_s
    continuous = np.zeros((6, 6))
    continuous[0, 1:4] = k
    continuous[1, 1], continuous[1, 5] = -1.0 / tau, 1.0 / tau
    continuous[3:5, 3:5] = [[-decay, turn], [-turn, -decay]]
    expected = expm(continuous * MODEL.period_s)
    np.testing.assert_allclose(MODEL.f, expected[:5, :5], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(MODEL.b[:, 0], expected[:5, 5], rtol=0.0, atol=1e-13)


def test_without_a_swing_model_and_arithmetic_are_those_of_three_states() -> None:
    plain = filter_model(RIG)
    assert plain.f.shape == (3, 3)
    assert plain.disturbance.tolist() == [0.0, 0.0, 1.0]
    assert not plain.lead.any()
    np.testing.assert_array_equal(plain.f, MODEL.f[:3, :3])
    np.testing.assert_array_equal(plain.q[1:, 1:], MODEL.q[1:3, 1:3])


def _run(kalman: TensionFilter, missing: tuple[int, ...] = ()) -> list[tuple[float, float, float, float]]:
    """A noisy rope that swings, under a moving drive; the estimates of each tick."""
    rng, found = np.random.default_rng(3), []
    for n in range(3000):
        t = n * 1e-3
        tension = 300.0 + 2.0 * math.sin(3.6 * t) + 0.03 * rng.standard_normal()
        kalman.update(None if n in missing else tension, 0.3 * math.cos(3.6 * t), 0.02)
        kalman.predict(3 if n == 2500 else 1)
        kalman.command(0.3 * math.cos(3.6 * t))
        found.append(kalman.ahead())
    return found


def test_plain_floats_give_what_the_matrices_give() -> None:
    kalman, gain = TensionFilter(MODEL), filter_gain(MODEL)
    kalman.reset(300.0, 0.3)
    kalman.settle()
    states, sent = np.array([300.0, 0.3, 0.0, 0.0, 0.0]), [0.0] * (MODEL.delay_ticks + 1)
    rng, differences = np.random.default_rng(3), []
    for n in range(500):
        t = n * 1e-3
        y = np.array([300.0 + 2.0 * math.sin(3.6 * t) + 0.03 * rng.standard_normal(), 0.3 * math.cos(3.6 * t)])
        kalman.update(float(y[0]), float(y[1]), 0.02)
        kalman.predict()
        kalman.command(float(y[1]))
        states = MODEL.f @ (states + gain @ (y - states[:2])) + MODEL.b[:, 0] * sent[0]
        states[0] += MODEL.f[0, 2] * 0.02
        sent = [*sent[1:], float(y[1])]
        differences.append(np.abs(np.array(kalman.state) - [states[0], states[1], states[2] + states[3]]).max())
    assert max(differences) < 1e-5  # the two Riccati solutions agree to 1e-8


def test_the_settled_gain_is_filterpys() -> None:
    np.testing.assert_allclose(TensionFilter(MODEL).gain, filter_gain(MODEL), rtol=1e-6, atol=1e-9)


def test_a_missing_sample_goes_on_with_the_swing() -> None:
    whole, gaps = TensionFilter(MODEL), TensionFilter(MODEL)
    for kalman in (whole, gaps):
        kalman.reset(300.0, 0.3)
        kalman.settle()
    without, with_gaps = np.array(_run(whole)), np.array(_run(gaps, (700, 1400, 1401, 2200)))
    assert np.abs(without - with_gaps)[:, 0].max() < 0.15  # five sigma of the cell's noise
    assert np.abs(without - with_gaps)[:, 2].max() < 0.5 * np.abs(without[:, 2]).max()


def test_the_lead_makes_the_drive_follow_the_swing() -> None:
    period, tau = SwingPeriod.of(SWINGING), SWINGING.plant.cylinder_lag_s
    assert period is not None
    t = np.arange(0.0, 5.0, 1e-3)
    decay, turn = DAMPING * 2.0 * math.pi * HZ, 2.0 * math.pi * HZ * math.sqrt(1.0 - DAMPING**2)
    a, b = np.exp(-decay * t) * np.cos(turn * t), -np.exp(-decay * t) * np.sin(turn * t)
    with_lead = -(a + period.lead[0] * a + period.lead[1] * b)
    drive = StateSpace([[-1.0 / tau]], [[1.0 / tau]], [[1.0]], [[0.0]])
    for command, most in ((with_lead, 1e-4), (-a, 0.05 * 1.5)):
        _, v, _ = lsim(drive, command, t, X0=[-1.0])
        left = float(np.abs(v + a).max())
        assert left < most if command is with_lead else left > 0.05


def _held(settings: RigSettings, model: FilterModel) -> float:
    """Rms of the true tension's error after 2 s, N, of a rope whose stretch swings by 0.08 mm/s, without noise."""
    plant, kalman = member(settings, None), TensionFilter(model)
    law = TensionLaw(settings, design(settings))
    kalman.reset(300.0, 0.0)
    kalman.settle()
    law.start_ramp(300.0, 0.0)
    state, sample, late, errors = np.zeros(len(plant.a)), (300.0, 0.0), [0.0] * plant.delay_ticks, []
    for n in range(8000):
        kalman.update(*sample)
        kalman.predict()
        tension_n, speed_mm_s, disturbance_mm_s, lead_mm_s = kalman.ahead()
        command = law.compensating(Estimate(tension_n, speed_mm_s, disturbance_mm_s, 50.0, lead_mm_s), 1.0)
        kalman.command(command)
        speed = 0.08 * math.cos(2.0 * math.pi * HZ * n * 1e-3)
        errors.append(state[0])
        late.append(command)
        sample = 300.0 + float(state[0] + plant.sensed_n_s_mm * speed), float(state[1])
        state = plant.a @ state + plant.b_command * late.pop(0) + plant.b_disturbance * speed
    return float(np.sqrt(np.mean(np.square(errors[2000:]))))


def test_a_swing_leaves_a_tenth_of_its_error() -> None:
    stiff = {"plant.spring_n_mm": 34.0, "estimator.disturbance_walk_mm_s": 0.5}
    plain, swinging = changed(RIG, {**stiff, "estimator.inclination_swing_hz": None}), changed(SWINGING, stiff)
    without, with_it = _held(plain, filter_model(plain)), _held(swinging, filter_model(swinging))
    assert with_it < 0.1 * without


def test_a_filter_that_takes_over_has_the_others_swing() -> None:
    now, other = (TensionFilter(filter_model(changed(SWINGING, {"plant.spring_n_mm": k}))) for k in (6.0, 5.0))
    _run(now)
    other.take_over(now)
    assert other.state == now.state
    assert other.ahead()[3] == pytest.approx(now.ahead()[3])


def test_both_counts_of_one_swing_are_refused(tmp_path: pathlib.Path) -> None:
    text = (ROOT / "config/paper_rig.yaml").read_text()
    file = tmp_path / "rig.yaml"
    file.write_text(text.replace("  inclination_swing_hz: 0.58", "  swing_hz: 0.57\n  inclination_swing_hz: 0.58"))
    with pytest.raises(config.ConfigError) as refused:
        config.load(file)
    (line,) = [line for line in refused.value.findings if "swing_hz" in line]
    assert "found 0.57, expected null beside inclination_swing_hz" in line
