"""Search for weights that bring a design within its limit on Ms: each alone, then together, or why none do.

Weaker feedback is more robust and lets more error through: a smaller weight of stretch or integral, or a filter that
follows the disturbance more slowly. The search finds the least change that meets the limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rigctl.config.bounds import findings
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design.margins import design_and_check
from rigctl.design.verdict import Design

KNOBS = (
    "design.stretch_weight",
    "design.integral_weight",
    "estimator.disturbance_walk_mm_s",
    "estimator.tension_walk_n",
)
"""The weights of the search, those of the law before those of the filter. Of stretch, integral and command only the
ratios count, so command_weight is not among them."""
LADDER = (2.0, 4.0, 16.0, 64.0)
"""Factors, down and up, by which a weight is changed; a design takes a fifth of a second."""
HALVINGS = 3  # of the logarithmic interval in which a weight begins to meet the limit
SPARE = 1e-4  # distance from the limit, so that the libraries' rounding does not decide
DESIGNS = 60  # most designs of the search over all weights together
LEAST_STEP = 0.25  # of that search, in octaves
UNSTABLE = 100.0  # score in Ms of each plant with which the loop is unstable
_RELIEF = (
    ("plant.command_delay_s", 0.5, "half the drive's delay (plant.command_delay_s)"),
    ("plant.cylinder_lag_s", 0.5, "half the drive's lag (plant.cylinder_lag_s)"),
    ("loop.rate_hz", 2, "twice the loop's rate (loop.rate_hz)"),
    ("plant.spring_n_mm", 0.5, "a spring half as stiff (plant.spring_n_mm)"),
)


@dataclass(frozen=True)
class Weight:
    """One setting with another value."""

    key: str
    before: float
    value: float

    def in_words(self) -> str:
        """``design.stretch_weight 30 instead of 50``."""
        return f"{self.key} {self.value:g} instead of {self.before:g}"


@dataclass(frozen=True)
class Hint:
    """Effect of one weight alone: the least change that meets the limit, or else the best it reaches."""

    weight: Weight
    ms_max: float
    meets: bool

    def in_words(self) -> str:
        """One line."""
        reached = f"Ms {self.ms_max:.4f}" if math.isfinite(self.ms_max) else "unstable"
        return f"{self.weight.in_words()}: {reached}{'' if self.meets else ', not enough alone'}"


@dataclass(frozen=True)
class Found:
    """Result of the search; ``weights`` is empty if no change is needed."""

    weights: tuple[Weight, ...]
    settings: RigSettings
    design: Design
    meets: bool
    against: tuple[str, ...] = ()  # one line for each reason, if the limit is not met


def hints(settings: RigSettings) -> list[Hint]:
    """Effect of each weight alone on a refused design; those that meet the limit first, in the order of KNOBS."""
    found = [hint for key in KNOBS if (hint := _alone(settings, key)) is not None]
    return sorted(found, key=lambda hint: (not hint.meets, 0.0 if hint.meets else hint.ms_max))


def auto(settings: RigSettings) -> Found:
    """Weights that meet ``design.ms_max``: one alone if that is enough, else several together.

    Raises:
        DesignError: there are no gains for the present settings.
    """
    now = design_and_check(settings)
    if _meets(now):
        return Found((), settings, now, meets=True)
    alone = (_alone(settings, key) for key in KNOBS)
    one = next((hint.weight for hint in alone if hint is not None and hint.meets), None)
    weights = (one,) if one is not None else _together(settings, now)
    settings = _with(settings, weights)
    design = design_and_check(settings)
    meets = _meets(design)
    return Found(weights, settings, design, meets, () if meets else tuple(_against(settings, design)))


def _alone(settings: RigSettings, key: str) -> Hint | None:
    """The least factor, down or up, by which one weight meets the limit, else the one that gets nearest."""
    before = float(_value(settings, key))
    tried: dict[float, Hint | None] = {}

    def at(octaves: float) -> Hint | None:
        weight = Weight(key, before, _rounded(before * 2.0**octaves))
        if weight.value not in tried:
            design = _design(_with(settings, [weight]))
            tried[weight.value] = None if design is None else Hint(weight, _score(design), _meets(design))
        return tried[weight.value]

    for sign in (-1.0, 1.0):
        last = 0.0
        for factor in LADDER:
            octaves = sign * math.log2(factor)
            hint = at(octaves)
            if hint is not None and hint.meets:
                for _ in range(HALVINGS):
                    middle = 0.5 * (last + octaves)
                    nearer = at(middle)
                    last, octaves = (last, middle) if nearer is not None and nearer.meets else (middle, octaves)
                break
            last = octaves
    good = [hint for hint in tried.values() if hint is not None]
    meeting = [hint for hint in good if hint.meets]
    if meeting:
        return min(meeting, key=lambda hint: _octaves(hint.weight))
    best = min(good, key=lambda hint: hint.ms_max, default=None)
    return None if best is None else Hint(best.weight, best.ms_max if best.ms_max < UNSTABLE else math.inf, meets=False)


def _together(settings: RigSettings, now: Design) -> tuple[Weight, ...]:
    """Pattern search over all weights, in octaves; ends when the limit is met or no step improves the score."""
    before = {key: float(_value(settings, key)) for key in KNOBS}
    best, score, step, designs = dict.fromkeys(KNOBS, 0.0), _score(now), 2.0, 0

    def weights(octaves: dict[str, float]) -> tuple[Weight, ...]:
        return tuple(Weight(key, before[key], _rounded(before[key] * 2.0**at)) for key, at in octaves.items() if at)

    while step >= LEAST_STEP and designs < DESIGNS:
        improved = False
        for key in KNOBS:
            for sign in (-step, step):
                there = {**best, key: best[key] + sign}
                design = _design(_with(settings, weights(there)))
                designs += 1
                if design is not None and _score(design) < score - 1e-6:
                    best, score, improved = there, _score(design), True
                    if _meets(design):
                        return weights(best)
                    break
        step = step if improved else 0.5 * step
    return weights(best)


def _against(settings: RigSettings, design: Design) -> Iterator[str]:
    """Reasons why no weights bring a design within the limit."""
    worst = max(design.margins, key=lambda member: member.ms_worst)
    k_m = "rigid" if worst.k_m is None else f"{worst.k_m:g} N/mm"
    yield (
        f"the best found is {design.ms_in_words()}, expected at most {design.limit:g}; worst with mechanism {k_m}, "
        f"rope's k x {worst.k_scale:g}, delay x {worst.delay_scale}"
    )
    for key, factor, words in _RELIEF:
        value = _value(settings, key)
        if value is None:
            yield "there is no spring (plant.spring_n_mm): the rope alone is too stiff for delay and lag"
            continue
        relieved = _design(changed(settings, {key: value * factor}))
        if relieved is not None and _score(relieved) < _score(design):
            yield f"{words} would come to {relieved.ms_in_words()}{', which meets it' if _meets(relieved) else ''}"


def _value(settings: RigSettings, key: str) -> Any:
    section, name = key.split(".")
    return getattr(getattr(settings, section), name)


def _with(settings: RigSettings, weights: Sequence[Weight]) -> RigSettings:
    return changed(settings, {weight.key: weight.value for weight in weights})


def _design(settings: RigSettings) -> Design | None:
    """The design; None if there is none, or if a weight is out of its bounds."""
    if any(found.key in KNOBS for found in findings(settings)):
        return None
    try:
        return design_and_check(settings)
    except (ArithmeticError, ValueError):
        return None


def _meets(design: Design) -> bool:
    return design.ms_max <= design.limit - SPARE


def _score(design: Design) -> float:
    """Ms over the family; each plant with which the loop is unstable counts more than any Ms."""
    unstable = sum(not member.stable for member in design.margins)
    return UNSTABLE * unstable + max((m.ms_worst for m in design.margins if m.stable), default=0.0)


def _octaves(weight: Weight) -> float:
    return abs(math.log2(weight.value / weight.before))


def _rounded(value: float) -> float:
    """The value to two digits, as a person writes it into the file."""
    return float(f"{value:.2g}")
