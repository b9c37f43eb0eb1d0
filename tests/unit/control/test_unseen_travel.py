"""What the stroke has done and the cell has not shown, in newtons."""

from __future__ import annotations

import math

import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.watch.unseen_travel import SHARE, UnseenTravel, frozen_mm
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
K = PAPER.plant.slow_stiffness_n_mm
BOUND_MM = SHARE * 300.0 / K


def with_heave(**values: float) -> RigSettings:
    return PAPER.model_copy(update={"safety": PAPER.safety.model_copy(update=values)})


def look(
    travel: UnseenTravel, stroke_mm: float, tension_n: float = 300.0, *, speed_mm_s: float = 0.0, cosine: float = 1.0,
    judged: bool = False, setpoint_n: float = 300.0,
) -> bool:  # fmt: skip
    """Whether it is beyond its bound."""
    travel.look(stroke_mm, speed_mm_s, tension_n, cosine, setpoint_n, judged=judged)
    return travel.seen.excess_n > 0.0


def started(settings: RigSettings = PAPER, detection_s: float = 10.0) -> UnseenTravel:
    travel = UnseenTravel(settings, detection_s, 1.0)
    assert not look(travel, 10.0)
    return travel


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_stroke_that_the_tension_does_not_show_is_bounded_in_newtons(way: float) -> None:
    travel = started()
    assert not look(travel, 10.0 + 0.99 * way * BOUND_MM)
    assert look(travel, 10.0 + 1.01 * way * BOUND_MM)
    assert travel.seen.unseen_n == pytest.approx(1.01 * SHARE * 300.0)


def test_a_stroke_that_the_tension_shows_is_none() -> None:
    assert not look(started(), 10.0 - 2.0 * BOUND_MM, 300.0 - 2.0 * BOUND_MM * K)


def test_a_stiffness_that_is_off_by_a_fifth_is_none() -> None:
    assert not look(started(), 10.0 + 20.0, 300.0 + 1.19 * 20.0 * K)
    assert look(started(), 10.0 + 20.0, 300.0 + 1.6 * 20.0 * K)


@pytest.mark.parametrize(("share", "taken"), [(0.82, True), (0.84, False)])
def test_a_softer_spring_than_the_tolerance_covers_is_taken_as_it_was_found(share: float, taken: bool) -> None:
    """The tolerance is of the tension, and the stroke of a spring 20 % softer is 25 % longer: down to 60 N, 50 mm."""
    travel, to_mm = started(), 10.0 - 240.0 / (share * K)
    assert look(travel, to_mm, 60.0, setpoint_n=30.0) is taken
    travel.found_stiffness(share * K)
    assert not look(travel, to_mm, 60.0, setpoint_n=30.0)
    assert (travel.stiffness_n_mm < K) is taken


def test_the_lean_of_the_rope_takes_stroke() -> None:
    cosine = math.cos(math.radians(8.0))
    paid_mm = PAPER.plant.rope_length_mm * (1.0 / cosine - 1.0)
    assert paid_mm > 2.0 * BOUND_MM
    assert not look(started(), 10.0 - paid_mm, cosine=cosine)
    assert look(started(), 10.0, cosine=cosine)


def test_the_way_of_a_stop_counts() -> None:
    assert look(started(), 10.0 + 0.95 * BOUND_MM, speed_mm_s=10.0)


def test_a_declared_heave_may_go_unseen_and_a_frozen_cell_behind_it_only_until_the_probe_finds_it() -> None:
    settings = with_heave(heave_mm=20.0, heave_mm_s=0.4)
    assert frozen_mm(settings, 10.0) == pytest.approx(4.0)
    travel = started(settings)
    stroke_mm = 10.0
    for _ in range(20):  # the cell answers
        stroke_mm += 0.4
        assert not look(travel, stroke_mm, judged=True)
    assert look(travel, stroke_mm + 10.0)
    assert frozen_mm(PAPER, 10.0) == 0.0


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_payload_that_moves_as_far_as_declared_does_not_trip(way: float) -> None:
    """Its tension was latched with an error of the law's."""
    travel = UnseenTravel(with_heave(heave_mm=10.0), 10.0, 1.0)
    assert not look(travel, 50.0, 300.0 + 0.3 * way)
    assert not look(travel, 50.0 + 10.0 * way)
    assert look(travel, 50.0 + 10.2 * way)


def test_after_the_end_it_begins_anew() -> None:
    travel = started()
    travel.end()
    assert travel.seen.excess_n == 0.0
    assert not look(travel, 10.0 + 3.0 * BOUND_MM)
