"""What `rigctl tune` does: a design for the plant of the rig file, or for the identified one, with weights as they are
or optimised."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design import gain_file, identified, optimise, plant_family
from rigctl.design.gain_file import SpringGains
from rigctl.design.identified import Identified, NotIdentifiedError
from rigctl.design.knobs import knobs_for, one_setting, searchable, value_of
from rigctl.design.margins import design_and_check
from rigctl.design.optimise import Best
from rigctl.design.plant_family import Family
from rigctl.design.transitions import EntryLoop, dwell_time_s
from rigctl.design.verdict import Design
from rigctl.ipc.ledger import Entry

ONE_SETTING = 0.7
"""Of the designs tried: those with one setting of the filter; the rest where two settings are given."""
SHARE_AT_POINT = 12
"""Designs tried for each weight at a further operating point, where the search begins at the base's optimum."""


@dataclass(frozen=True)
class Optimisation:
    """How the weights are searched for; ``advance`` is called after each evaluation.

    ``linear``: with one setting of the filter only, because a law with two is not linear.
    """

    seed: int = optimise.SEED
    evaluations: int = optimise.EVALUATIONS
    advance: Callable[[], None] | None = None
    linear: bool = False


@dataclass(frozen=True)
class Tuned:
    """A design, and what it takes from where."""

    given: RigSettings  # as the rig file has them
    settings: RigSettings  # as the design uses them
    family: Family
    design: Design
    plant: Identified | None = None  # None: the plant of the rig file, over the assumed family
    best: Best | None = None  # None: the weights as given
    points: tuple[Tuned, ...] = ()  # the other entries of a gain table
    dwell_s: float | None = None  # proven for the table; None: there is none

    @property
    def gains(self) -> SpringGains:
        """For a gain file."""
        points = [point.gains for point in self.points]
        return gain_file.spring_gains(self.design, self.given, self.settings, self.plant, points)

    @property
    def replaces(self) -> dict[str, tuple[float | None, float | None]]:
        """Values of the rig file and those used in their place, by key."""
        return {key: (value.file, value.used) for key, value in self.gains.replaces.items()}


def tune(
    settings: RigSettings,
    entries: Sequence[Entry] | None = None,
    search: Optimisation | None = None,
    *,
    table: bool = False,
) -> Tuned:
    """A design for the settings.

    Args:
        settings: of the rig file.
        entries: of the ledger, for the identified plant; None for the rig file's, over the assumed family.
        search: look for weights; None takes those of the settings.
        table: with ``entries``, a gain table over every operating point that is identified.

    Raises:
        NotIdentifiedError: the ledger does not identify the plant.
        TransitionError: changes between the entries of the table cannot be proven.
        DesignError: there are no gains for these settings.
    """
    used, plant, plants = settings, None, list[Identified]()
    if entries is not None:
        plants = identified.points(entries, settings)
        plant = identified.nearest(plants, settings.tension.target_n)
        used = identified.believing(settings, plant)
    family = plant_family.assumed(used) if plant is None else identified.family(used, plant)
    best = None
    if search is not None:
        used, best = optimised(used, family, search)
    found = Tuned(settings, used, family, design_and_check(used, family), plant, best)
    if not table:
        return found
    points = tuple(_at_point(found, other, search) for other in plants if other is not plant)
    dwell_s = None
    if points and all(each.design.accepted for each in (found, *points)):
        dwell_s = dwell_time_s([EntryLoop(each.settings, each.design.gains, each.family) for each in (found, *points)])
    return replace(found, points=points, dwell_s=dwell_s)


def optimised(settings: RigSettings, family: Family, search: Optimisation) -> tuple[RigSettings, Best]:
    """The weights of least cost with one setting of the filter, or with a quiet one beside it where that costs less.

    The second search begins at the optimum of the first, or at the two settings that there are already. Two settings
    have no response, so that both optima, and the weights given, are compared in ticks.
    """
    adapts = settings.estimator.adapts
    count = round((1.0 - ONE_SETTING if adapts else ONE_SETTING) * search.evaluations)
    tried = [optimise.weights(
        one_setting(settings), family, seed=search.seed, evaluations=search.evaluations if search.linear else count,
        advance=search.advance,
    )]  # fmt: skip
    if not search.linear:
        tried.append(optimise.weights(
            settings if adapts else searchable(tried[0][0]), family, seed=search.seed,
            evaluations=search.evaluations - count, advance=search.advance, wide=False,
        ))  # fmt: skip
    judged = [(optimise.in_ticks(used, family), used, best) for used, best in tried]
    score, used, best = min(judged, key=lambda found: found[0].cost)
    called = sum(found.evaluations for _, found in tried)
    return used, replace(best, score=score, start=optimise.in_ticks(settings, family), evaluations=called)


def _at_point(base: Tuned, plant: Identified, search: Optimisation | None) -> Tuned:
    """The design at another operating point: the same weights, or others near them where these are refused."""
    weights = {knob.key: value_of(base.settings, knob.key) for knob in knobs_for(base.settings)}
    used = changed(identified.believing(base.given, plant), weights)
    family = identified.family(used, plant)
    found, best = design_and_check(used, family), None
    if not found.accepted and search is not None:
        used, best = optimise.weights(
            used, family, seed=search.seed, evaluations=SHARE_AT_POINT * len(weights), advance=search.advance
        )
        found = design_and_check(used, family)
    return Tuned(base.given, used, family, found, plant, best)


def other_springs(settings: RigSettings, entries: Sequence[Entry], now: datetime) -> list[RigSettings]:
    """The settings with each other spring that is identified, and not too long ago; the newest first."""
    found = []
    for stiffness in identified.springs(entries):
        spring = _spring(settings, stiffness)
        there = changed(settings, {"plant.spring_n_mm": spring})
        if identified.same_spring(stiffness, settings.plant.stiffness_n_mm):
            continue
        try:
            plant = identified.nearest(identified.points(entries, there), settings.tension.target_n)
        except NotIdentifiedError:
            continue
        if identified.outdated(plant, settings, now) is None:
            found.append(there)
    return found


def _spring(settings: RigSettings, stiffness_n_mm: float) -> float | None:
    """The spring that gives a stiffness with the rope of the settings, equation (17); None for the rope alone."""
    rope = settings.plant.rope_n_mm
    if identified.same_spring(stiffness_n_mm, rope) or stiffness_n_mm >= rope:
        return None
    return float(f"{1.0 / (1.0 / stiffness_n_mm - 1.0 / rope):.9g}")
