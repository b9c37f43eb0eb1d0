"""Draws: rigs and courses by block, pairs of faults by number, all from one seed."""

from __future__ import annotations

import functools
import math
import random
from dataclasses import asdict, dataclass
from typing import Any

from hil.faults.drawn import kinds
from hil.faults.drawn.courses import COURSES, THEN
from hil.faults.drawn.kinds import KINDS, PARTS, DrawnKind
from hil.scenario.errors import ScenarioError
from hil.scenario.play import design
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains

BLOCK = 8
"""Draws on one rig in one course, so that they share the run without a fault."""
SPRING_N_MM = (6.0, 34.0)
MECHANISM_N_MM = (20.0, 1000.0)
RIGID_SHARE, HIGHEST_SHARE, WITHOUT_LIMITS_SHARE = 0.5, 0.3, 0.25
SECONDS, LONG_SECONDS, LONG_SHARE = (2.0, 20.0), (20.0, 120.0), 0.15
"""From the first fault on, and of the share of draws that is watched for longer."""
APART_S = (0.05, 20.0)
LATENT_SHARE = 0.7
"""Of the pairs whose second fault comes later than the first."""
SPARE_S = 2.0
"""At least so long the second fault is watched."""
MOST_RIGS = 50


@dataclass(frozen=True)
class DrawnRig:
    """Changes to the rig file."""

    spring_n_mm: float
    mechanism_n_mm: float | None
    target_n: float
    limits: bool

    def settings(self, rig: RigSettings) -> RigSettings:
        """The rig file with them; the simulated plant is as it says."""
        values: dict[str, object] = {
            "plant.spring_n_mm": self.spring_n_mm,
            "plant.mechanism_n_mm": self.mechanism_n_mm,
            "simulation.mechanism.vertical_n_mm": self.mechanism_n_mm,
            "tension.target_n": self.target_n,
        }
        if not self.limits:
            values["limits"] = ()
        return changed(rig, values)


@dataclass(frozen=True)
class PartFault:
    """One fault: what, how large, and when it begins, from power-on."""

    kind: str
    size: float
    at_s: float

    @property
    def words(self) -> str:
        """For a person."""
        return f"{self.at_s:.3f} s: {kinds.BY_NAME[self.kind].what.format(self.size)}"


@dataclass(frozen=True)
class Draw:
    """A pair of faults in a course on a rig."""

    seed: int
    index: int
    rig: DrawnRig
    course: str
    faults: tuple[PartFault, ...]
    then: str
    then_after_s: float
    seconds: float
    """From the first fault on."""

    def as_dict(self) -> dict[str, Any]:
        """For files."""
        return asdict(self)


def block_of(rig: RigSettings, seed: int, number: int) -> tuple[DrawnRig, RigSettings, Gains, str]:
    """Rig, its settings and gains, and course of a block; a rig whose design is refused is drawn again.

    Raises:
        ScenarioError: no design is accepted.
    """
    rng = random.Random(f"{seed}:block {number}")
    course = COURSES[number % len(COURSES)].name
    for _ in range(MOST_RIGS):
        drawn = _rig(rng, rig)
        settings = drawn.settings(rig)
        try:
            return drawn, settings, design(settings), course
        except ScenarioError:
            continue
    raise ScenarioError([f"{rig.rig}: none of {MOST_RIGS} drawn rigs has a design that is accepted"])


def _rig(rng: random.Random, rig: RigSettings) -> DrawnRig:
    spring = rng.uniform(*SPRING_N_MM)
    mechanism = None if rng.random() < RIGID_SHARE else _between(rng, *MECHANISM_N_MM)
    highest = rng.random() < HIGHEST_SHARE
    target = rig.tension.target_max_n if highest else rng.uniform(rig.tension.target_min_n, rig.tension.target_max_n)
    limits = rng.random() >= WITHOUT_LIMITS_SHARE
    return DrawnRig(round(spring, 2), mechanism and round(mechanism, 1), round(target, 1), limits)


@functools.cache
def _windows() -> dict[str, tuple[float, float]]:
    return {course.name: (course.begin_s, course.end_s) for course in COURSES}


def pair_of(seed: int, index: int, drawn: DrawnRig, course: str) -> Draw:
    """The pair of a number, in its block's course on its block's rig."""
    rng = random.Random(f"{seed}:{index}")
    first_s = round(rng.uniform(*_windows()[course]), 3)
    gap_s = _between(rng, *APART_S) if rng.random() < LATENT_SHARE else 0.0
    parts = [rng.choice(PARTS) for _ in range(2)]  # they may be the same
    kinds_drawn = [rng.choice([kind for kind in KINDS if kind.part == part]) for part in parts]
    faults = tuple(
        PartFault(kind.name, _size(rng, kind), round(first_s + i * gap_s, 3)) for i, kind in enumerate(kinds_drawn)
    )
    seconds = max(_between(rng, *(LONG_SECONDS if rng.random() < LONG_SHARE else SECONDS)), gap_s + SPARE_S)
    return Draw(
        seed, index, drawn, course, faults, rng.choice(list(THEN)), round(rng.uniform(0.3, 5.0), 2), round(seconds, 2)
    )


def _size(rng: random.Random, kind: DrawnKind) -> float:
    size = _between(rng, kind.low, kind.high)
    sign = -1.0 if kind.signed and rng.random() < 0.5 else 1.0
    return float(f"{sign * size:.4g}")


def _between(rng: random.Random, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))
