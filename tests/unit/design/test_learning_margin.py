"""The check that learning converges: its response against the loop's own code, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from rigctl.config.settings import LearningSettings, RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.control.law.move_learning import learning_filter
from rigctl.design import plant_family
from rigctl.design.closed_loop import controller
from rigctl.design.gains import OPEN, QUIET, DesignError, design, filter_gain, filter_gains
from rigctl.design.learning_margin import LearningMargin, learning_margin, low_pass
from rigctl.design.margins import design_and_check
from rigctl.design.plant_family import Member
from tests.builders.rig_bench import SETTINGS, changed

LEARNING = LearningSettings(move_s=20.0, cutoff_hz=2.0, rate=0.5)


def margin(settings: RigSettings = SETTINGS, members: list[Member] | None = None, **section: float) -> LearningMargin:
    settings = settings.model_copy(update={"learning": LEARNING.model_copy(update=section)})
    gains, model = design(settings), filter_model(settings)
    law = controller(model, gains, filter_gain(model))
    return learning_margin(settings, gains, law, None, members or plant_family.family(settings))


def test_on_the_plant_of_the_file_one_move_takes_the_rate_away() -> None:
    own = [plant_family.member(SETTINGS, SETTINGS.plant.mechanism_n_mm)]
    assert margin(members=own, rate=1.0).factor < 0.02, "the learning law is the inverse of this loop"
    assert margin(members=own, rate=0.3).factor == pytest.approx(0.7, abs=0.005)


def test_the_family_bounds_the_cutoff() -> None:
    stiff = changed(SETTINGS, plant={"spring_n_mm": 34.0})
    assert margin(stiff).factor < 0.95
    found = margin(stiff, cutoff_hz=5.0)
    assert found.factor > 1.0
    assert (found.plant.k_m, found.plant.delay_scale) == (6.0, 2), "a soft mechanism turns the phase at its resonance"


def test_settings_that_do_not_converge_are_refused_in_one_line() -> None:
    stiff = changed(SETTINGS, plant={"spring_n_mm": 34.0})
    good = stiff.model_copy(update={"learning": LEARNING})
    assert design_and_check(good).accepted
    bad = stiff.model_copy(update={"learning": LEARNING.model_copy(update={"cutoff_hz": 5.0})})
    with pytest.raises(DesignError, match=r"^learning: \|Q \(1 - L P\)\| = 1\.\d\d at .* lower learning.cutoff_hz"):
        design_and_check(bad)


def test_every_level_of_the_filter_counts() -> None:
    settings = changed(SETTINGS, estimator={"quiet_disturbance_walk_mm_s": 3.0})
    settings = settings.model_copy(update={"learning": LEARNING})
    gains, model, own = design(settings), filter_model(settings), [plant_family.member(settings, 60.0)]
    of_setting = filter_gains(model)
    quiet, opened = (controller(model, gains, of_setting[name]) for name in (QUIET, OPEN))
    every = learning_margin(settings, gains, opened, quiet, own).factor
    blends = [of_setting[QUIET] + level * (of_setting[OPEN] - of_setting[QUIET]) for level in np.linspace(0.0, 1.0, 21)]
    singles = [learning_margin(settings, gains, controller(model, gains, one), None, own).factor for one in blends]
    assert every == pytest.approx(max(singles), rel=1e-3)


def test_the_low_pass_is_half_at_its_cutoff_and_has_no_phase() -> None:
    by = learning_filter(SETTINGS.model_copy(update={"learning": LEARNING}), design(SETTINGS))
    found = low_pass(by, np.array([0.01, 2.0, 8.0]))
    assert found == pytest.approx([1.0, 0.5, 0.0036], rel=0.05)
