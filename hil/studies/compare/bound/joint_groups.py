"""What one law can be in all groups at once: the least t, so that in every group its error is at most t times a
reference.

The groups are the move, heave, both shakes and the jolt, on one plant with a soft spring and on one with a stiff one.
The reference is the group's own bound: that of a law with the same memory that is made for it alone, for the jolt
that of any law. Where the laws were played, a second one is the least error of all of them.

Two programs give t from both sides. With the limit of S on the nominal plant alone t is a lower bound for every law
that keeps the limit on more plants. With `FamilyGap`, which is sufficient for the limit on every plant of the family,
the optimum is a law that keeps it there, so that t is an upper bound of the least t over the family. The jolt's error
is that of the linear plant, without the drive's limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hil.runs.rows_file import RowsFile
from hil.studies.compare.bound import program
from hil.studies.compare.bound.group_bounds import locked
from hil.studies.compare.bound.linear_law import NoBoundError, at
from hil.studies.compare.bound.nominal import JOLT, TONES, Nominal
from hil.studies.compare.bound.program import Case, FamilyGap, Law, Task
from hil.studies.compare.compared_runs import ComparedRun
from hil.studies.compare.comparison import WAIVER
from hil.studies.compare.equal_limits import Known
from rigctl.config.settings import RigSettings
from rigctl.design.margins import frequency_grid
from rigctl.design.plant_family import Array, ComplexArray, Family, Member

PLANTS = {"6 N/mm": "paper_k6", "34 N/mm": "paper_k34"}
"""The run whose plant and whose move it is."""
FIRST = "paper_k6"
"""The one on the plant of the rig file, on which the other groups are played."""
MEMORIES_S, LAWS_MEMORIES_S = (0.1, 0.3), (0.1, 0.3, 1.0)
"""Of a law that is held to the own bounds, and to the least errors of the laws. With 1 s it cancels a sine by its
phase, so that the own bounds say little there."""
MOVE = "move"
RUNS = {MOVE: FIRST, **{name: name for name in TONES}, JOLT: JOLT}
"""By group the run that plays it on the plant of the rig file."""
MS_SPARE = 0.005
"""Below the limit on the points of the grid, so that it is kept between them."""
Say = Callable[[str], None]
OWN, LAWS = "own bound", "least of the laws"


class JointLaw(NamedTuple):
    """What one law reaches."""

    most: float
    """The largest of ``over``: the optimum."""
    over: dict[str, float]
    """By group: its error over the reference."""
    ms: float
    """The largest over the family's plants."""
    without: dict[str, float]
    """By group: the optimum where that group does not count; what it is lower by is the group's price to the others."""


class JointGroups(NamedTuple):
    """One law for every group on one plant."""

    plant: str
    memory_s: float
    reference: str
    reference_n: dict[str, float]
    """By group: N rms."""
    nominal: JointLaw
    """The limit of S on the nominal plant alone: a lower bound."""
    family: JointLaw | None
    """On every plant of the family: an upper bound; None where the condition leaves no law."""


class JointPlant:
    """One plant with its family, and the disturbance of each group."""

    def __init__(self, rig: RigSettings, run: ComparedRun) -> None:
        settings = run.settings(rig, WAIVER)
        known = Known.of(settings)
        self.here, self.family = Nominal(known.settings), known.family
        self.cases: dict[str, Case] = {
            MOVE: locked(settings, run), **{name: self.here.tone(name) for name in TONES}, JOLT: self.here.jolt()
        }  # fmt: skip

    def own(self, memory_s: float) -> dict[str, float]:
        """The bound of each group alone, N rms."""
        task = self.here.task(memory_s)
        found = {name: program.least(task, case).value for name, case in self.cases.items() if name != JOLT}
        return {**found, JOLT: self.here.least_jolt(self.here.jolt())}

    def joint(
        self, plant: str, memory_s: float, reference: str, reference_n: Mapping[str, float], prices: Sequence[str] = ()
    ) -> JointGroups:
        """One law for all, from both sides.

        ``prices``: the groups without which it is solved once more.

        Raises:
            NoBoundError: no law keeps the limits on the nominal plant.
        """
        task = self.here.task(memory_s)
        gap = family_gap(task, self.here.plant, self.family)
        limits = replace(task.limits, ms=task.limits.ms - MS_SPARE)
        nominal = self._reach(task, reference_n, prices)
        try:
            family = self._reach(replace(task, limits=limits, family=gap), reference_n, prices)
        except NoBoundError:
            family = None
        return JointGroups(plant, memory_s, reference, dict(reference_n), nominal, family)

    def _reach(self, task: Task, reference_n: Mapping[str, float], prices: Sequence[str]) -> JointLaw:
        law = self._law(task, reference_n)
        over = {name: program.errors(task, case, law.x).rms_n / reference_n[name] for name, case in self.cases.items()}
        without = {
            left: self._law(task, {name: n for name, n in reference_n.items() if name != left}).value for left in prices
        }
        return JointLaw(law.value, over, family_peak(task, law.x, self.here.plant, self.family), without)

    def _law(self, task: Task, reference_n: Mapping[str, float]) -> Law:
        return program.least_share(task, [self.cases[name] for name in reference_n], list(reference_n.values()))


def study(
    rig: RigSettings, runs: Sequence[ComparedRun], laws_n: Mapping[str, float] | None, rows: RowsFile, say: Say
) -> list[JointGroups]:
    """The joint bounds on both plants with each memory, over the groups' own bounds, with prices.

    ``laws_n``: the least error of all laws by group, N rms, played on the plant of the rig file; the first of `PLANTS`
    is held to it too. What ``rows`` has already is not done again.

    Raises:
        NoBoundError: no law keeps the limits on a plant.
    """
    found = []
    for plant, name in PLANTS.items():
        here: JointPlant | None = None
        run = next(run for run in runs if run.name == name)
        for memory_s in MEMORIES_S:
            key = f"joint {plant} {memory_s:g} s"
            kept = rows.get(key)
            if kept is None:
                here = here or JointPlant(rig, run)
                one = here.joint(plant, memory_s, OWN, here.own(memory_s), list(here.cases))
                kept = rows.put(key, as_json(one))
            found.append(of_json(kept))
            say(in_words(found[-1]))
        if laws_n is not None and name == FIRST:
            here = here or JointPlant(rig, run)
            for memory_s in LAWS_MEMORIES_S:
                found.append(here.joint(plant, memory_s, LAWS, laws_n))
                say(in_words(found[-1]))
    return found


def as_json(one: JointGroups) -> dict[str, Any]:
    """Of plain dictionaries."""
    family = None if one.family is None else one.family._asdict()
    return {**one._asdict(), "nominal": one.nominal._asdict(), "family": family}


def of_json(kept: Mapping[str, Any]) -> JointGroups:
    """From what `as_json` gives."""
    family = None if kept["family"] is None else JointLaw(**kept["family"])
    return JointGroups(**{**kept, "nominal": JointLaw(**kept["nominal"]), "family": family})


def in_words(one: JointGroups) -> str:
    """The optimum from both sides in a line."""
    most = "none" if one.family is None else f"{one.family.most:.2f}"
    return (
        f"one law for all groups at {one.plant}, {one.memory_s:g} s of memory: {one.nominal.most:.2f} times the "
        f"{one.reference} at least, {most} over the family"
    )


def family_gap(task: Task, own: Member, family: Family) -> FamilyGap:
    """How far a family is from its nominal plant, on a grid that is dense about every resonance."""
    hz = np.unique(np.concatenate([task.grid(), frequency_grid(list(family.members), 1.0 / task.rate_hz)]))
    every = np.empty(2 * len(hz) - 1)
    every[::2], every[1::2] = hz, np.sqrt(hz[1:] * hz[:-1])
    z = np.exp(2j * np.pi * every / task.rate_hz)
    nominal = answer(own, z)
    largest = np.max([np.abs(answer(plant, z) - nominal) for plant in family.members], axis=0)
    padded = np.pad(largest, 1)
    beside: Array = np.max([padded[:-2], padded[1:-1], padded[2:]], axis=0)
    return FamilyGap(hz, beside[::2])


def family_peak(task: Task, x: Array, own: Member, family: Family) -> float:
    """The largest \\|S\\| of a law over the plants of a family; not of the program's condition, but plant by plant."""
    hz = np.unique(
        np.concatenate([task.grid(10 * program.POINTS), frequency_grid(list(family.members), 1.0 / task.rate_hz)])
    )
    z = np.exp(2j * np.pi * hz / task.rate_hz)
    sent, nominal = at(x, z), answer(own, z)
    s = 1.0 + nominal * sent
    return float(max(np.abs(s / (1.0 - (answer(plant, z) - nominal) * sent)).max() for plant in family.members))


def answer(plant: Member, z: ComplexArray) -> ComplexArray:
    """The transform of `StrokeAnswer.sensed`: a command that is taken back in the next tick, read a tick later."""
    found: ComplexArray = (1.0 - 1.0 / z) / z * plant.response(z)[0]
    return found
