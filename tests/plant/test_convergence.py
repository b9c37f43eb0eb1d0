"""Halving the step: a quarter of the error in smooth motion, at most half with friction."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from hil.plant import Plant
from hil.plant.layout import FLOOR_RADIAL, FLOOR_VERTICAL, FORCE_TANGENTIAL, HEIGHT, MECHANISM, STATE
from hil.plant.moves import out_and_back
from hil.truth import Truth
from tests.plant.bench import MS, NO_FRICTION, SETTINGS, S, loaded, ramp, tone

COMPLIANT = {"mechanism": {"tangential_n_mm": 20.0, "normal_n_mm": 30.0, "vertical_n_mm": 60.0}}
DAMPED = {
    "rail": NO_FRICTION | {"viscous_n_s_m": 50.0, "slope_mm_m": 10.0, "eccentricity_normal_mm": 20.0},
    "pulley": NO_FRICTION | {"viscous_n_s_m": 5.0},
    "rope": {"damping_n_s_mm": 0.2, "mass_kg": 0.4},
}
FLEXIBLE = {"rope": {"elements": 4, "node_damping_n_s_m": 0.5}}
STEPS_US = (400, 200, 100, 50)
REFERENCE_US = 10


def moved(step_us: int, *sections: dict[str, Any], seconds: float, rough: bool = False) -> np.ndarray[Any, Any]:
    """Place and speed after a motion with everything in it."""
    plant = loaded(*sections, {"step_us": step_us})
    tracks = {
        MECHANISM: ramp(0.02) if rough else tone(0.05, 0.5),
        HEIGHT: tone(1.0, 2.0),
        FLOOR_VERTICAL: tone(0.5, 3.0, 0.3),
    }
    if not rough:
        tracks |= {FLOOR_RADIAL: tone(2.0, 1.5), FORCE_TANGENTIAL: tone(5.0, 1.0)}
    plant.start_motion(tracks, 0)
    plant.advance(round(seconds * S))
    found = [plant.state[0][name] for name in (STATE.names or ())[:10]]
    return np.array([*found, *plant.nodes[:, 1]]) * ([750.0] + [1.0] * 4 + [750.0] + [1.0] * (4 + len(plant.nodes)))


@pytest.mark.parametrize("sections", [[DAMPED], [DAMPED, COMPLIANT], [DAMPED, COMPLIANT, FLEXIBLE]])
def test_smooth_motion_is_integrated_to_second_order(sections: list[dict[str, Any]]) -> None:
    exact = moved(REFERENCE_US, *sections, seconds=1.0)
    errors = [np.linalg.norm(moved(step, *sections, seconds=1.0) - exact) for step in STEPS_US]
    for coarse, fine in itertools.pairwise(errors):
        assert 3.7 < coarse / fine < 4.4  # 4 (1 - (10/50)^2) / ... at the finest: the reference has an error as well


def test_with_friction_the_error_still_falls_with_the_step() -> None:
    exact = moved(REFERENCE_US, seconds=4.0, rough=True)
    errors = [np.linalg.norm(moved(step, seconds=4.0, rough=True) - exact) for step in STEPS_US]
    assert errors[0] / errors[-1] > 0.8 * STEPS_US[0] / STEPS_US[-1]  # first order: the break-away falls into a step
    assert errors[-1] < 1e-2  # mm and mm/s


@given(st.lists(st.integers(1, 3_000_000), max_size=60))
@hypothesis_settings(max_examples=50, deadline=None)
def test_how_advance_is_chopped_up_changes_nothing(chops: list[int]) -> None:
    def run(stops: list[int]) -> Truth:
        plant = Plant(SETTINGS, 0)
        plant.set_drive(20.0, braked=False)
        for stop in sorted({*stops, 200 * MS}):
            if stop > 200 * MS:
                break
            plant.advance(stop)
        plant.start_motion({MECHANISM: out_and_back(0.05, 0.2, 2.0)}, plant.t_ns)
        plant.set_drive(-3.0, braked=False)
        for stop in stops:
            plant.advance(200 * MS + stop)
        plant.advance(400 * MS)
        return plant.truth

    assert run(list(itertools.accumulate(chops))) == run([])
