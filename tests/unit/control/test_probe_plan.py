"""The plan's answers, found by impulses through the loop's code, against the linear system behind the margins."""

from __future__ import annotations

import numpy as np

from rigctl.config import rig_file as config
from rigctl.control.estimator import filter_model
from rigctl.control.probe_plan import plan
from rigctl.design.closed_loop import controller
from rigctl.design.gains import OPEN, design, filter_gains
from rigctl.design.plant_family import member
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")


def test_the_answers_are_those_of_the_closed_loop_to_the_multisine_on_the_command() -> None:
    gains, model, rate_hz = design(PAPER), filter_model(PAPER), PAPER.loop.rate_hz
    planned = plan(PAPER, gains)
    ticks, stroke_mm = planned.shape.ticks, np.array(planned.shape.stroke_mm)
    speeds = planned.level * rate_hz * (np.roll(stroke_mm, -1) - stroke_mm)  # of each tick, periodic
    probe = 2.0 * np.fft.fft(speeds)[list(planned.lines)] / ticks
    z = np.exp(2j * np.pi * np.array(planned.lines) / ticks)
    by_tension, by_speed = controller(model, gains, filter_gains(model)[OPEN]).response(z)
    tension, speed, _ = member(PAPER, PAPER.plant.mechanism_n_mm).response(z)
    expected = tension * probe / (1.0 - by_tension * tension - by_speed * speed)
    # A tick reads what the SYNC before has latched. What is left is the end of the impulses, after 3 s.
    np.testing.assert_allclose(np.array(planned.answers), expected / z, rtol=5e-3)
