"""A measured sensitivity is compared with that of the design's family."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rigctl.commission.frequency_response import plant_response
from rigctl.config import rig_file as config
from rigctl.control.law.tension import Gains
from rigctl.operations.evaluation import compared, law_response
from tests.builders.linear_plant import Array, ComplexArray, TruePlant, true_sensitivities
from tests.builders.paths import ROOT
from tests.builders.synthetic_response import PLANT, amplitudes
from tests.builders.synthetic_response import records as made_records

PAPER = config.load(ROOT / "config/paper_rig.yaml")
GAINS = {"k_tension": 1.33912, "k_speed": 0.148812, "k_integral": 1.02972}
USUAL = replace(PLANT, stiffness=PAPER.plant.stiffness_n_mm, damping=PAPER.plant.damping_n_s_mm)


@pytest.mark.parametrize(
    ("plant", "differs"),
    [
        (USUAL, False),
        (replace(USUAL, mechanism=60.0), False),
        (replace(USUAL, delay=0.012), True),
        (replace(USUAL, damping=0.08), True),
    ],
)
def test_a_loop_outside_of_the_designs_family_differs_from_it(plant: TruePlant, differs: bool) -> None:
    """The assumed family holds 2 and 4 ms of delay and any mechanism, but not 12 ms, nor eight times the loss."""
    gains = Gains(**GAINS)
    acting = law_response(PAPER, gains)

    def loop(hz: Array) -> ComplexArray:
        per_tension, per_speed = acting(hz)
        closed = true_sensitivities(plant, per_tension, per_speed, hz)[0]
        return np.stack([closed, per_tension * closed])

    found = compared(PAPER, gains, plant_response(amplitudes(made_records(plant, sensitivity=loop))))
    assert (found is not None) == differs
    if found is not None:
        assert found.measured - found.error > found.high
