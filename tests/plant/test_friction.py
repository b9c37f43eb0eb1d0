"""Stick, break-away and sliding of rail and pulley."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest

from hil.plant import Plant, kernel
from hil.plant.layout import FLOOR_RADIAL, FLOOR_VERTICAL, MECHANISM
from hil.plant.moves import out_and_back
from hil.truth import Truth
from tests.plant.bench import MS, NO_FRICTION, S, constant, loaded, look, ramp, tone

SLOW_TURN = math.radians(0.5)
PER_MS = 6.545e-3 / 1800.0
"""rad: the rope leans this much more between two looks at full speed."""
GLUED = {"rail": {"friction_static": 1.0, "friction_dynamic": 1.0}}
NO_RIPPLE = {"stribeck_mm_s": 1e-3, "viscous_n_s_m": 0.0}


def turn(plant: Plant, angle_deg: float, speed_deg_s: float, acceleration_deg_s2: float = 0.25) -> list[Truth]:
    """Truth every millisecond of a move out and back."""
    move = out_and_back(*map(math.radians, (angle_deg, speed_deg_s, acceleration_deg_s2)))
    plant.start_motion({MECHANISM: move}, plant.t_ns)
    return list(look(plant, plant.t_ns / S + move.end))


def break_away(plant: Plant) -> Truth:
    """The last moment before the rail moves, the mechanism turning at the paper's speed."""
    plant.start_motion({MECHANISM: ramp(SLOW_TURN)}, plant.t_ns)
    rest = list(itertools.takewhile(lambda truth: truth.rail_rad == 0.0, look(plant, 10.0)))
    assert plant.t_ns < 10 * S
    return rest[-1]


def test_the_rail_sticks_exactly_until_the_rope_stands_at_atan_0_012() -> None:
    assert break_away(loaded()).tangential_rad == pytest.approx(math.atan(0.012), abs=2 * PER_MS)


def test_the_pulley_sticks_to_the_rail_until_the_rope_stands_at_atan_0_012() -> None:
    plant = loaded(GLUED, {"pulley": {"friction_static": 0.012, "friction_dynamic": 0.008}})
    plant.start_motion({FLOOR_RADIAL: ramp(6.545)}, 0)
    rest = list(itertools.takewhile(lambda truth: truth.pulley_mm == 0.0, look(plant, 10.0)))
    assert -rest[-1].normal_rad == pytest.approx(math.atan(0.012), abs=2 * PER_MS)
    assert plant.truth.rail_rad == 0.0


def test_without_viscous_friction_it_slides_at_atan_0_008() -> None:
    plant = loaded({"rail": NO_RIPPLE | {"friction_static": 0.0081}})
    seen = turn(plant, 60.0, 2.0, 0.5)
    mean = sum(truth.tangential_rad for truth in seen[10_000:25_000]) / 15_000
    assert mean == pytest.approx(math.atan(0.008), rel=0.02)  # swings about it, undamped


def test_sliding_it_lags_by_dynamic_and_viscous_friction() -> None:
    plant = loaded({"rail": {"stribeck_mm_s": 0.1}})
    seen = turn(plant, 60.0, 2.0, 2.0)
    steady = seen[len(seen) // 2 - 3000]  # still at full speed on the way out, transients decayed (exp -1.7 /s)
    speed_m_s = math.radians(2.0) * 0.750
    expected = math.atan(0.008 + 50.0 * speed_m_s / steady.vertical_n)
    assert steady.tangential_rad == pytest.approx(expected, rel=0.005)


def test_the_coefficient_falls_with_speed_as_stribeck_has_it() -> None:
    def curve(speed: float) -> float:
        return float(kernel.stribeck(speed, 0.012, 0.008, 10.0))

    assert curve(0.0) == 0.012
    assert curve(10.0) == curve(-10.0) == pytest.approx(0.008 + 0.004 / math.e)
    assert curve(200.0) == 0.008


@pytest.mark.parametrize("speed_mm_s", [5.0, 10.0, 20.0])
def test_sliding_steadily_it_lags_by_the_stribeck_curve(speed_mm_s: float) -> None:
    viscous = 300.0  # N s/m: more than the curve falls, so that steady sliding is stable
    plant = loaded({"rail": {"viscous_n_s_m": viscous}})
    plant.start_motion({MECHANISM: ramp(speed_mm_s / 750.0)}, 0)
    plant.advance(25 * S)
    truth = plant.truth
    expected = kernel.stribeck(speed_mm_s, 0.012, 0.008, 10.0) + viscous * speed_mm_s * 1e-3 / truth.vertical_n
    assert math.tan(truth.tangential_rad) == pytest.approx(expected, rel=1e-3)  # the circle: the rope leans inwards


@pytest.mark.parametrize("part", [0.99, -0.99])
def test_stick_does_not_creep_under_a_vibrating_tension(part: float) -> None:
    plant = loaded()
    lean = math.asin(part * 0.012 * 1800.0 / 750.0)
    plant.start_motion({MECHANISM: constant(lean), FLOOR_VERTICAL: tone(0.5, 7.0)}, 0)
    before = plant.state[0]["phi"]
    assert {truth.rail_rad for truth in look(plant, 60.0, 100 * MS)} == {0.0}
    assert (plant.state[0]["phi"], plant.state[0]["phi_rate"]) == (before, 0.0)


def test_just_above_break_away_it_moves() -> None:
    plant = loaded()
    plant.start_motion({MECHANISM: constant(math.asin(1.01 * 0.012 * 1800.0 / 750.0))}, 0)
    plant.advance(S)
    assert plant.truth.rail_rad > 0.0


def test_friction_grows_with_the_load_of_the_rope() -> None:
    """With no spring the load at break-away is what the lean made of it: 0.012 of 300 N would free the rail sooner."""
    plant = loaded(plant={"spring_n_mm": None})
    at = break_away(plant)
    assert at.tangential_rad == pytest.approx(math.atan(0.012), abs=2 * PER_MS)
    assert at.vertical_n == pytest.approx(300.0 + 1000.0 * 1800.0 * 0.5 * 0.012**2, rel=0.01)  # 430 N, not 380
    peak = max(truth.vertical_n for truth in look(plant, 12.0))
    assert 440.0 < peak < 480.0  # the paper: 455 N


def test_a_dead_load_adds_to_the_friction() -> None:
    at = break_away(loaded({"dead_load_n": 200.0}))
    assert math.tan(at.tangential_rad) * at.vertical_n == pytest.approx(0.012 * (at.vertical_n + 200.0), rel=1e-3)


def test_on_air_bearings_nothing_sticks() -> None:
    plant = loaded({"rail": NO_FRICTION, "pulley": NO_FRICTION})
    plant.start_motion({MECHANISM: ramp(SLOW_TURN)}, 0)
    seen = list(look(plant, 20.0))
    assert seen[0].rail_rad > 0.0
    swing = 6.545 / (2.0 * math.pi / 1.885)  # mm: the rope catches the arm of 15 kg at this amplitude
    assert max(abs(truth.tangential_rad) for truth in seen) == pytest.approx(swing / 1800.0, rel=0.01)
    mean = sum(truth.tangential_rad for truth in seen[:18_850]) / 18_850  # ten periods
    assert abs(mean) < 0.005 * swing / 1800.0


def test_reversal_swings_the_lag_to_the_other_side() -> None:
    seen = turn(loaded(), 13.0, 0.5)
    half = len(seen) // 2
    out, back = max(t.tangential_rad for t in seen[:half]), min(t.tangential_rad for t in seen[half:])
    assert out == pytest.approx(-back, rel=0.02)


def test_after_the_move_the_rail_sticks_again() -> None:
    plant = loaded()
    turn(plant, 5.0, 0.5)
    plant.advance(plant.t_ns + 20 * S)
    resting = plant.truth
    plant.advance(plant.t_ns + S)
    assert plant.truth.rail_rad == resting.rail_rad != 0.0
    assert abs(resting.tangential_rad) < math.atan(0.012)


def test_friction_does_not_push_a_pulley_that_has_crossed_the_shaft() -> None:
    strong: dict[str, Any] = {"friction_static": 0.5, "friction_dynamic": 0.5}
    plant = loaded({"rail": strong, "pulley": GLUED["rail"]}, plant={"radius_mm": 100.0})
    plant.state[0]["r"] = -100.0
    plant.state[0]["phi_rate"] = 1.0
    before = 1.0
    for _ in range(200):
        plant.advance(plant.t_ns + MS)
        assert abs(plant.state[0]["phi_rate"]) <= before
        before = abs(plant.state[0]["phi_rate"])
