"""The sampled plants are the P(s) of the domain notes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.design.gains import design
from rigctl.design.margins import judge
from rigctl.design.plant_family import LOSS_SCALE, MECHANISM_DAMPING, Array, Family, family, member, of_values, sampled

Rig = Callable[..., RigSettings]


def filtered(corner_hz: float | None) -> dict[str, Any]:
    """Sections of a rig whose cell has this low-pass."""
    return {"tension_cell": {"filter_hz": corner_hz}, "simulation": {"cell": {"filter_hz": corner_hz}}}


@pytest.mark.parametrize("k_m", [None, 1000.0, 60.0, 6.0, 2.0])
@pytest.mark.parametrize("delay_scale", [1, 2])
def test_response_is_the_small_signal_plant(rig: Rig, k_m: float | None, delay_scale: int) -> None:
    settings = rig(loop={"rate_hz": 4000}, **filtered(None))
    dt, hz = 1.0 / 4000, np.array([0.1, 1.0, 3.0, 7.5, 20.0])
    s, k, m = 2j * np.pi * hz, settings.plant.stiffness_n_mm * 1.2, 0.030  # 30 kg is 0.03 N s^2/mm
    flexible = 1.0 if k_m is None else 0.0
    if k_m is not None:
        own = m * s**2 + 2 * MECHANISM_DAMPING * np.sqrt(k_m * m) * s + k_m
        flexible = own / (own + k)
    top = k / s * flexible
    delay = np.exp(-s * (delay_scale * 0.002 + dt / 2))  # the held command adds half a period of delay
    tension, speed, disturbance = member(settings, k_m, 1.2, delay_scale).response(np.exp(s * dt))
    # The remaining difference is of the order (omega dt)^2 = 1e-3 at 20 Hz.
    assert np.allclose(tension, top * delay / (0.02 * s + 1), rtol=2e-3)
    assert np.allclose(speed, delay / (0.02 * s + 1), rtol=2e-3)
    assert np.allclose(disturbance, top * np.exp(-s * dt / 2), rtol=2e-3)


def test_rigid_member_is_the_model_the_filter_believes_in(rig: Rig) -> None:
    settings = rig(**filtered(None))
    model, plant = filter_model(settings), member(settings, None)
    assert np.allclose(plant.a, model.f[:2, :2], rtol=1e-12)
    assert np.allclose(plant.b_command, model.b[:2, 0], rtol=1e-12)
    assert np.allclose(plant.b_disturbance, model.f[:2, 2], rtol=1e-12)
    assert plant.delay_ticks == model.delay_ticks


def test_family_has_every_combination_and_the_mechanism_in_the_file(rig: Rig) -> None:
    assert len({(p.k_m, p.k_scale, p.delay_scale) for p in family(rig())}) == 5 * 3 * 2
    own = family(rig(plant={"mechanism_n_mm": 45.0}))
    assert len(own) == 6 * 3 * 2
    assert 45.0 in {plant.k_m for plant in own}


def test_mechanism_resonates_where_the_domain_notes_say(rig: Rig) -> None:
    assert member(rig(), 60.0).resonances_hz == pytest.approx((7.1, 7.5), abs=0.05)


@pytest.mark.parametrize(("spring", "rope"), [(6.0, 1000.0), (34.0, 1000.0), (100.0, 1000.0)])
def test_one_stiffness_and_one_loss_stand_for_the_chain_of_spring_and_rope(
    rig: Rig, spring: float, rope: float
) -> None:
    plant = rig(
        plant={"spring_n_mm": spring, "rope_n_mm": rope, "spring_damping_n_s_mm": 0.0042, "rope_damping_n_s_mm": 0.22}
    ).plant
    s = 2j * np.pi * np.geomspace(0.1, 300.0, 50)
    parts = [plant.spring_damping_n_s_mm * s + spring, plant.rope_damping_n_s_mm * s + rope]
    chain = parts[0] * parts[1] / (parts[0] + parts[1])
    one = plant.stiffness_n_mm + plant.damping_n_s_mm * s
    assert np.abs(np.abs(one / chain) - 1.0).max() < 0.01
    assert np.abs(np.degrees(np.angle(one / chain))).max() < 1.0


@pytest.mark.parametrize("spring_n_mm", [6.0, 13.0, 34.0])
def test_the_loss_that_the_assumed_family_leaves_out_lowers_ms(rig: Rig, spring_n_mm: float) -> None:
    """The bound: from none to `LOSS_SCALE` times a steel spring's, on every plant of the family, none is the worst."""
    ratio = 2.0 * 0.005 * np.sqrt(spring_n_mm * 0.030)  # half a percent of critical, 30 kg
    settings = rig(plant={"spring_n_mm": spring_n_mm, "spring_damping_n_s_mm": ratio, "rope_damping_n_s_mm": 0.22})
    gains = design(settings)
    peaks = []
    for scale in (0.0, 0.25, 0.5, 1.0, LOSS_SCALE):
        members = [
            sampled(
                settings, p.k_m, p.k_scale, p.lag_scale, p.delay_scale, p.delay_ticks,
                scale * p.k_scale * settings.plant.damping_n_s_mm,
            )
            for p in family(settings)
        ]  # fmt: skip
        peaks.append(judge(settings, gains, family=Family("with a loss", tuple(members))).ms_max)
    assert peaks[0] == judge(settings, gains).ms_max == max(peaks)


@pytest.mark.parametrize("cell_hz", [None, 500.0])
@pytest.mark.parametrize("k_m", [None, 60.0])
def test_a_loss_and_the_low_pass_of_the_cell_are_in_the_response(
    rig: Rig, k_m: float | None, cell_hz: float | None
) -> None:
    settings = rig(loop={"rate_hz": 4000}, **filtered(cell_hz))
    dt, hz = 1.0 / 4000, np.array([0.5, 3.0, 7.5, 20.0, 80.0])
    s, k, c, m = 2j * np.pi * hz, settings.plant.stiffness_n_mm, 0.05, 0.030
    stretch = k + c * s
    if k_m is not None:
        own = m * s**2 + 2 * MECHANISM_DAMPING * np.sqrt(k_m * m) * s + k_m
        stretch = stretch * own / (own + stretch)
    late = np.exp(-s * (0.002 + dt / 2)) / (0.02 * s + 1)
    seen = 1.0 if cell_hz is None else 1.0 / (s / (2 * np.pi * cell_hz) + 1.0)
    tension, _, disturbance = sampled(settings, k_m, 1.0, 1.0, 1.0, 8.0, c).response(np.exp(s * dt))
    assert np.allclose(tension, stretch / s * late * seen, rtol=1e-2)
    held = np.exp(-s * dt / 2) * np.sinc(hz * dt)
    assert np.allclose(disturbance[:-1], (stretch / s * held)[:-1], rtol=2e-2)  # its own loss acts at once, not held


@pytest.mark.parametrize("delay_ticks", [2.0, 2.3])
@pytest.mark.parametrize("cell_hz", [None, 500.0])
@pytest.mark.parametrize("k_m", [None, 20.0])
def test_a_member_is_the_integral_of_its_equations(
    k_m: float | None, cell_hz: float | None, delay_ticks: float
) -> None:
    """Held random inputs, integrated tick by tick from the equations of the module's docstring."""
    k, c, lag, dt, mass, ratio = 6.0, 0.05, 0.02, 1e-3, 0.030, 0.02
    plant = of_values(
        k, c, lag, delay_ticks, dt, k_m=k_m, payload_kg=1e3 * mass, mechanism_damping=ratio, cell_hz=cell_hz
    )
    ticks, whole, part = 40, math.floor(delay_ticks), delay_ticks % 1.0
    chance = np.random.default_rng(7)
    sent, disturbed = np.zeros(ticks + 3), chance.standard_normal(ticks)
    sent[3:] = chance.standard_normal(ticks)  # sent[3 + n] is the command of tick n

    def tension_n(state: Array, w: float) -> float:
        x, v, _, moving, _ = state
        return float(k * x + c * (v + w - moving))

    def rates(_t: float, state: Array, u: float, w: float) -> list[float]:
        _, v, p, moving, y = state
        pull = tension_n(state, w)
        own = 0.0 if k_m is None else (pull - 2.0 * ratio * math.sqrt(k_m * mass) * moving - k_m * p) / mass
        seen = 0.0 if cell_hz is None else 2.0 * math.pi * cell_hz * (pull - y)
        return [v + w - moving, (u - v) / lag, moving, own, seen]

    state, model = np.zeros(5), np.zeros(len(plant.a))
    for n, w in enumerate(disturbed.tolist()):
        measured = state[4] if cell_hz is not None else tension_n(state, w)
        assert model[0] + plant.sensed_n_s_mm * w == pytest.approx(measured, rel=1e-9, abs=1e-10)
        assert model[1] == pytest.approx(state[1], rel=1e-9, abs=1e-10)
        assert plant.tension @ model + plant.loss_n_s_mm * w == pytest.approx(tension_n(state, w), rel=1e-9, abs=1e-10)
        model = plant.a @ model + plant.b_command * sent[3 + n - plant.delay_ticks] + plant.b_disturbance * w
        for acting, seconds in ((sent[2 + n - whole], part * dt), (sent[3 + n - whole], (1.0 - part) * dt)):
            if seconds > 0.0:
                solved = solve_ivp(rates, (0.0, seconds), state, "DOP853", args=(acting, w), rtol=1e-12, atol=1e-14)
                state = solved.y[:, -1]
