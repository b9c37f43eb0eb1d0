"""Tracks of prescribed moves: a trapezoid out, a stop, a trapezoid back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.plant import kernel
from hil.plant.inputs import Track, pack
from hil.plant.layout import MECHANISM
from hil.plant.moves import out_and_back

POSITIVE = st.floats(0.01, 5.0)


def at(move: Track, t_s: float) -> tuple[float, float, float]:
    """Angle, speed and acceleration, as the plant evaluates them."""
    found: tuple[float, float, float] = kernel.profile(pack({MECHANISM: move}), MECHANISM, t_s)
    return found


def test_paper_move_takes_26_s_of_cruise_each_way_plus_the_ramp() -> None:
    move = out_and_back(math.radians(13.0), math.radians(0.5), math.radians(0.25))
    assert move.end == pytest.approx(2 * (26.0 + 2.0))
    angle, speed, _ = at(move, 0.5 * move.end)
    assert angle == pytest.approx(math.radians(13.0))
    assert speed == pytest.approx(0.0, abs=1e-12)
    assert at(move, 14.0)[:2] == pytest.approx((math.radians(6.5), math.radians(0.5)))
    assert at(move, 1.0)[2] == pytest.approx(math.radians(0.25))


@given(POSITIVE, POSITIVE, POSITIVE, st.floats(0.001, 0.999))
def test_speed_is_the_slope_of_the_angle_and_keeps_its_limits(
    angle: float, speed: float, acceleration: float, part: float
) -> None:
    move = out_and_back(angle, speed, acceleration)
    t_s, h = part * move.end, 1e-6 * move.end
    before, here, after = at(move, t_s - h), at(move, t_s), at(move, t_s + h)
    slope = (after[0] - before[0]) / (2 * h)
    assert slope == pytest.approx(here[1], abs=2 * acceleration * h + 1e-8)  # a ramp bends within h
    assert abs(here[1]) <= speed * (1 + 1e-9)
    assert abs(here[2]) <= acceleration * (1 + 1e-9)
    assert abs(after[1] - before[1]) <= 2 * acceleration * h * (1 + 1e-6) + 1e-12
    assert -1e-9 <= here[0] <= angle * (1 + 1e-9)


@given(POSITIVE, POSITIVE, POSITIVE, st.floats(0.0, 0.5))
def test_way_back_mirrors_the_way_out(angle: float, speed: float, acceleration: float, part: float) -> None:
    move = out_and_back(angle, speed, acceleration)
    out, back = at(move, part * move.end), at(move, (1 - part) * move.end)
    assert back[0] == pytest.approx(out[0], abs=1e-9)
    assert back[1] == pytest.approx(-out[1], abs=1e-9)


def test_a_short_angle_is_a_triangle_that_never_reaches_the_speed() -> None:
    move = out_and_back(0.01, 1.0, 0.01)
    assert at(move, 0.25 * move.end)[:2] == pytest.approx((0.005, 0.01))
    assert at(move, 0.5 * move.end)[0] == pytest.approx(0.01)


def test_it_rests_before_and_after() -> None:
    move = out_and_back(0.1, 0.1, 0.1, start_s=2.0)
    assert at(move, 1.0) == at(move, move.end + 1.0) == (0.0, 0.0, 0.0)
    assert move.end == 6.0
