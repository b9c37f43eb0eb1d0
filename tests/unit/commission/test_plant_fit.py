"""Stiffness, drive and mechanism from a response whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rigctl.commission import plant_fit, response_entry
from rigctl.commission.frequency_response import plant_response
from rigctl.commission.identification import Estimated
from rigctl.commission.plant_fit import PlantFit, PlantModel
from tests.builders.linear_plant import TruePlant
from tests.builders.synthetic_response import PLANT, amplitudes, records
from tests.unit.conftest import Rig


def fitted(rig: Rig, plant: TruePlant, **options: float) -> PlantFit:
    return plant_fit.fit(plant_response(amplitudes(records(plant, **options))), rig().plant)  # type: ignore[arg-type]


def holds(found: Estimated | None, truth: float) -> bool:
    return found is not None and abs(found.value - truth) <= 1.5 * found.error  # of many figures some are outside 95 %


STIFF = replace(PLANT, stiffness=34.0)
PLANTS = [
    PLANT,
    STIFF,
    replace(PLANT, lag=0.03, delay=0.0052),
    replace(PLANT, lag=0.008, delay=0.0005, damping=0.02),
    replace(PLANT, mechanism=60.0),
    replace(PLANT, mechanism=6.0, payload_kg=36.0),
    replace(STIFF, mechanism=6.0),
    replace(STIFF, mechanism=20.0, mechanism_damping=0.05),
]


@pytest.mark.parametrize("plant", PLANTS)
def test_every_value_is_found_within_its_interval(rig: Rig, plant: TruePlant) -> None:
    found = fitted(rig, plant)
    assert holds(found.stiffness_n_mm, plant.stiffness)
    assert holds(found.damping_n_s_mm, plant.damping)
    assert holds(found.lag_s, plant.lag)
    assert holds(found.delay_s, plant.delay)
    assert holds(found.sensor_delay_s, 1.0 / (2.0 * 3.14159 * 500.0))
    assert holds(found.gain, 1.0)
    assert found.stiffness_n_mm.error < 0.02 * plant.stiffness
    assert found.lag_s.error < 0.02 * plant.lag
    assert found.delay_s.error < 0.3e-3
    assert found.misfit < 1.5
    if plant.mechanism is None:
        assert (found.mechanism_n_mm, found.mechanism_damping, found.payload_kg) == (None, None, None)
        assert found.model.resonances_hz == ()
    else:
        assert holds(found.mechanism_n_mm, plant.mechanism)
        assert holds(found.mechanism_damping, plant.mechanism_damping)
        assert holds(found.payload_kg, plant.payload_kg)
        assert found.mechanism_above is None
        assert found.model.resonances_hz[0] < found.model.resonances_hz[1]


@pytest.mark.parametrize("plant", [replace(PLANT, stiffness=1000.0), replace(PLANT, stiffness=200.0)])
def test_a_damping_that_is_small_against_the_stiffness_is_not_separable_from_the_cell_s_delay(
    rig: Rig, plant: TruePlant
) -> None:
    """Of the rope without a spring the delay had an uncertainty of 4 s, and its family delays of 8000 ticks."""
    found = fitted(rig, plant)
    assert found.damping_n_s_mm is None
    advance_s = (plant.damping - found.model.damping) / plant.stiffness
    late_s = 1.0 / (2.0 * np.pi * 500.0) - advance_s
    assert holds(found.sensor_delay_s, late_s), "what the tension is late by is known, not what of it"
    assert found.sensor_delay_s.error < 0.3e-3
    assert holds(found.stiffness_n_mm, plant.stiffness)
    assert response_entry.values(found)["damping_n_s_mm"] == pytest.approx(found.model.damping)


@pytest.mark.parametrize("noise_n", [0.01, 0.03, 0.1])
def test_of_a_rigid_mechanism_it_says_how_stiff_it_is_at_least(rig: Rig, noise_n: float) -> None:
    found = fitted(rig, PLANT, noise_n=noise_n)
    assert found.mechanism_n_mm is None
    assert found.mechanism_above is not None
    assert found.mechanism_above > 60.0


def test_what_it_says_of_a_stiff_mechanism_is_true(rig: Rig) -> None:
    """A resonance that hardly shows is either found or below what is excluded nothing is left out."""
    for seed in range(4):
        for k_m in (500.0, 3000.0, 20_000.0):
            found = fitted(rig, replace(PLANT, mechanism=k_m), seed=seed)
            if found.mechanism_n_mm is None:
                assert found.mechanism_above is None or found.mechanism_above < k_m
            else:
                assert abs(found.mechanism_n_mm.value - k_m) <= 2.0 * found.mechanism_n_mm.error


def test_a_fit_is_found_again_from_other_figures(rig: Rig) -> None:
    for plant in (PLANT, replace(PLANT, mechanism=60.0)):
        first = fitted(rig, plant)
        again = plant_fit.refit(plant_response(amplitudes(records(plant, seed=2))), first, rig().plant)
        assert again.stiffness == pytest.approx(plant.stiffness, rel=0.02)
        assert (again.mechanism is None) == (plant.mechanism is None)
        assert again.mechanism is None or again.mechanism == pytest.approx(60.0, rel=0.1)


def test_equations_that_do_not_hold_show_as_a_misfit(rig: Rig) -> None:
    bent = records(PLANT, noise_n=0.001)
    late = bent["tension_n"].copy()
    bent["tension_n"][40:] += 0.8 * (late[:-40] - 300.0)  # an echo
    found = plant_fit.fit(plant_response(amplitudes(bent)), rig().plant)
    assert found.misfit > 2.0
    assert found.stiffness_n_mm.error > 2.0 * fitted(rig, PLANT).stiffness_n_mm.error * found.stiffness_n_mm.value / 6.0


@pytest.mark.parametrize("k_m", [None, 60.0])
def test_what_is_fitted_is_the_designs_plant_over_the_excited_band(k_m: float | None) -> None:
    """To 60 Hz, the highest that is excited in full; the equations leave aliases out, the design's plant has them."""
    model = PlantModel(6.0, 0.05, 0.021, 0.0023, 0.0003, 1.0, k_m, 0.02, 30.0)
    hz = np.geomspace(0.25, 60.0, 60)
    tension, _, speed = model.responses(hz, 1e-3)
    exact = model.sampled(hz, 1e-3)
    for fitted, sampled in zip((tension, speed), exact, strict=True):
        ratio = fitted / sampled
        assert np.abs(np.abs(ratio) - 1.0).max() < 0.01
        assert np.abs(np.degrees(np.angle(ratio))).max() < 1.0
