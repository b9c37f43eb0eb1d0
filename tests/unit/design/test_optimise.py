"""The search for weights: its minimum, its limits, and the scenarios that it is judged by."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import pytest

from rigctl.config.settings import RigSettings
from rigctl.design import optimise, plant_family
from rigctl.design.gains import design
from rigctl.design.knobs import KNOBS, Knob, turned, value_of, with_weights
from rigctl.design.linear_errors import LinearCases, Response
from rigctl.design.optimise import BROKEN, Limits, OurDesign, minimum, our_design, score
from rigctl.design.plant_family import nominal
from rigctl.design.surrogate import CaseErrors, OurLaw, TickedLaw, play, scenarios

Rig = Callable[..., RigSettings]
TWO = (Knob("a", 0.01, 100.0), Knob("b", 0.01, 100.0))


def bowl(values: Sequence[float]) -> float:
    """Least at (3, 0.2), with a wall on the way from (1, 1)."""
    a, b = values
    if a > 5.0 * b and a < 2.0:
        return BROKEN + a
    return math.log(a / 3.0) ** 2 + 0.5 * math.log(b / 0.2) ** 2


def test_few_evaluations_stay_near_the_start() -> None:
    (a, b), called = minimum(bowl, TWO, (2.5, 0.3), evaluations=40)
    assert (a, b) == pytest.approx((3.0, 0.2), rel=0.1)
    assert called <= 40 + 6  # in whole generations


@pytest.mark.parametrize("start", [None, (1.0, 1.0), (1000.0, 1.0)])
def test_the_minimum_is_found_behind_a_limit_from_anywhere(start: tuple[float, float] | None) -> None:
    (a, b), called = minimum(bowl, TWO, start, evaluations=250)
    assert (a, b) == pytest.approx((3.0, 0.2), rel=0.05)
    assert called <= 300
    assert minimum(bowl, TWO, start, evaluations=250) == ((a, b), called)  # the same seed, the same search


@pytest.mark.parametrize(
    "cost", [lambda _: 1.0, lambda values: values[0], lambda _: BROKEN], ids=["flat", "end", "none"]
)
@pytest.mark.parametrize("count", [1, 3])
def test_a_flat_cost_and_an_optimum_at_an_end_end_in_a_value(
    cost: Callable[[Sequence[float]], float], count: int
) -> None:
    knobs = [Knob(name, 0.01, 0.9) for name in "abc"[:count]]
    values, called = minimum(cost, knobs, (0.5,) * count, evaluations=60 * count)
    assert all(0.01 <= value <= 0.9 for value in values)
    assert called <= 60 * count + 24
    if cost((0.2,)) == 0.2:
        assert values[0] == 0.01


def test_the_values_are_rounded_before_they_are_judged() -> None:
    seen: list[Sequence[float]] = []

    def cost(values: Sequence[float]) -> float:
        seen.append(values)
        return bowl(values)

    best, _ = minimum(cost, TWO, (1.0, 1.0), evaluations=60)
    assert best in seen
    assert all(value == float(f"{value:.3g}") for values in seen for value in values)


def test_every_knob_is_a_setting_that_the_design_follows(rig: Rig) -> None:
    for knob in KNOBS:
        value = float(value_of(rig(), knob.key))
        assert knob.low < value < knob.high
        other = turned(rig(), [knob], [value * 1.5])
        assert value_of(other, knob.key) == value * 1.5
        model, before = (design(s) for s in (other, rig()))
        law = knob.key.startswith("design.")
        assert (model != before) == law


class Fake:
    """A judged law with these figures; it is never run beyond a limit."""

    response: Response | None = None

    def __init__(self, ms: float, noise: float, made: TickedLaw | None = None) -> None:
        self.ms, self.command_noise_mm_s, self._made = ms, noise, made

    def law(self) -> TickedLaw:
        assert self._made is not None
        return self._made


def test_a_law_beyond_a_limit_is_worse_than_any_within_and_the_worse_the_farther(rig: Rig) -> None:
    settings = rig()
    limits, cases = Limits.of(settings), LinearCases(settings)
    assert (limits.ms, limits.command_noise_mm_s) == (1.6, 0.5)
    good = score(settings, Fake(1.59, 0.49, OurLaw(settings, design(settings))), limits, cases)
    assert good.within
    beyond = [score(settings, Fake(*figures), limits, cases).cost for figures in ((1.61, 0.4), (1.9, 0.4), (1.9, 0.9))]
    assert BROKEN < beyond[0] < beyond[1] < beyond[2] < 2.0 * BROKEN
    assert score(settings, Fake(math.inf, 0.4), limits, cases).cost == 2.0 * BROKEN
    assert score(settings, None, limits, cases).cost == 3.0 * BROKEN
    restless = score(settings, Fake(1.5, 0.4, OurLaw(settings, design(settings))), Limits(1.6, 0.5, 0.01), cases)
    assert not restless.within


def test_the_search_improves_on_the_files_weights_within_every_limit(rig: Rig) -> None:
    settings = rig()
    family = plant_family.Family("two", (nominal(settings), plant_family.member(settings, None, 1.2, 2)))
    counted = 0

    def advance() -> None:
        nonlocal counted
        counted += 1

    found, best = optimise.weights(settings, family, evaluations=60, advance=advance)
    assert counted >= best.evaluations
    assert best.start is not None
    assert best.start.within
    assert best.ratio is not None
    assert best.ratio < 0.97
    judged = our_design(found, family)
    assert isinstance(judged, OurDesign)
    assert judged.ms <= 1.6
    assert judged.command_noise_mm_s <= 0.5
    assert score(found, judged, Limits.of(found), LinearCases(found)) == best.score


def test_weights_out_of_their_bounds_are_no_design(rig: Rig) -> None:
    family = plant_family.Family("one", (nominal(rig()),))
    wild = rig(estimator={"disturbance_walk_mm_s": 9e3})
    assert our_design(wild, family, KNOBS) is None
    assert our_design(rig(), family, KNOBS) is not None


def _played(settings: RigSettings, law: TickedLaw, name: str) -> CaseErrors:
    case = next(case for case in scenarios(settings) if case.name == name)
    return play(settings, law, nominal(settings), case)


def test_at_rest_the_tension_moves_by_the_noise_that_the_design_says(rig: Rig) -> None:
    settings = rig()
    judged = our_design(settings, plant_family.Family("one", (nominal(settings),)))
    assert judged is not None
    assert judged.design.performance is not None
    rest = _played(settings, judged.law(), "rest")
    assert rest.rms_n == pytest.approx(judged.design.performance.tension_noise_n, rel=0.2)  # of one second
    assert rest.command_mm_s == pytest.approx(judged.command_noise_mm_s, rel=0.1)
    assert _played(settings, judged.law(), "rest") == rest


def test_a_jolt_takes_the_law_to_its_limits(rig: Rig) -> None:
    """1 mm at 10 mm/s lasts a tenth of a second: an error that no linear loop would leave."""
    settings = rig()
    fast = rig(tension={"speed_max_mm_s": 60.0, "acceleration_max_mm_s2": 30000.0})
    slow_n, fast_n = (_played(s, OurLaw(s, design(s)), "jolt").rms_n for s in (settings, fast))
    assert slow_n > 1.2 * fast_n


def test_weights_are_those_of_two_settings_where_there_are_so_many(rig: Rig) -> None:
    settings = rig()
    five = tuple(float(value_of(settings, knob.key)) for knob in KNOBS)
    assert with_weights(settings, five) == settings
    pair = with_weights(settings, (*five, 0.2, 3.0))
    assert (pair.estimator.quiet_tension_walk_n, pair.estimator.quiet_disturbance_walk_mm_s) == (0.2, 3.0)
    assert with_weights(pair, (*five, 0.1, 2.0)).estimator.quiet_tension_walk_n == 0.1
