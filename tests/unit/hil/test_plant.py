"""The plant against the figures of ``domain.md``."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from hil.motion import OutAndBack
from hil.plant import STOP_MARGIN_MM, Plant
from hil.truth import Truth
from tests.unit.hil.rig_bench import MS, SETTINGS, changed

S = 1_000_000_000
K = SETTINGS.plant.stiffness_n_mm


def tensioned(stroke_mm: float = 52.4, **sections: dict[str, Any]) -> Plant:
    """At rest with the brake closed, the rope stretched by about ``stroke_mm`` less 2 mm of slack."""
    plant = Plant(changed(**sections), 0)
    plant.set_drive(10.0, braked=False)
    plant.advance(round(stroke_mm / 10.0 * S))
    plant.set_drive(0.0, braked=False)
    plant.advance(plant.t_ns + S)
    plant.set_drive(0.0, braked=True)
    return plant


def turn(plant: Plant, angle_deg: float, speed_deg_s: float, acceleration_deg_s2: float = 0.25) -> list[Truth]:
    """Truth every millisecond of a move out and back."""
    plant.start_motion(OutAndBack(*map(math.radians, (angle_deg, speed_deg_s, acceleration_deg_s2))), plant.t_ns)
    seen = []
    while plant.moving:
        plant.advance(plant.t_ns + MS)
        seen.append(plant.truth)
    return seen


def test_the_rail_sticks_exactly_until_the_rope_stands_at_atan_0_012() -> None:
    seen = turn(tensioned(), 5.0, 0.5)
    rest = list(itertools.takewhile(lambda truth: truth.rail_rad == 0.0, seen))
    per_ms = math.degrees(6.545e-3 / 1800)  # the rope turns this far between two looks at full speed
    assert math.degrees(rest[-1].tangential_rad) == pytest.approx(math.degrees(math.atan(0.012)), abs=2 * per_ms)
    assert len(seen) > len(rest) + 1000


def test_sliding_it_lags_by_dynamic_and_viscous_friction() -> None:
    plant = tensioned(simulation={"stribeck_mm_s": 0.1})
    seen = turn(plant, 60.0, 2.0, 2.0)
    steady = seen[len(seen) // 2 - 3000]  # still at full speed on the way out, transients decayed (exp -1.7 /s)
    speed_m_s = math.radians(2.0) * 0.750
    expected = math.atan(0.008 + 50.0 * speed_m_s / steady.vertical_n)
    assert steady.tangential_rad == pytest.approx(expected, rel=0.005)


def test_the_floor_without_viscous_friction_is_atan_0_008() -> None:
    plant = tensioned(simulation={"stribeck_mm_s": 0.1, "viscous_n_s_m": 0.0, "friction_static": 0.0081})
    seen = turn(plant, 60.0, 2.0, 0.5)
    mean = sum(truth.tangential_rad for truth in seen[10_000:25_000]) / 15_000
    assert math.degrees(mean) == pytest.approx(math.degrees(math.atan(0.008)), rel=0.02)  # swings about it, undamped


def test_reversal_swings_the_lag_to_the_other_side() -> None:
    seen = turn(tensioned(), 13.0, 0.5)
    half = len(seen) // 2
    assert max(t.tangential_rad for t in seen[:half]) == pytest.approx(
        -min(t.tangential_rad for t in seen[half:]), rel=0.02
    )


def test_more_lag_is_more_tension_by_the_stretch_of_the_rope() -> None:
    plant = tensioned()
    pretension = plant.truth.tension_n
    worst = max(turn(plant, 13.0, 0.5), key=lambda truth: truth.tension_n)
    offset = 1800.0 * math.tan(worst.tangential_rad)
    stretch = math.hypot(1800.0, offset) - 1800.0
    assert worst.tension_n - pretension == pytest.approx(K * stretch, rel=0.02)  # damping adds a little
    assert worst.vertical_n == pytest.approx(worst.tension_n * math.cos(worst.tangential_rad), rel=1e-5)
    assert 300.0 < worst.vertical_n < 303.0


def test_a_slack_rope_pulls_with_exactly_nothing() -> None:
    plant = Plant(SETTINGS, 0)
    plant.set_drive(-5.0, braked=False)
    plant.advance(S)
    seen = turn(plant, 1.0, 0.5)
    assert {truth.tension_n for truth in seen} == {0.0}
    assert seen[-1].rail_rad == 0.0


def test_tension_trails_a_constant_speed_by_delay_and_lag() -> None:
    """The paper's disturbance tension k v tau, and k v Td on top."""
    plant = Plant(changed(simulation={"damping_n_s_mm": 0.0}), 0)
    plant.set_drive(10.0, braked=False)
    plant.advance(2 * S)
    expected = K * (10.0 * (2.0 - 0.002 - 0.02) - 2.0)
    assert plant.truth.tension_n == pytest.approx(expected, rel=1e-9)


def test_damping_adds_its_share_while_the_rope_is_stretched() -> None:
    fast, slow = (Plant(changed(simulation={"damping_n_s_mm": c}), 0) for c in (0.05, 0.0))
    for plant in (fast, slow):
        plant.set_drive(10.0, braked=False)
        plant.advance(2 * S)
    assert fast.truth.tension_n - slow.truth.tension_n == pytest.approx(0.05 * 10.0)


def test_damping_never_makes_a_rope_push() -> None:
    plant = tensioned(10.0)
    plant.set_drive(-400.0, braked=False)
    seen = []
    for _ in range(100):
        plant.advance(plant.t_ns + MS)
        seen.append(plant.truth.tension_n)
    assert seen[0] > 40.0
    assert min(seen) == 0.0


def test_damping_does_not_pull_on_a_slack_rope() -> None:
    plant = tensioned(10.0)
    plant.set_drive(-30.0, braked=False)
    plant.advance(plant.t_ns + S // 2)
    plant.set_drive(400.0, braked=False)
    for _ in range(100):
        plant.advance(plant.t_ns + MS)
        assert (plant.truth.tension_n > 0.0) == (plant.truth.stroke_mm > 2.0)
    assert plant.truth.tension_n > 0.0


def test_after_the_move_the_rail_sticks_again() -> None:
    plant = tensioned()
    turn(plant, 5.0, 0.5)
    plant.advance(plant.t_ns + 20 * S)
    resting = plant.truth
    plant.advance(plant.t_ns + S)
    assert plant.truth.rail_rad == resting.rail_rad != 0.0
    assert abs(resting.tangential_rad) < math.atan(0.012)


def test_the_drive_keeps_its_acceleration_limit() -> None:
    plant = Plant(SETTINGS, 0)
    plant.set_drive(400.0, braked=False)
    speeds = []
    for _ in range(60):
        plant.advance(plant.t_ns + MS)
        speeds.append(plant.truth.speed_mm_s)
    steps = [after - before for before, after in itertools.pairwise(speeds)]
    assert max(steps) == pytest.approx(2000.0 * 1e-3)


def test_the_stroke_ends_at_the_mechanical_stop() -> None:
    plant = Plant(changed(simulation={"slack_mm": 500.0}), 0)
    plant.set_drive(40.0, braked=False)
    plant.advance(5 * S)
    assert plant.truth.stroke_mm == SETTINGS.cylinder.stroke_max_mm + STOP_MARGIN_MM
    assert plant.truth.speed_mm_s == 0.0
    assert plant.at_stroke_end
    plant.set_drive(-40.0, braked=False)
    plant.advance(6 * S)
    assert not plant.at_stroke_end


def test_the_brake_holds_the_stroke_exactly() -> None:
    plant = tensioned()
    before = plant.truth.stroke_mm
    plant.set_drive(100.0, braked=True)
    plant.advance(plant.t_ns + S)
    assert (plant.truth.stroke_mm, plant.truth.speed_mm_s) == (before, 0.0)


@given(st.lists(st.integers(1, 3_000_000), max_size=60))
@hypothesis_settings(max_examples=50, deadline=None)
def test_how_advance_is_chopped_up_changes_nothing(chops: list[int]) -> None:
    def run(stops: list[int]) -> Truth:
        plant = Plant(SETTINGS, 0)
        plant.set_drive(20.0, braked=False)
        for stop in sorted({*stops, 200 * MS}):
            if stop > 200 * MS:
                break
            plant.advance(stop)
        plant.start_motion(OutAndBack(0.05, 0.5, 0.9), plant.t_ns)
        plant.set_drive(-3.0, braked=False)
        for stop in stops:
            plant.advance(200 * MS + stop)
        plant.advance(400 * MS)
        return plant.truth

    assert run(list(itertools.accumulate(chops))) == run([])


@pytest.mark.parametrize("stiffness", [20.0, 60.0, 1000.0])
def test_a_compliant_mechanism_is_a_spring_in_series(stiffness: float) -> None:
    plant = tensioned(plant={"mechanism_n_mm": stiffness})
    plant.advance(plant.t_ns + 60 * S)  # 2 % damping: e^-56 at the slowest
    truth = plant.truth
    series = 1.0 / (1.0 / K + 1.0 / stiffness)
    assert truth.tension_n == pytest.approx(series * (truth.stroke_mm - 2.0), rel=1e-6)


def test_a_step_too_long_for_the_mechanism_is_refused() -> None:
    with pytest.raises(ValueError, match="step_us: found 500, allowed at most"):
        Plant(changed(plant={"mechanism_n_mm": 900_000.0}), 0)
