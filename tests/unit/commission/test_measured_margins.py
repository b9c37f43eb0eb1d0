"""Ms from a response taken in a loop whose sensitivities are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rigctl.commission import response_entry
from rigctl.commission.frequency_response import spectra
from rigctl.commission.measured_margins import Controller, MeasuredMargins, measure
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.multisine import Band, multisine
from rigctl.control.law.estimator import filter_model
from rigctl.design.closed_loop import controller
from rigctl.design.gains import design, filter_gain
from tests.builders.linear_plant import Array, ComplexArray, TruePlant, true_sensitivities
from tests.builders.synthetic_response import PLANT, TICK_S, amplitudes, open_loop, records
from tests.unit.conftest import Rig

FINE_HZ = np.geomspace(0.05, 499.0, 6000)


def law(settings: RigSettings) -> Controller:
    model = filter_model(settings)
    made = controller(model, design(settings), filter_gain(model))

    def response(hz: Array) -> tuple[ComplexArray, ComplexArray]:
        per_tension, per_speed = made.response(np.exp(2j * np.pi * hz * TICK_S))
        return per_tension, per_speed

    return response


def truth(plant: TruePlant, acting: Controller) -> Array:
    return np.asarray(np.abs(true_sensitivities(plant, *acting(FINE_HZ), FINE_HZ)).max(axis=1), np.float64)


def measured(
    settings: RigSettings,
    plant: TruePlant,
    acting: Controller,
    believed: Controller,
    *,
    speed_mm_s: float = 3.0,
    seed: int = 1,
) -> MeasuredMargins:
    """``acting``: the controller in the loop; ``believed``: the one the evaluation is told of."""

    def loop(hz: Array) -> ComplexArray:
        per_tension, per_speed = acting(hz)
        closed = true_sensitivities(plant, per_tension, per_speed, hz)[0]
        return np.stack([closed, per_tension * closed])

    found = amplitudes(records(plant, sensitivity=loop, speed_mm_s=speed_mm_s, seed=seed))
    return measure(found, settings.plant, believed)


PLANTS = [
    PLANT,
    replace(PLANT, lag=0.026, delay=0.004),
    replace(PLANT, mechanism=60.0),
    replace(PLANT, stiffness=34.0),
    replace(PLANT, stiffness=34.0, mechanism=6.0),
]


@pytest.mark.parametrize("plant", PLANTS)
def test_ms_is_the_true_one_within_its_interval(rig: Rig, plant: TruePlant) -> None:
    settings = rig(plant={"spring_n_mm": 6.0 if plant.stiffness == 6.0 else 34.0})
    acting = law(settings)
    found, true = measured(settings, plant, acting, acting), truth(plant, acting)
    assert abs(found.ms_input.value - true[0]) <= 1.5 * found.ms_input.error + 0.003
    assert abs(found.ms_output.value - true[1]) <= 1.5 * found.ms_output.error + 0.003
    assert 0.0 < found.ms.error < 0.05
    assert found.ms.value == max(found.ms_input.value, found.ms_output.value)
    assert found.measured


def test_the_intervals_hold_the_truth_where_the_excitation_is_weak(rig: Rig) -> None:
    settings = rig()
    acting = law(settings)
    true = truth(PLANT, acting)
    found = [measured(settings, PLANT, acting, acting, speed_mm_s=0.7, seed=seed).ms_input for seed in range(8)]
    assert sum(abs(each.value - true[0]) <= each.error for each in found) >= 6
    assert max(abs(each.value - true[0]) for each in found) < 0.1


def test_a_controller_that_is_not_the_one_believed_is_seen_all_the_same(rig: Rig) -> None:
    """The law in the loop acts half as hard, or as on a spring of 9 N/mm: what is measured corrects the model."""
    settings = rig()
    believed = law(settings)
    stiffer = law(rig(plant={"spring_n_mm": 4.0}))

    def softer(hz: Array) -> tuple[ComplexArray, ComplexArray]:
        per_tension, per_speed = believed(hz)
        return 0.5 * per_tension, 0.5 * per_speed

    for acting in (softer, stiffer):
        true = truth(PLANT, acting)[0]
        assert abs(true - truth(PLANT, believed)[0]) > 0.08
        assert measured(settings, PLANT, acting, believed).ms_input.value == pytest.approx(true, abs=0.06)


def test_from_a_response_in_hold_it_is_predicted(rig: Rig) -> None:
    settings = rig()
    acting = law(settings)
    found = measure(amplitudes(records(sensitivity=open_loop)), settings.plant, acting, measured=False)
    true = truth(PLANT, acting)
    assert found.ms_input.value == pytest.approx(true[0], abs=0.02)
    assert found.ms_output.value == pytest.approx(true[1], abs=0.02)
    assert not found.measured


def test_the_curves_are_those_of_the_loop(rig: Rig) -> None:
    settings = rig()
    acting = law(settings)
    curves = measured(settings, PLANT, acting, acting).curves
    true = true_sensitivities(PLANT, *acting(curves.frequencies_hz), curves.frequencies_hz)
    assert np.abs(curves.at_input - true[0]).max() < 0.03
    assert np.abs(curves.at_output - true[1]).max() < 0.03
    assert curves.loop == pytest.approx(1.0 / curves.at_input - 1.0)
    assert curves.peaks == (np.abs(curves.at_input).max(), np.abs(curves.at_output).max())


def test_a_peak_beyond_the_excitation_is_continued_by_the_plant_found_and_said_to_be(rig: Rig) -> None:
    """A loss of 0.05 N s/mm is 25 N/mm at 80 Hz beside a spring of 6: the sensitivity rises far above the band."""
    settings = rig(design={"stretch_weight": 3000.0}, estimator={"tension_walk_n": 0.3})
    acting = law(settings)
    signal = multisine(Band(4.0, 0.75, 37.0, 1.25), round(1.0 / TICK_S), 0.02, 0.5, 0.45)

    def loop(hz: Array) -> ComplexArray:
        per_tension, per_speed = acting(hz)
        closed = true_sensitivities(PLANT, per_tension, per_speed, hz)[0]
        return np.stack([closed, per_tension * closed])

    taken = records(sensitivity=loop, speed_mm_s=3.0, signal=signal)
    found = measure(spectra(taken, signal.harmonics, signal.ticks, TICK_S), settings.plant, acting)
    signal_hz = signal.harmonics[-1] * TICK_S**-1 / signal.ticks
    sensitivities = np.abs(true_sensitivities(PLANT, *acting(FINE_HZ), FINE_HZ))
    true, at_hz = sensitivities.max(), FINE_HZ[np.argmax(sensitivities.max(axis=0))]
    assert at_hz > 1.5 * signal_hz
    assert sensitivities[:, signal_hz > FINE_HZ].max() < true - 0.2
    assert found.beyond
    assert found.ms.value == pytest.approx(true, rel=0.1)
    said = response_entry.in_words(found)
    assert f"Ms at least {found.at_least:.3f} measured up to 31 Hz" in said
    assert 1.0 < found.at_least <= sensitivities[:, signal_hz >= FINE_HZ].max() + 0.01
    assert "as plant found and controller continue it" in said
