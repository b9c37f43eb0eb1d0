"""The plan's answers, found by impulses through the loop's code, against the linear system behind the margins."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.excitation.probe_plan import MECHANISM_SCALES, MECHANISMS_N_MM, STIFFNESS_SCALES, ProbePlan, plan
from rigctl.control.law.estimator import filter_model
from rigctl.design.closed_loop import controller
from rigctl.design.gains import OPEN, design, filter_gains
from rigctl.design.plant_family import member
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
FLEXIBLE = changed(PAPER, {"plant.mechanism_n_mm": 60.0})
Complex = npt.NDArray[np.complex128]


def tension_per_probe(settings: RigSettings, planned: ProbePlan, k_m: float | None, scale: float = 1.0) -> Complex:
    """Tension at its SYNC per speed that is added to the command, at each line."""
    model, z = filter_model(settings), np.exp(2j * np.pi * np.array(planned.lines) / planned.shape.ticks)
    by_tension, by_speed = controller(model, design(settings), filter_gains(model)[OPEN]).response(z)
    tension, speed, _ = member(settings, k_m, scale).response(z)
    return np.asarray(tension / (1.0 - by_tension * tension - by_speed * speed))


@pytest.mark.parametrize("settings", [PAPER, FLEXIBLE])
def test_the_answers_are_those_of_the_closed_loop_to_the_multisine_on_the_command(settings: RigSettings) -> None:
    planned = plan(settings, design(settings))
    ticks, stroke_mm = planned.shape.ticks, np.array(planned.shape.stroke_mm)
    speeds = planned.level * settings.loop.rate_hz * (np.roll(stroke_mm, -1) - stroke_mm)  # of each tick, periodic
    probe = 2.0 * np.fft.fft(speeds)[list(planned.lines)] / ticks
    late = np.exp(-2j * np.pi * np.array(planned.lines) / ticks)  # a tick reads what the SYNC before has latched
    expected = tension_per_probe(settings, planned, settings.plant.mechanism_n_mm) * probe * late
    # What is left is the end of the impulses, after 3 s.
    np.testing.assert_allclose(np.array(planned.answers), expected, rtol=5e-3)


@pytest.mark.parametrize("settings", [PAPER, FLEXIBLE])
def test_the_least_answer_is_that_of_the_worst_plant_of_the_family(settings: RigSettings) -> None:
    own = settings.plant.mechanism_n_mm
    softer = MECHANISMS_N_MM if own is None else [scale * own for scale in MECHANISM_SCALES]
    family = [(k_m, 1.0) for k_m in softer] + [(own, scale) for scale in STIFFNESS_SCALES]
    planned = plan(settings, design(settings))
    answers, weights = np.array(planned.answers), np.array(planned.weights).conj()
    per_own = answers / tension_per_probe(settings, planned, own)
    shares = [(tension_per_probe(settings, planned, *plant) * per_own @ weights).real for plant in family]
    assert planned.least == pytest.approx(min(shares) / (answers @ weights).real, rel=5e-3)
