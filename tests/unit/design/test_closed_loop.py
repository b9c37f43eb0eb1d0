"""The linear controller equals the running one: the real filter and law, closed around the same sampled plant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import Array, TensionFilter, filter_model
from rigctl.control.law.opening import Opening
from rigctl.control.law.tension import Estimate, TensionLaw
from rigctl.design.closed_loop import ClosedLoop, closed_loop, controller
from rigctl.design.gains import OPEN, QUIET, design, filter_gain, filter_gains
from rigctl.design.plant_family import Member, member

Rig = Callable[..., RigSettings]
TARGET_N = 300.0
SMALL = (0.01, 0.01, 0.05)  # N, mm/s, mm/s: small enough that no limit acts


def _estimate(kalman: TensionFilter) -> Estimate:
    tension_n, speed_mm_s, disturbance_mm_s, lead_mm_s = kalman.ahead()
    return Estimate(tension_n, speed_mm_s, disturbance_mm_s, 50.0, lead_mm_s)


def _impulse_of_the_objects(settings: RigSettings, plant: Member, channel: int, ticks: int) -> Array:
    """Tension deviation N and command mm/s, shape (ticks, 2), in the loop's order of work."""
    running = TensionFilter(filter_model(settings))
    law = TensionLaw(settings, design(settings))
    running.reset(TARGET_N, 0.0)
    law.start_ramp(TARGET_N, 0.0)
    for _ in range(max(3000, 2 * settings.loop.rate_hz)):  # at rest on the target: the filter's gain settles
        running.update(TARGET_N, 0.0)
        running.predict()
        running.command(law.compensating(_estimate(running), cosine=1.0))
    kick = np.zeros(3)
    kick[channel] = SMALL[channel]
    state, sample = np.zeros(len(plant.a)), np.array([TARGET_N, 0.0])
    under_way = [0.0] * plant.delay_ticks
    rows = []
    for tick in range(ticks):
        noise = kick if tick == 0 else np.zeros(3)
        running.update(float(sample[0]), float(sample[1]))
        running.predict()
        command = law.compensating(_estimate(running), cosine=1.0)
        running.command(command)
        assert law.limits == 0
        rows.append((state[0], command))
        sample = state[:2] + noise[:2] + [TARGET_N, 0.0]  # latched by the SYNC that follows the command
        under_way.append(command)
        state = plant.a @ state + plant.b_command * under_way.pop(0) + plant.b_disturbance * noise[2]
    return np.array(rows)


def _impulse_of_the_model(loop: ClosedLoop, channel: int, ticks: int) -> list[tuple[float, float]]:
    """The same of the linear loop."""
    state = loop.b[:, channel] * SMALL[channel]
    found = [(0.0, 0.0)]
    for _ in range(ticks - 1):
        found.append((float(state[0]), float(loop.command @ state)))
        state = loop.a @ state
    return found


ROUNDED = 1e-11
"""N, mm/s: a double beside 300 N is known to 6e-14, and the integral keeps what it was given wrong."""


@pytest.mark.parametrize("channel", [0, 1, 2], ids=["cell noise", "speed noise", "disturbance"])
@pytest.mark.parametrize(
    ("rate_hz", "k_m", "k_scale", "delay_scale"),
    [(1000, None, 1.0, 1), (1000, 6.0, 0.8, 2), (1000, 60.0, 1.2, 1), (200, 60.0, 1.0, 2), (4000, None, 1.2, 2)],
)
def test_margins_describe_the_code_that_runs(
    rig: Rig,
    rate_hz: int,
    k_m: float | None,
    k_scale: float,
    delay_scale: int,
    channel: int,
) -> None:
    settings = rig(loop={"rate_hz": rate_hz})
    model = filter_model(settings)
    plant = member(settings, k_m, k_scale, delay_scale)
    loop = closed_loop(plant, controller(model, design(settings), filter_gain(model)))
    expected = _impulse_of_the_model(loop, channel, 1000)
    real = _impulse_of_the_objects(settings, plant, channel, 1000)
    # 1e-6 of the largest value: the filter's gain has not quite settled; and what rounding beside 300 N adds up to.
    assert np.allclose(real, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max(axis=0) + ROUNDED)


SWING = {"inclination_swing_hz": None, "swing_hz": 0.57, "swing_damping": 0.1, "swing_walk_mm_s": 0.5}


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(("rate_hz", "k_m", "swing"), [(1000, 60.0, {}), (200, None, {}), (1000, 60.0, SWING)])
def test_margins_of_each_setting_describe_the_code_that_runs(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, rate_hz: int, k_m: float | None, level: float, swing: dict[str, Any]
) -> None:
    monkeypatch.setattr(Opening, "look", lambda self, _: setattr(self, "level", level))
    settings = rig(loop={"rate_hz": rate_hz}, estimator={"quiet_disturbance_walk_mm_s": 3.0, **swing})
    model, plant = filter_model(settings), member(settings, k_m)
    gains = filter_gains(model)
    loop = closed_loop(plant, controller(model, design(settings), level * gains[OPEN] + (1.0 - level) * gains[QUIET]))
    for channel in range(3):
        expected = _impulse_of_the_model(loop, channel, 500)
        real = _impulse_of_the_objects(settings, plant, channel, 500)
        # The two Riccati solutions agree to 1e-8; rounding beside 300 N.
        assert np.allclose(real, expected, rtol=0.0, atol=1e-5 * np.abs(expected).max(axis=0))


@pytest.mark.parametrize("swing", [{}, SWING])
@pytest.mark.parametrize("delay_s", [0.0, 0.002, 0.02])
def test_response_equals_the_state_space(rig: Rig, delay_s: float, swing: dict[str, Any]) -> None:
    settings = rig(plant={"command_delay_s": delay_s}, estimator=swing)
    model = filter_model(settings)
    law = controller(model, design(settings), filter_gain(model))
    z = np.exp(2j * np.pi * np.array([0.1, 3.0, 40.0, 500.0]) * model.period_s)
    for at, column in zip(z, law.response(z).T, strict=True):
        assert np.allclose(column, law.c @ np.linalg.solve(at * np.eye(len(law.a)) - law.a, law.b), rtol=1e-8)
