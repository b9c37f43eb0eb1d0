"""The prescribed move: a trapezoid out, a stop, a trapezoid back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.motion import OutAndBack

POSITIVE = st.floats(0.01, 5.0)


def test_paper_move_takes_26_s_of_cruise_each_way_plus_the_ramp() -> None:
    move = OutAndBack(math.radians(13.0), math.radians(0.5), math.radians(0.25))
    assert move.duration_s == pytest.approx(2 * (26.0 + 2.0))
    angle, speed = move.at(0.5 * move.duration_s)
    assert angle == pytest.approx(math.radians(13.0))
    assert speed == pytest.approx(0.0, abs=1e-12)
    assert move.at(14.0) == pytest.approx((math.radians(6.5), math.radians(0.5)))


@given(POSITIVE, POSITIVE, POSITIVE, st.floats(0.001, 0.999))
def test_speed_is_the_slope_of_the_angle_and_keeps_its_limits(
    angle: float, speed: float, acceleration: float, part: float
) -> None:
    move = OutAndBack(angle, speed, acceleration)
    t_s, h = part * move.duration_s, 1e-6 * move.duration_s
    before, after = move.at(t_s - h), move.at(t_s + h)
    here = move.at(t_s)
    slope = (after[0] - before[0]) / (2 * h)
    assert slope == pytest.approx(here[1], abs=2 * acceleration * h + 1e-8)  # a ramp bends within h
    assert abs(here[1]) <= speed * (1 + 1e-9)
    assert abs(after[1] - before[1]) <= 2 * acceleration * h * (1 + 1e-6) + 1e-12
    assert -1e-9 <= here[0] <= angle * (1 + 1e-9)


@given(POSITIVE, POSITIVE, POSITIVE, st.floats(0.0, 0.5))
def test_way_back_mirrors_the_way_out(angle: float, speed: float, acceleration: float, part: float) -> None:
    move = OutAndBack(angle, speed, acceleration)
    out = move.at(part * move.duration_s)
    back = move.at((1 - part) * move.duration_s)
    assert back[0] == pytest.approx(out[0], abs=1e-9)
    assert back[1] == pytest.approx(-out[1], abs=1e-9)


def test_a_short_angle_is_a_triangle_that_never_reaches_the_speed() -> None:
    move = OutAndBack(0.01, 1.0, 0.01)
    assert move.at(0.25 * move.duration_s) == pytest.approx((0.005, 0.01))
    assert move.at(0.5 * move.duration_s)[0] == pytest.approx(0.01)


def test_it_rests_before_and_after() -> None:
    move = OutAndBack(0.1, 0.1, 0.1)
    assert move.at(-1.0) == move.at(move.duration_s + 1.0) == (0.0, 0.0)
