"""Weights found by optimisation: least error over the groups of disturbances within the limits of robustness and noise.

The structure of a law is fixed; what is searched are its knobs. The cost is the largest over the groups of the error
(rms) over its reference, which is what one law can reach there beside the others (`rigctl.design.linear_errors`): a
mean over groups ends near the noise's floor in the one that weighs little, and gives that one away. The limits: Ms over
the family at the plant's input and output, noise of the command at rest, and steps of the command at rest within the
acceleration limit. A law that breaks one is worse than any that does not.

Move, heave, shakes and rest are linear and judged by the closed loop's response; a jolt, and everything where the
filter has two settings, in real ticks (`rigctl.design.surrogate`).

CMA-ES (Hansen, Ostermeier, Evolutionary Computation 9 (2001), 159-195; the library `cma`) over the logarithms, several
times: from the start, from drawn places, and closely about the best. The same seed gives the same weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rigctl.config.bounds import findings
from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import Array, filter_model
from rigctl.design import plant_family, surrogate
from rigctl.design.gains import OPEN, DesignError
from rigctl.design.knobs import Knob, knobs_for, turned, value_of
from rigctl.design.linear_errors import LinearCases, Response, references_n
from rigctl.design.margins import controllers, design_and_check
from rigctl.design.plant_family import Family
from rigctl.design.surrogate import OurLaw, TickedLaw
from rigctl.design.verdict import Design

SEED, EVALUATIONS = 1, 600
MS_SPARE, NOISE_SPARE = 0.002, 0.005  # distance from a limit (of the noise: a share), so that rounding does not decide
STEP_SIGMAS = 4.0  # steps of the command at rest below the acceleration limit, in standard deviations
BROKEN = 100.0  # cost of a law beyond a limit, above that of any other
UNPROVEN = 1.0  # added to Ms
DIGITS = 3  # of a weight, as it is written into a file
MEAN_SHARE = 0.05
"""Of the mean over the groups in the cost, so that what is not the largest does not drift."""
_FEWEST = 50  # evaluations for each knob from which on other starts than the first are tried
_WIDE, _CLOSE = 0.25, 0.03  # first standard deviation of a search, as a share of a knob's range
_SHARES = (0.5, 0.25, 0.25)  # of the evaluations: from the start, from a drawn place, about the best
_SAME = 1e-4  # of a cost: a search whose candidates differ by less has ended


class Judged(Protocol):
    """A tuned law that may be scored."""

    @property
    def ms(self) -> float:
        """Largest sensitivity peak over the family, infinite where one of its plants is unstable."""

    @property
    def command_noise_mm_s(self) -> float:
        """Rms of the command from the cell's noise, with the plant in the settings."""

    def law(self) -> TickedLaw:
        """The law itself."""

    @property
    def response(self) -> Response | None:
        """Of the law, where it has one; None where its filter has two settings."""


@dataclass(frozen=True)
class Limits:
    """What a law must keep."""

    ms: float
    command_noise_mm_s: float
    step_mm_s: float  # rms from tick to tick

    @classmethod
    def of(cls, settings: RigSettings) -> Limits:
        """The limits in the settings."""
        step = settings.tension.acceleration_max_mm_s2 / settings.loop.rate_hz / STEP_SIGMAS
        return cls(settings.design.ms_max, settings.design.command_noise_max_mm_s, step)


@dataclass(frozen=True)
class Score:
    """One law: the logarithm of its cost, and what it is made of; no outcomes of a law beyond a limit."""

    cost: float
    ms: float
    command_noise_mm_s: float
    rms_n: Mapping[str, float]
    """True error of the tension, by group."""

    @property
    def within(self) -> bool:
        """Whether it keeps every limit."""
        return self.cost < BROKEN


@dataclass(frozen=True)
class Best:
    """Result of a search: values of the knobs, rounded, and their score; that of the start beside it."""

    values: tuple[float, ...]
    score: Score
    start: Score | None  # None if the search had no start
    evaluations: int

    @property
    def ratio(self) -> float | None:
        """Cost over that of the start; None if either breaks a limit."""
        if self.start is None or not (self.start.within and self.score.within):
            return None
        return math.exp(self.score.cost - self.start.cost)


@dataclass(frozen=True)
class OurDesign:
    """Our law with the weights of the settings, judged over a family."""

    settings: RigSettings
    design: Design

    @property
    def ms(self) -> float:
        """See `Judged`; beyond any limit where changes of the filter's setting are not proven."""
        switching = self.design.switching
        if switching is not None and switching <= 0.0:
            return self.design.ms_max + UNPROVEN - switching
        return self.design.ms_max

    @property
    def command_noise_mm_s(self) -> float:
        """See `Judged`."""
        figures = self.design.performance
        return figures.command_noise_mm_s if figures is not None else math.inf

    def law(self) -> TickedLaw:
        """See `Judged`."""
        return OurLaw(self.settings, self.design.gains)

    @property
    def response(self) -> Response | None:
        """See `Judged`."""
        if self.settings.estimator.adapts:
            return None
        return controllers(filter_model(self.settings), self.design.gains)[OPEN].response


def score(settings: RigSettings, judged: Judged | None, limits: Limits, cases: LinearCases | None) -> Score:
    """Score a law on the plant in the settings; None is one that cannot be made.

    ``cases``: of that plant; None: everything in ticks, also of a law that has a response.
    """
    if judged is None:
        return Score(3.0 * BROKEN, math.inf, math.inf, {})
    ms, noise = judged.ms, judged.command_noise_mm_s
    if not math.isfinite(ms + noise):
        return Score(2.0 * BROKEN, ms, noise, {})
    beyond = max(0.0, ms - limits.ms) + max(0.0, noise / limits.command_noise_mm_s - 1.0)
    if beyond > 0.0:
        return Score(BROKEN + min(beyond, BROKEN), ms, noise, {})
    rms_n, step_mm_s = _errors(settings, judged, cases)
    step = step_mm_s / limits.step_mm_s
    if not math.isfinite(step) or step > 1.0:
        return Score(BROKEN + min(step, BROKEN) if math.isfinite(step) else 2.0 * BROKEN, ms, noise, {})
    shares = np.log([rms_n[name] / reference for name, reference in references_n(settings).items()])
    return Score(float((1.0 - MEAN_SHARE) * shares.max() + MEAN_SHARE * shares.mean()), ms, noise, rms_n)


def _errors(settings: RigSettings, judged: Judged, cases: LinearCases | None) -> tuple[dict[str, float], float]:
    """True error of each group, N, and the steps of the command at rest, mm/s."""
    response, law = judged.response, judged.law()
    plant, played = plant_family.nominal(settings), surrogate.scenarios(settings)
    if response is None or cases is None:
        found = {case.name: surrogate.play(settings, law, plant, case) for case in played}
        return {name: each.rms_n for name, each in found.items()}, found[surrogate.REST].step_mm_s
    linear = cases.errors(response)
    jolt = surrogate.play(settings, law, plant, next(case for case in played if case.name == surrogate.JOLT))
    return {**linear.rms_n, surrogate.JOLT: jolt.rms_n}, linear.step_mm_s


def minimum(
    cost: Callable[[Sequence[float]], float],
    knobs: Sequence[Knob],
    start: Sequence[float] | None,
    *,
    seed: int = SEED,
    evaluations: int = EVALUATIONS,
    wide: bool = True,
) -> tuple[tuple[float, ...], int]:
    """The values of the knobs at the least cost found, rounded, and how often ``cost`` was called; deterministic.

    ``wide``: search the whole range, where there are evaluations enough; else only about the start.
    """
    import cma  # of the extra `studies`; 1 s

    low, high = (np.log([getattr(knob, end) for knob in knobs]) for end in ("low", "high"))
    random, found = np.random.default_rng(seed), dict[tuple[float, ...], float]()

    def at(place: Array) -> float:
        """Of a place in the unit cube."""
        values = tuple(rounded(math.exp(x)) for x in low + place * (high - low))
        if values not in found:
            found[values] = cost(values)
        return found[values]

    def best() -> tuple[float, ...]:
        return min(found, key=found.__getitem__)

    def place(values: Sequence[float]) -> Array:
        inside: Array = np.clip((np.log(values) - low) / (high - low), 0.0, 1.0)
        return inside

    wide = start is None or (wide and evaluations >= _FEWEST * len(knobs))
    shares = _SHARES if wide else (1.0,)
    for number, share in enumerate(shares):
        left = round(share * evaluations)
        if number == len(_SHARES) - 1:
            begun, width = place(best()), _CLOSE
        elif start is not None and number == 0:
            begun, width = place(start), _WIDE if wide else _CLOSE
        else:
            begun, width = random.uniform(0.2, 0.8, len(knobs)), _WIDE
        at(begun)
        options = {
            "seed": seed + number, "bounds": [0.0, 1.0], "maxfevals": left, "tolfun": _SAME, "verbose": -9,
            "maxstd": np.inf,  # its bound of a width fails in cma 4.5 once it acts
        }  # fmt: skip
        cma.fmin2(at, begun, width, options)
    return best(), len(found)


def weights(
    settings: RigSettings,
    family: Family,
    *,
    knobs: Sequence[Knob] | None = None,
    seed: int = SEED,
    evaluations: int = EVALUATIONS,
    advance: Callable[[], None] | None = None,
    wide: bool = True,
) -> tuple[RigSettings, Best]:
    """The settings with the weights of least cost for the plant in them.

    Args:
        settings: with the weights to begin at.
        family: over which Ms is taken.
        knobs: those that are turned, by default all that act.
        seed: of the search.
        evaluations: designs tried.
        advance: called with each of them.
        wide: search the whole range, where there are designs enough; False: only about the start.
    """
    knobs = knobs_for(settings) if knobs is None else knobs
    limits, cases = Limits.of(settings), LinearCases(settings)
    inner = Limits(limits.ms - MS_SPARE, limits.command_noise_mm_s * (1.0 - NOISE_SPARE), limits.step_mm_s)

    def scored(values: Sequence[float]) -> Score:
        if advance is not None:
            advance()
        there = turned(settings, knobs, values)
        return score(settings, our_design(there, family, knobs), inner, cases)

    start = [float(value_of(settings, knob.key)) for knob in knobs]
    values, called = minimum(
        lambda values: scored(values).cost, knobs, start, seed=seed, evaluations=evaluations, wide=wide
    )
    before = score(settings, our_design(settings, family), limits, cases)
    return turned(settings, knobs, values), Best(values, scored(values), before, called)


def in_ticks(settings: RigSettings, family: Family) -> Score:
    """Our law with the weights of the settings, judged by the limits themselves and in ticks alone."""
    return score(settings, our_design(settings, family), Limits.of(settings), None)


def our_design(settings: RigSettings, family: Family, knobs: Sequence[Knob] = ()) -> OurDesign | None:
    """Our law with the weights of the settings; None if there are no gains, or a knob is out of its bounds."""
    keys = {knob.key for knob in knobs}
    if any(found.key in keys for found in findings(settings)):
        return None
    try:
        return OurDesign(settings, design_and_check(settings, family))
    except (DesignError, ArithmeticError, ValueError):
        return None


def rounded(value: float) -> float:
    """A value to the digits with which it is written."""
    return float(f"{value:.{DIGITS}g}")
