"""The weights of the shipped rig file: what they are held to beside their own spring, and what a search finds for it.

One file serves every spring and rate that its documentation names, so that its weights are not those of
`rigctl tune --optimize`, which looks at one plant. The search here has the cost of that command, and as limits what the
file is promised to keep elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import LearningSettings, RigSettings
from rigctl.control.law.estimator import filter_model
from rigctl.design import optimise, plant_family
from rigctl.design.closed_loop import controller
from rigctl.design.gains import design, filter_gain
from rigctl.design.knobs import knobs_for, turned, value_of
from rigctl.design.learning_margin import learning_margin
from rigctl.design.linear_errors import LinearCases
from rigctl.design.plant_family import Family
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
STIFF = {"plant.spring_n_mm": 34.0}
PROMISED = (
    {"plant.spring_n_mm": 13.0},
    STIFF,
    {"loop.rate_hz": 200, "estimator.tension_walk_n": 30.0},
    {"loop.rate_hz": 100, "estimator.tension_walk_n": 30.0},
)
"""Values that the documentation names; with each of them Ms is within the file's limit."""
LEARNING = LearningSettings(move_s=20.0, cutoff_hz=2.0, rate=0.5)
LEARNS = 0.95
"""Largest factor from move to move with the learning of docs/rig-file.md, also on the stiffest spring."""
EVALUATIONS, SEED = 500, 2
WORSE = math.log(1.10)
"""By how much the largest error of the weights may be above that of the search's: seeds differ by 5 %."""


def peak(settings: RigSettings, family: Family) -> float:
    found = optimise.our_design(settings, family)
    return math.inf if found is None else found.ms


def factor(settings: RigSettings, family: Family) -> float:
    """Of the errors from move to move."""
    there = changed(settings, {"learning": LEARNING})
    model, gains = filter_model(there), design(there)
    law = controller(model, gains, filter_gain(model))
    return learning_margin(there, gains, law, None, list(family.members)).factor


def beyond(settings: RigSettings, families: Sequence[Family]) -> float:
    """By how much the promises are not kept; 0 where they are."""
    peaks = [peak(changed(settings, values), family) for values, family in zip(PROMISED, families, strict=True)]
    learned = factor(changed(settings, STIFF), families[PROMISED.index(STIFF)])
    return max(0.0, max(peaks) - settings.design.ms_max, learned - LEARNS)


def test_the_weights_keep_what_is_promised_and_a_search_within_it_finds_little_more() -> None:
    families = [plant_family.assumed(changed(PAPER, values)) for values in PROMISED]
    own, cases, limits, knobs = (
        plant_family.assumed(PAPER),
        LinearCases(PAPER),
        optimise.Limits.of(PAPER),
        knobs_for(PAPER),
    )
    assert beyond(PAPER, families) == 0.0

    def cost(values: Sequence[float]) -> float:
        there = turned(PAPER, knobs, values)
        found = optimise.score(there, optimise.our_design(there, own, knobs), limits, cases)
        if not found.within:
            return found.cost
        over = beyond(there, families)
        return found.cost + (optimise.BROKEN * (1.0 + min(over, 1.0)) if over > 0.0 else 0.0)

    start = [float(value_of(PAPER, knob.key)) for knob in knobs]
    best, _ = optimise.minimum(cost, knobs, start, seed=SEED, evaluations=EVALUATIONS)
    assert cost(start) <= cost(best) + WORSE, dict(zip((knob.key for knob in knobs), best, strict=True))
