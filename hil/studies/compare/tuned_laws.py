"""Every law tuned by one optimiser for one plant: the same cost, the same limits of Ms and noise, the same family.

The optimiser is that of `rigctl tune --optimize` (`rigctl.design.optimise`), begun three times: one search may end in a
valley that is not the lowest, and how far the three are apart says how well the least error is known. Ms is over the
family of the identified plant with its damping, at the plant's input and at the tension, for every law.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hil.studies.compare import law_robustness
from hil.studies.compare.rivals import OURS
from hil.studies.compare.rivals.feedback import Feedback, Model, Newest, Rival
from hil.studies.compare.rivals.tunable import TUNABLE
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Estimate, Gains
from rigctl.design import optimise, tuning
from rigctl.design.knobs import Knob, knobs_for, searchable, value_of, with_weights
from rigctl.design.linear_errors import LinearCases, Response
from rigctl.design.margins import frequency_grid
from rigctl.design.optimise import Limits
from rigctl.design.plant_family import ComplexArray, Family, Member, nominal
from rigctl.design.surrogate import TickedLaw
from rigctl.design.tuning import Optimisation

LAW_VERSION = 4
"""Of `rigctl.control.law` and of its search: to be raised with their arithmetic, so that rows of before are refused."""
EVALUATIONS = {True: 60, False: 15}
"""For each knob and start: of a search over the whole range, of one that begins at the optimum for another rig."""
STARTS = 3
AROUND = 3.0
"""Factor, up or down, within which further starts lie about the optimum for another rig."""
ANSWER_TICKS = 3000
STABLE_S = 2.0
"""A disturbance of one tick must have died out by then on the plant in the settings; Ms covers the other plants."""


class TunedLaw(NamedTuple):
    """A law with the values that the optimiser found, in the order of its knobs."""

    name: str
    values: tuple[float, ...]
    within: bool
    cost: float
    """Mean of the logarithms of the errors in N over the surrogate's scenarios; infinite where a limit is broken."""
    ms: float
    command_noise_mm_s: float
    costs: tuple[float, ...] = ()
    """That of each start; the least is ``cost``."""

    @property
    def spread_pct(self) -> float | None:
        """By how much more the worst start errs than the best; None where one of them found nothing within."""
        if not self.costs or not all(map(math.isfinite, self.costs)):
            return None
        return 100.0 * math.expm1(max(self.costs) - min(self.costs))


@dataclass
class NewestSample:
    """What a rival reads, in the place of the channels of the loop's inbox."""

    tension_n: float = 0.0
    speed_mm_s: float = 0.0
    tangential_rad: float = 0.0
    normal_rad: float = 0.0


class RivalTicks:
    """A rival in the form in which the surrogate's scenarios run a law; ramps and limits are those of `TensionLaw`."""

    def __init__(self, settings: RigSettings, make: Callable[[], Feedback]) -> None:
        self._settings, self._make = settings, make
        cylinder = settings.cylinder
        self._stroke_mm = 0.5 * (cylinder.stroke_min_mm + cylinder.stroke_max_mm)
        self.start(settings.tension.target_n)

    def start(self, target_n: float) -> None:
        """See `TickedLaw`."""
        self._newest = NewestSample(target_n)
        newest = Newest(self._newest, self._newest, self._newest)
        self._law = Rival(self._settings, Gains(0.0, 0.0, 0.0), newest, self._make())
        self._law.target_n = target_n
        self._law.start_ramp(target_n, 0.0)

    def command(self, tension_n: float, speed_mm_s: float) -> float:
        """See `TickedLaw`."""
        self._newest.tension_n, self._newest.speed_mm_s = tension_n, speed_mm_s
        return self._law.compensating(Estimate(tension_n, speed_mm_s, 0.0, self._stroke_mm), 1.0)


class FamilyResponses:
    """The responses of a family's plants, computed once for every candidate."""

    def __init__(self, settings: RigSettings, family: Family) -> None:
        self.own: Member = nominal(settings)
        self.hz = frequency_grid(list(family.members), settings.loop.period_ns * 1e-9)
        self.z: ComplexArray = np.exp(2j * np.pi * self.hz / settings.loop.rate_hz)
        responses = [plant.response(self.z) for plant in (self.own, *family.members)]
        self.tension = np.stack([response[0] for response in responses])
        self.speed = np.stack([response[1] for response in responses])


@dataclass(frozen=True)
class RivalDesign:
    """A rival with its parameters, judged over a family; see `rigctl.design.optimise.Judged`."""

    settings: RigSettings
    make: Callable[[], Feedback]
    ms: float
    command_noise_mm_s: float

    def law(self) -> TickedLaw:
        """See `Judged`."""
        return RivalTicks(self.settings, self.make)

    @property
    def response(self) -> Response:
        """See `Judged`."""
        return lambda z: law_robustness.response(self.make(), z, ANSWER_TICKS)


def judged(settings: RigSettings, make: Callable[[], Feedback], plants: FamilyResponses) -> RivalDesign | None:
    """Ms over the family and noise of a rival; None if it has no linear response."""
    try:
        per_tension, per_speed = law_robustness.response(make(), plants.z, ANSWER_TICKS)
    except (ArithmeticError, ValueError):
        return None
    at_input = 1.0 / (1.0 - per_tension * plants.tension - per_speed * plants.speed)
    peaks = np.maximum(np.abs(at_input), np.abs(at_input * (1.0 - per_speed * plants.speed)))
    ms = float(peaks.max())
    noise = np.trapezoid(np.abs(per_tension * at_input[0]) ** 2, plants.hz) / plants.hz[-1]
    if not math.isfinite(ms + float(noise)):
        return None
    # Sensitivity is finite on the circle for every plant between the members too, so that all are stable if one is.
    if ms < 2.0 * settings.design.ms_max and not law_robustness.dies_out(
        plants.own, make(), round(STABLE_S * settings.loop.rate_hz)
    ):
        ms = math.inf
    return RivalDesign(settings, make, ms, settings.tension_cell.noise_n * math.sqrt(float(noise)))


def tuned(
    settings: RigSettings, family: Family, law: str, start: Sequence[float] | None = None, *, seed: int = optimise.SEED,
    evaluations: int | None = None, mapped: Sequence[float] | None = None, linear: bool = False,
) -> TunedLaw:  # fmt: skip
    """The values of a law's knobs for the plant in the settings: the best of `STARTS` searches.

    Args:
        settings: with the plant as identified; they hold the limits.
        family: the plants over which Ms is taken.
        law: ``ours`` or a name of ``TUNABLE``.
        start: where to begin a local search; None searches the whole range.
        seed: of the first search, and of the starts of the others.
        evaluations: candidates of each search; None as many as the number of knobs asks for.
        mapped: another law's optimum as values of this one's knobs, where the last search over the whole range begins.
        linear: of ours with one setting of its filter; every rival is linear.
    """
    if law == OURS and start is not None:
        settings = with_weights(settings, start)
    knobs = knobs_of(law, settings)
    count = evaluations or EVALUATIONS[start is None] * most_knobs(law, settings)
    plants = None if law == OURS else FamilyResponses(settings, family)
    starts = _starts(settings, law, knobs, start, seed)
    if mapped is not None and start is None:
        starts[-1] = tuple(mapped)
    if plants is None:
        searches = [Optimisation(seed + number, count, linear=linear) for number in range(STARTS)]
        found = [
            _ours(with_weights(settings, begun), family, each) for begun, each in zip(starts, searches, strict=True)
        ]
    else:
        found = [_rival(settings, plants, law, begun, seed + number, count) for number, begun in enumerate(starts)]
    best = min(found, key=lambda each: (not each.within, each.cost, each.ms))
    return best._replace(costs=tuple(each.cost for each in found))


def _starts(
    settings: RigSettings, law: str, knobs: Sequence[Knob], start: Sequence[float] | None, seed: int
) -> list[tuple[float, ...]]:
    """Where the searches begin: at ``start`` or the law's own, then drawn about it, or from the whole range."""
    if start is not None:
        first = tuple(start)
    elif law == OURS:
        first = tuple(float(value_of(settings, knob.key)) for knob in knobs)
    else:
        first = tuple(TUNABLE[law].start(Model.of(settings)))
    found = [first]
    for number in range(1, STARTS):
        rng = np.random.default_rng([seed, number])
        drawn = []
        for value, knob in zip(first, knobs, strict=True):
            about = (value / AROUND, value * AROUND) if start is not None else (knob.low, knob.high)
            low, high = (min(max(end, knob.low), knob.high) for end in about)
            drawn.append(optimise.rounded(math.exp(rng.uniform(math.log(low), math.log(high)))))
        found.append(tuple(drawn))
    return found


def from_lqi(settings: RigSettings, values: Sequence[float]) -> tuple[float, ...]:
    """The knobs of our law that make it LQI with these values, within their ranges.

    LQI has no disturbance state: its disturbance is white, which is a walk of the tension, and ours walks least.
    """
    stretch_mm, held_s, disturbance_mm_s = values
    weight = (settings.tension.speed_max_mm_s / stretch_mm) ** 2
    wanted = {
        "design.stretch_weight": weight,
        "design.integral_weight": weight / held_s**2,
        "estimator.disturbance_walk_mm_s": 0.0,
        "estimator.tension_walk_n": settings.plant.stiffness_n_mm * disturbance_mm_s / math.sqrt(settings.loop.rate_hz),
    }
    found = ((knob, wanted.get(knob.key, value_of(settings, knob.key))) for knob in knobs_for(settings))
    return tuple(min(max(float(value), knob.low), knob.high) for knob, value in found)


def _ours(settings: RigSettings, family: Family, search: Optimisation) -> TunedLaw:
    """One search for the weights of our law, as `rigctl tune --optimize` makes it."""
    used, best = tuning.optimised(settings, family, search)
    return _found(OURS, tuple(float(value_of(used, knob.key)) for knob in knobs_for(used)), best.score)


def _rival(
    settings: RigSettings, plants: FamilyResponses, law: str, start: Sequence[float], seed: int, count: int
) -> TunedLaw:
    """One search for the parameters of a rival."""
    knobs = knobs_of(law, settings)
    limits, tunable = Limits.of(settings), TUNABLE[law]
    inner = replace(
        limits,
        ms=limits.ms - optimise.MS_SPARE,
        command_noise_mm_s=limits.command_noise_mm_s * (1.0 - optimise.NOISE_SPARE),
    )

    def scored(values: Sequence[float], cases: LinearCases | None) -> optimise.Score:
        made = judged(settings, lambda: tunable.make(settings, values), plants)
        return optimise.score(settings, made, inner, cases)

    linear = LinearCases(settings)
    values, _ = optimise.minimum(lambda values: scored(values, linear).cost, knobs, start, seed=seed, evaluations=count)
    return _found(law, values, scored(values, None))


def _found(law: str, values: tuple[float, ...], score: optimise.Score) -> TunedLaw:
    """``score``: in ticks, of every law, because ours may have two settings of its filter."""
    cost = score.cost if score.within else math.inf
    return TunedLaw(law, values, score.within, cost, score.ms, score.command_noise_mm_s)


def knobs_of(law: str, settings: RigSettings) -> tuple[Knob, ...]:
    """The parameters of a law that are searched."""
    return knobs_for(settings) if law == OURS else TUNABLE[law].knobs


def most_knobs(law: str, settings: RigSettings) -> int:
    """How many those are, of ours with two settings of its filter."""
    return len(knobs_of(law, searchable(settings)))
