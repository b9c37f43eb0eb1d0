"""Stated 95 % intervals hold the truth, on random rigs whose computer is busy, and are no wider than they need be.

Rigs are drawn from a seed and identified in lockstep, all by steps and a few by a frequency response in HOLD, while
pauses of 0.2 to 15 ms stop the loop. The truth is the simulated rig's, not the design's.
"""

from __future__ import annotations

import functools
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np

from rigctl.commission.identification import IdentificationError
from rigctl.config import rig_file as config
from rigctl.design.gains import design
from rigctl.devices.objects import MM_PER_POSITION_UNIT
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal
from rigctl.operations.evaluation import response
from tests.builders import daemons
from tests.builders.excited import built, respond, tensioned
from tests.builders.linear_plant import true_plant
from tests.builders.random_plants import STEP_US, RandomPlant, identified, pause, plants

SEED, RIGS, RESPONSES = 1, 48, 4
FIGURES = 200
GAP_S, RESPONSE_GAP_S = 1.5, 15.0  # mean time between two pauses
LEAST, WIDEST = 0.93, 1.5
FINEST = {"backlash": MM_PER_POSITION_UNIT}
"""What a figure is read from has steps, of which its interval is one at least."""


class Figure(NamedTuple):
    """One figure of one rig: how far it is from the truth, and the half width of its interval."""

    name: str
    off: float
    error: float


def by_steps(plant: RandomPlant) -> list[Figure]:
    """Nothing where the identification is refused."""
    result = identified(plant, GAP_S)
    stated = [name for name in result.rows if result.told(name)]
    return [Figure(name, result.off(name), float(result.rows[name]["error"])) for name in stated]


def by_response(plant: RandomPlant) -> list[Figure]:
    """The same of a frequency response."""
    settings = config.load(daemons.PAPER)
    filed, gains = settings.plant, design(settings)
    real = built(
        settings, stiffness=plant.stiffness, lag_scale=plant.lag / filed.cylinder_lag_s,
        delay_scale=plant.delay / filed.command_delay_s, seed=1 + plant.seed, step_us=STEP_US,
    )  # fmt: skip
    with tensioned(real, gains, Mode.HOLD, max(150.0, plant.tension_n)) as rig:
        pause(rig, plant, RESPONSE_GAP_S)
        ended, records = respond(rig)
    if ended is not Refusal.NONE:
        return []
    try:
        found = response(settings, gains, records)["figures"]["plant"]
    except IdentificationError:
        return []
    true = true_plant(real)
    truth = {
        "stiffness_n_mm": true.stiffness, "lag_s": true.lag, "delay_s": true.delay, "damping_n_s_mm": true.damping,
    }  # fmt: skip
    return [Figure(name, found[name]["value"] - value, found[name]["error"]) for name, value in truth.items()]


@functools.cache
def drawn() -> dict[Callable[[RandomPlant], list[Figure]], list[list[Figure]]]:
    """The figures of each rig, by the way in which they were found."""
    rigs = plants(SEED, RIGS)
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        return {by: list(pool.map(by, part)) for by, part in ((by_response, rigs[:RESPONSES]), (by_steps, rigs))}


def inside(figures: list[Figure]) -> float:
    return float(np.mean([abs(each.off) <= each.error for each in figures]))


def test_intervals_hold_the_truth() -> None:
    figures = [each for found in drawn().values() for rig in found for each in rig]
    assert len(figures) >= FIGURES
    assert inside(figures) >= LEAST


def test_few_rigs_are_left_without_figures() -> None:
    for found in drawn().values():
        assert sum(not rig for rig in found) <= len(found) / 10


def test_intervals_are_no_wider_than_the_errors_are_spread() -> None:
    steps = [each for rig in drawn()[by_steps] for each in rig]
    for name in {each.name for each in steps}:
        part = [each for each in steps if each.name == name]
        spread = np.percentile([abs(each.off) / each.error for each in part], 95.0)
        finest = np.median([FINEST.get(name, 0.0) / each.error for each in part])
        assert WIDEST * max(spread, finest) >= 1.0, (name, spread)
