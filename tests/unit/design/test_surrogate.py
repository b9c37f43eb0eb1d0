"""The law in real ticks about the linear plant: what one sample of noise does to the tension."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.config.changed_settings import changed
from rigctl.design import plant_family, surrogate
from rigctl.design.gains import design
from rigctl.design.knobs import KNOBS
from tests.builders.rig_bench import SETTINGS


@pytest.mark.parametrize("values", [(23.3, 164.0, 14.0, 0.419, 0.0435), (448.0, 1.75e7, 0.111, 0.284, 0.0292)])
def test_one_sample_beyond_the_gate_moves_the_tension_by_less_than_the_noise_does(values: tuple[float, ...]) -> None:
    """A filter that believes it is surprised by the next one too, the other way: 0.15 and 1.3 N with these weights."""
    settings = changed(SETTINGS, {knob.key: value for knob, value in zip(KNOBS, values, strict=True)})
    law, plant = surrogate.OurLaw(settings, design(settings)), plant_family.nominal(settings)
    noise = (settings.tension_cell.noise_n * np.random.default_rng(3).standard_normal(2000)).tolist()
    beyond = [*noise[:1000], 0.3, *noise[1001:]]
    usual, moved = (surrogate._run(law, plant, np.zeros(2000), cell, 300.0)[0] for cell in (noise, beyond))
    assert np.abs(moved - usual).max() < 0.005
