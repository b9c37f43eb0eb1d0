"""Weights found by optimisation: least error over the study's scenarios within the limits of robustness and noise.

The structure of a law is fixed; what is searched are its knobs. The cost is the geometric mean of the errors (rms) in
the scenarios of `rigctl.design.surrogate`: halving any one of them counts the same, so no weight has to be chosen by
hand. The limits: Ms over the family at the plant's input and output, noise of the command at rest, and steps of the
command at rest within the acceleration limit. A law that breaks one is worse than any that does not.

Differential evolution (Storn, Price 1997) over the logarithms, then Nelder and Mead's simplex from the best; both are
SciPy's. With few evaluations only the simplex, from the start. The same seed gives the same weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rigctl.config.bounds import findings
from rigctl.config.settings import RigSettings
from rigctl.design import surrogate
from rigctl.design.gains import DesignError
from rigctl.design.knobs import Knob, knobs_for, turned, value_of
from rigctl.design.margins import design_and_check
from rigctl.design.plant_family import Family
from rigctl.design.surrogate import CaseErrors, OurLaw, TickedLaw
from rigctl.design.verdict import Design

SEED, EVALUATIONS = 1, 600
MS_SPARE, NOISE_SPARE = 0.002, 0.005  # distance from a limit (of the noise: a share), so that rounding does not decide
STEP_SIGMAS = 4.0  # steps of the command at rest below the acceleration limit, in standard deviations
BROKEN = 100.0  # cost of a law beyond a limit, above that of any other
UNPROVEN = 1.0  # added to Ms
DIGITS = 3  # of a weight, as it is written into a file
_GLOBAL = 0.75  # share of the evaluations that differential evolution has ...
_FEWEST = 50  # ... if there are so many for each knob
_POPULATION = 6  # times the number of knobs
_SIMPLEX = 0.25  # edge of the first simplex, of a logarithm


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
    outcomes: Mapping[str, CaseErrors]

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


def score(settings: RigSettings, judged: Judged | None, limits: Limits) -> Score:
    """Score a law on the plant in the settings; None is one that cannot be made."""
    if judged is None:
        return Score(3.0 * BROKEN, math.inf, math.inf, {})
    ms, noise = judged.ms, judged.command_noise_mm_s
    if not math.isfinite(ms + noise):
        return Score(2.0 * BROKEN, ms, noise, {})
    beyond = max(0.0, ms - limits.ms) + max(0.0, noise / limits.command_noise_mm_s - 1.0)
    if beyond > 0.0:
        return Score(BROKEN + min(beyond, BROKEN), ms, noise, {})
    outcomes = surrogate.play_all(settings, judged.law())
    step = outcomes["rest"].step_mm_s / limits.step_mm_s
    if not math.isfinite(step) or step > 1.0:
        return Score(BROKEN + min(step, BROKEN) if math.isfinite(step) else 2.0 * BROKEN, ms, noise, {})
    errors = [outcome.rms_n for outcome in outcomes.values()]
    return Score(float(np.mean(np.log(errors))), ms, noise, outcomes)


def minimum(
    cost: Callable[[Sequence[float]], float],
    knobs: Sequence[Knob],
    start: Sequence[float] | None,
    *,
    seed: int = SEED,
    evaluations: int = EVALUATIONS,
) -> tuple[tuple[float, ...], int]:
    """The values of the knobs at the least cost found, rounded, and how often ``cost`` was called; deterministic."""
    from scipy.optimize import differential_evolution, minimize  # 0.3 s

    called = 0
    found: dict[tuple[float, ...], float] = {}

    def at(logarithms: Sequence[float]) -> float:
        nonlocal called
        values = tuple(rounded(math.exp(x)) for x in logarithms)
        if values not in found:
            called += 1
            found[values] = cost(values)
        return found[values]

    bounds = [(math.log(knob.low), math.log(knob.high)) for knob in knobs]
    inside = None
    if start is not None:
        inside = [min(max(math.log(x), low), high) for x, (low, high) in zip(start, bounds, strict=True)]
    if inside is None or evaluations >= _FEWEST * len(knobs):
        generations = max(1, round(_GLOBAL * evaluations / (_POPULATION * len(knobs))) - 1)
        differential_evolution(
            at, bounds, x0=inside, seed=seed, popsize=_POPULATION, maxiter=generations, tol=0.0, polish=False,
            init="sobol",
        )  # fmt: skip
    else:
        at(inside)
    best = [math.log(x) for x in min(found, key=found.__getitem__)]
    simplex = np.array([best, *(np.array(best) + _SIMPLEX * axis for axis in np.eye(len(knobs)))])
    left = max(len(knobs) + 1, evaluations - called)
    minimize(at, best, method="Nelder-Mead", bounds=bounds, options={"maxfev": left, "initial_simplex": simplex})
    return min(found, key=found.__getitem__), called


def weights(
    settings: RigSettings,
    family: Family,
    *,
    knobs: Sequence[Knob] | None = None,
    seed: int = SEED,
    evaluations: int = EVALUATIONS,
    advance: Callable[[], None] | None = None,
) -> tuple[RigSettings, Best]:
    """The settings with the weights of least cost for the plant in them.

    ``knobs``: those that are turned, by default all that act. ``advance`` is called with each evaluation.
    """
    knobs = knobs_for(settings) if knobs is None else knobs
    limits = Limits.of(settings)
    inner = Limits(limits.ms - MS_SPARE, limits.command_noise_mm_s * (1.0 - NOISE_SPARE), limits.step_mm_s)

    def scored(values: Sequence[float]) -> Score:
        if advance is not None:
            advance()
        there = turned(settings, knobs, values)
        return score(settings, our_design(there, family, knobs), inner)

    start = [float(value_of(settings, knob.key)) for knob in knobs]
    values, called = minimum(lambda values: scored(values).cost, knobs, start, seed=seed, evaluations=evaluations)
    before = score(settings, our_design(settings, family), limits)
    return turned(settings, knobs, values), Best(values, scored(values), before, called)


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
