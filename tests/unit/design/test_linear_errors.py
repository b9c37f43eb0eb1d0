"""The errors by response, against the law in real ticks around the same plant, and against python-control."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.design import surrogate
from rigctl.design.closed_loop import ClosedLoop, closed_loop
from rigctl.design.gains import OPEN, design
from rigctl.design.linear_errors import MOVE, TONES, LinearCases, recorded_move, references_n
from rigctl.design.margins import controllers
from rigctl.design.plant_family import nominal
from rigctl.design.surrogate import OurLaw, play, scenarios

Rig = Callable[..., RigSettings]
SWING: dict[str, Any] = {"inclination_swing_hz": None, "swing_hz": 0.59, "swing_damping": 0.05, "swing_walk_mm_s": 0.5}
PLAIN: dict[str, Any] = {"inclination_swing_hz": None}


def _loop(settings: RigSettings) -> ClosedLoop:
    law = controllers(filter_model(settings), design(settings))[OPEN]
    return closed_loop(nominal(settings), law)


@pytest.mark.parametrize("estimator", [PLAIN, SWING])
@pytest.mark.parametrize("spring_n_mm", [6.0, 34.0])
def test_move_and_noise_are_those_of_python_control(rig: Rig, estimator: dict[str, Any], spring_n_mm: float) -> None:
    settings = rig(estimator=estimator, plant={"spring_n_mm": spring_n_mm})
    law = controllers(filter_model(settings), design(settings))[OPEN]
    found, loop = LinearCases(settings).errors(law.response), _loop(settings)
    every_s, from_s, speeds = recorded_move()
    t = np.arange(round(len(speeds) * every_s * 1000)) * 1e-3
    speed = np.interp(t, (np.arange(len(speeds)) + 0.5) * every_s, speeds)
    whole = control.ss(loop.a, loop.b[:, [2]], loop.tension, loop.loss_n_s_mm, 1e-3)
    error = control.forced_response(whole, t, speed).outputs[t >= from_s]
    noise_n = settings.tension_cell.noise_n
    covariance = noise_n**2 * solve_discrete_lyapunov(loop.a, np.outer(loop.b[:, 0], loop.b[:, 0]))
    expected_n2 = np.mean(error**2) + loop.tension @ covariance @ loop.tension
    assert found.rms_n[MOVE] == pytest.approx(math.sqrt(expected_n2), rel=0.02)
    assert found.command_mm_s == pytest.approx(math.sqrt(loop.command @ covariance @ loop.command), rel=0.02)


@pytest.mark.parametrize("name", list(TONES))
def test_a_sine_is_that_of_the_law_in_real_ticks(rig: Rig, name: str) -> None:
    settings = rig(estimator={"quiet_tension_walk_n": None, **PLAIN})
    law = controllers(filter_model(settings), design(settings))[OPEN]
    found = LinearCases(settings).errors(law.response).rms_n[name]
    case = next(case for case in scenarios(settings) if case.name == name)
    if name == "vertical":  # one period after one from rest
        case = replace(case, seconds=20.0, from_s=10.0)
    played = play(settings, OurLaw(settings, design(settings)), nominal(settings), case)
    assert found == pytest.approx(played.rms_n, rel=0.06)


def test_steps_of_the_command_are_those_of_real_ticks(rig: Rig) -> None:
    settings = rig(estimator=PLAIN)
    law = controllers(filter_model(settings), design(settings))[OPEN]
    rest = next(case for case in scenarios(settings) if case.name == surrogate.REST)
    played = play(settings, OurLaw(settings, design(settings)), nominal(settings), rest)
    assert LinearCases(settings).errors(law.response).step_mm_s == pytest.approx(played.step_mm_s, rel=0.1)


def test_every_group_of_the_cost_has_a_reference(rig: Rig) -> None:
    soft, stiff = references_n(rig()), references_n(rig(plant={"spring_n_mm": 34.0}))
    assert soft.keys() == {MOVE, *TONES, surrogate.JOLT}
    assert all(soft[name] < stiff[name] for name in soft)
