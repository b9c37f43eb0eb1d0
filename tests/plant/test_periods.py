"""Small oscillations against closed forms, and against the figures of domain.md."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.plant import Plant
from hil.plant.layout import FLOOR_VERTICAL, FORCE_VERTICAL
from tests.plant.bench import GRAVITY, LOSSLESS, K, build, constant, loaded, look, tone

LOCKED = {"friction_static": 1.0, "friction_dynamic": 1.0}
FIXED_PULLEY = {"rail": LOCKED, "pulley": LOCKED}
HARDLY = 1e-6  # N/mm: a mechanism too soft to matter


def period(plant: Plant, signal: Callable[[], float], cycles: int, expected_s: float) -> float:
    """Mean over ``cycles``, from upward crossings of the mean of the signal, interpolated linearly."""
    every_ns = max(100_000, round(expected_s / 400 * 1e9) // 100_000 * 100_000)
    values = []
    for _ in range(round((cycles + 1.2) * expected_s * 1e9 / every_ns)):
        plant.advance(plant.t_ns + every_ns)
        values.append(signal())
    swing = np.array(values) - 0.5 * (max(values) + min(values))
    up = np.flatnonzero((swing[:-1] < 0.0) & (swing[1:] >= 0.0))
    crossings = up - swing[up] / (swing[up + 1] - swing[up])
    assert len(crossings) > cycles
    return float((crossings[cycles] - crossings[0]) * every_ns * 1e-9 / cycles)


def _height(plant: Plant) -> Callable[[], float]:
    return lambda: float(plant.state[0]["uz"])


def hung(plant: Plant, weight_n: float) -> Plant:
    """The rope alone carries the payload, which weighs this much."""
    p, x = plant.parameters[0], plant.state[0]
    x["motor"] = x["motor_before"] = x["stroke"] = weight_n / p["stiffness"] + p["free_length"] - p["rope_length"]
    x["tension"] = weight_n
    plant.start_motion({FORCE_VERTICAL: constant(-weight_n)}, 0)
    return plant


@pytest.mark.parametrize(("axis", "coordinate"), [("tangential", "ut"), ("normal", "un")])
def test_a_free_payload_swings_as_a_pendulum_of_the_ropes_length(axis: str, coordinate: str) -> None:
    weight = 30.0 * GRAVITY
    plant = loaded(LOSSLESS, FIXED_PULLEY, {"mechanism": {f"{axis}_n_mm": HARDLY}}, tension=weight)
    plant.state[0][coordinate] = 1.0
    found = period(plant, lambda: float(plant.state[0][coordinate]), 5, 2.69)
    # the spring of 1e-6 N/mm adds 6e-6 to the stiffness; amplitude 1 mm of 1800 adds less
    assert found == pytest.approx(2.0 * math.pi * math.sqrt(1.8 / GRAVITY), rel=2e-5)
    assert found == pytest.approx(2.69, abs=0.005)


def test_carried_by_the_mechanism_it_swings_by_tension_over_length() -> None:
    plant = loaded(LOSSLESS, FIXED_PULLEY, {"mechanism": {"tangential_n_mm": 0.5}}, tension=150.0)
    plant.state[0]["ut"] = 1.0
    expected = 2.0 * math.pi * math.sqrt(30.0 / (150.0 / 1.8 + 500.0))
    assert period(plant, lambda: float(plant.state[0]["ut"]), 5, expected) == pytest.approx(expected, rel=2e-5)


@pytest.mark.parametrize(
    ("stiffness", "hertz"), [(6.0, 2.25), (13.0, 3.31), (20.0, 4.11), (27.0, 4.77), (34.0, 5.36), (1000.0, 29.1)]
)
def test_a_free_payload_bounces_on_spring_and_rope(stiffness: float, hertz: float) -> None:
    plant = build(
        LOSSLESS,
        {"mechanism": {"vertical_n_mm": HARDLY}},
        plant={"spring_n_mm": None, "rope_n_mm": stiffness},
    )
    hung(plant, 30.0 * GRAVITY).state[0]["uz"] = 0.1
    expected = math.sqrt(stiffness * 1e3 / 30.0) / (2.0 * math.pi)
    found = 1.0 / period(plant, lambda: float(plant.state[0]["uz"]), 5, 1.0 / expected)
    assert found == pytest.approx(expected, rel=5e-5)  # (omega h)^2 / 24 is 1.4e-5 at 29 Hz and 100 us
    assert found == pytest.approx(hertz, abs=0.05)


@pytest.mark.parametrize(("mass", "seconds"), [(10.0, 1.54), (30.0, 2.67)])
def test_the_arm_swings_against_the_rope(mass: float, seconds: float) -> None:
    plant = loaded(LOSSLESS, {"rail": {"mass_kg": mass - 2.0}, "pulley": {"mass_kg": 2.0}})
    plant.state[0]["phi"] = 1e-3
    found = period(plant, lambda: float(plant.state[0]["phi"]), 5, seconds)
    # the rope's stretch at 0.75 mm of offset adds 1e-6
    assert found == pytest.approx(2.0 * math.pi * math.sqrt(mass / (300.0 / 1.8)), rel=1e-5)
    assert found == pytest.approx(seconds, abs=0.006)


def test_mechanism_and_rope_resonate_together_and_the_mechanism_alone_when_slack() -> None:
    compliant = {"mechanism": {"vertical_n_mm": 60.0}}
    for plant, stiffness, hertz in ((loaded(LOSSLESS, compliant), 60.0 + K, 7.5), (build(compliant), 60.0, 7.1)):
        plant.parameters["vertical_damping"] = 0.0
        plant.state[0]["uz"] += 0.1
        found = 1.0 / period(plant, _height(plant), 5, 1.0 / hertz)
        assert found == pytest.approx(math.sqrt(stiffness * 1e3 / 30.0) / (2.0 * math.pi), rel=2e-5)
        assert found == pytest.approx(hertz, abs=0.05)


@pytest.mark.parametrize("hertz", [3.0, 7.118, 7.464, 15.0])
def test_a_vertical_shake_reaches_the_tension_as_the_small_signal_plant_says(hertz: float) -> None:
    """k (m s^2 + c s + K_m) / (m s^2 + c s + K_m + k): next to nothing at the anti-resonance, most at the resonance."""
    plant = loaded({"rope": {"damping_n_s_mm": 0.0}, "mechanism": {"vertical_n_mm": 60.0}})
    plant.start_motion({FLOOR_VERTICAL: tone(0.05, hertz)}, 0)
    plant.advance(8_000_000_000)  # 2 % damping: e^-7 of the start is left
    start_ns = plant.t_ns
    samples = [(truth.t_ns * 1e-9, truth.tension_n) for truth in look(plant, start_ns * 1e-9 + 10.0 / hertz)]
    t, tension = np.array(samples).T
    omega = 2.0 * math.pi * hertz
    basis = np.stack([np.ones_like(t), np.sin(omega * t), np.cos(omega * t)])
    _, in_phase, quadrature = np.linalg.lstsq(basis.T, tension, rcond=None)[0]
    c = 2.0 * 0.02 * math.sqrt(60e3 * 30.0)
    mechanism = 60e3 - 30.0 * omega**2 + 1j * c * omega
    expected = 0.05 * K * abs(mechanism / (mechanism + K * 1e3))
    assert math.hypot(in_phase, quadrature) == pytest.approx(expected, rel=0.01)  # what is left of the start


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_a_flexible_rope_vibrates_as_a_lumped_chain(mode: int) -> None:
    elements, mass = 8, 0.5
    plant = loaded(LOSSLESS, FIXED_PULLEY, {"rope": {"mass_kg": mass, "elements": elements}})
    at = np.arange(1, elements) / elements
    plant.nodes[:, 1] += 0.1 * np.sin(mode * math.pi * at)
    wave = math.sqrt(300.0 * 1.8 / mass) / 1.8  # 1/s: sqrt(T / mu) / L
    expected = 2.0 * elements * wave * math.sin(mode * math.pi / (2 * elements)) / (2.0 * math.pi)
    found = 1.0 / period(plant, lambda: float(plant.nodes[0, 1]), 5, 1.0 / expected)
    assert found == pytest.approx(expected, rel=1e-4)  # (omega h)^2 / 24 is 1e-5, the sampling as much
    assert found == pytest.approx(0.5 * mode * wave, rel=(mode * math.pi / (2 * elements)) ** 2 / 5.0)  # a string


def test_a_flexible_rope_carries_as_much_of_its_mass_vertically_as_a_straight_one() -> None:
    found = []
    for elements in (1, 16):
        rope = {"rope": {"mass_kg": 3.0, "elements": elements}, "mechanism": {"vertical_n_mm": 60.0}, "step_us": 50}
        plant = loaded(LOSSLESS, FIXED_PULLEY, rope)
        plant.state[0]["uz"] += 0.1
        found.append(1.0 / period(plant, _height(plant), 5, 1.0 / 7.4))
    expected = math.sqrt((60.0 + K) * 1e3 / 31.0) / (2.0 * math.pi)  # a third of it
    assert found == pytest.approx([expected, expected], rel=1e-4)  # lumped: 1 / (6 N^2) of 3 kg more
