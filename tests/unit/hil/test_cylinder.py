"""The cylinder's imperfections, one at a time, on a slack rope unless the test pulls."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from hil.plant import Plant
from tests.builders.rig_bench import MS, SETTINGS, changed

S = 1_000_000_000
PERFECT = {
    "acceleration_mm_s2": 50_000.0,
    "speed_mm_s": 1000.0,
    "dead_band_mm_s": 0.0,
    "ripple_mm": 0.0,
    "backlash_mm": 0.0,
}
SLACK = {"slack_mm": 500.0}
DELAY_NS = round(SETTINGS.plant.command_delay_s * S)


def cylinder(slack: bool = True, **drive: Any) -> Plant:
    return Plant(changed(simulation={"drive": PERFECT | drive, "rope": SLACK if slack else {}}), 0)


def driven(plant: Plant, velocity_mm_s: float, ms: int) -> list[tuple[float, float, float]]:
    """Motor, stroke and speed after each millisecond."""
    plant.set_drive(velocity_mm_s, braked=False)
    seen = []
    for _ in range(ms):
        plant.advance(plant.t_ns + MS)
        seen.append((float(plant.state[0]["motor"]), plant.truth.stroke_mm, plant.truth.speed_mm_s))
    return seen


def test_after_delay_and_one_lag_it_has_63_percent_of_its_speed() -> None:
    plant = cylinder()
    plant.set_drive(10.0, braked=False)
    plant.advance(DELAY_NS)
    assert plant.truth.speed_mm_s == 0.0
    plant.advance(DELAY_NS + round(SETTINGS.plant.cylinder_lag_s * S))
    assert plant.truth.speed_mm_s == pytest.approx(10.0 * (1 - math.exp(-1)), rel=1e-9)


def test_it_keeps_its_acceleration_limit() -> None:
    speeds = [speed for _, _, speed in driven(cylinder(acceleration_mm_s2=1500.0), 200.0, 100)]
    steps = [after - before for before, after in itertools.pairwise(speeds)]
    assert max(steps) == pytest.approx(1500.0 * 1e-3)
    assert speeds[51] == pytest.approx(1500.0 * (0.052 - 0.002))  # the limit alone, up to 75 mm/s


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_it_keeps_its_speed_limit(sign: float) -> None:
    speeds = [speed for _, _, speed in driven(cylinder(speed_mm_s=30.0), sign * 400.0, 500)]
    assert speeds[-1] == pytest.approx(sign * 30.0)
    assert max(map(abs, speeds)) <= 30.0


def test_commands_within_the_dead_band_do_not_move_it() -> None:
    plant = cylinder(dead_band_mm_s=0.5)
    assert driven(plant, 0.499, 1000)[-1] == (0.0, 0.0, 0.0)
    assert driven(plant, -0.499, 1000)[-1] == (0.0, 0.0, 0.0)
    assert driven(plant, 0.501, 1000)[-1][2] == pytest.approx(0.501)
    assert driven(plant, 0.2, 1000)[-1][2] == pytest.approx(0.0, abs=1e-12)  # the dead band also stops a moving motor


@pytest.mark.parametrize("lead_mm", [5.0, 10.0])
def test_the_screw_adds_its_ripple_once_a_turn(lead_mm: float) -> None:
    plant = cylinder(ripple_mm=0.02, screw_lead_mm=lead_mm)
    driven(plant, 20.0, 500)
    seen = np.array(driven(plant, 20.0, round(2 * lead_mm / 20.0 * 1e3)))  # two turns
    error = seen[:, 1] - seen[:, 0]
    assert error.max() == pytest.approx(0.02, rel=1e-3)
    assert error.min() == pytest.approx(-0.02, rel=1e-3)
    assert np.allclose(error, 0.02 * np.sin(2.0 * math.pi * seen[:, 0] / lead_mm))
    assert np.count_nonzero(np.diff(np.signbit(error))) == pytest.approx(4, abs=1)


def test_without_load_a_reversal_loses_the_play_of_the_nut() -> None:
    plant = cylinder(backlash_mm=0.1)
    up = driven(plant, 5.0, 1000)[-1]
    assert up[0] == up[1]
    driven(plant, 0.0, 500)
    rest_motor, rest_stroke = (driven(plant, 0.0, 1)[-1])[:2]
    back = driven(plant, -5.0, 200)
    inside = [stroke for motor, stroke, _ in back if rest_motor - motor < 0.1]
    assert len(inside) > 10
    assert inside == pytest.approx([rest_stroke] * len(inside), abs=1e-12)
    assert back[-1][1] - back[-1][0] == pytest.approx(0.1)


@pytest.mark.parametrize(("tension_n", "play_mm"), [(300.0, 0.0), (25.0, 0.0), (15.0, 0.1)])
def test_load_above_the_seating_load_closes_the_play(tension_n: float, play_mm: float) -> None:
    plant = cylinder(slack=False, backlash_mm=0.1, seating_load_n=20.0)
    plant.preload(tension_n)
    driven(plant, 2.0, 100)
    motor, stroke, _ = driven(plant, -2.0, 250)[-1]  # 0.3 mm back: 2 N less at most
    assert stroke - motor == pytest.approx(play_mm, abs=1e-9)


def test_play_that_was_open_closes_when_the_rope_is_tensioned() -> None:
    plant = cylinder(slack=False, backlash_mm=0.1, seating_load_n=20.0)
    driven(plant, -5.0, 500)
    assert plant.truth.stroke_mm - plant.state[0]["motor"] == pytest.approx(0.1)
    driven(plant, 10.0, 1500)
    assert plant.truth.tension_n > 50.0
    assert plant.truth.stroke_mm == pytest.approx(float(plant.state[0]["motor"]), abs=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_stroke_ends_at_the_mechanical_stop(sign: float) -> None:
    plant = cylinder(stop_margin_mm=3.0)
    limit = SETTINGS.cylinder.stroke_max_mm if sign > 0 else SETTINGS.cylinder.stroke_min_mm
    driven(plant, sign * 40.0, 5000)
    assert plant.truth.stroke_mm == limit + sign * 3.0
    assert plant.truth.speed_mm_s == 0.0
    assert plant.at_stroke_end
    driven(plant, -sign * 40.0, 500)
    assert not plant.at_stroke_end


def test_the_brake_holds_the_stroke_exactly() -> None:
    plant = cylinder()
    driven(plant, 10.0, 1000)
    plant.set_drive(10.0, braked=True)
    before = plant.truth.stroke_mm
    plant.advance(plant.t_ns + S)
    assert (plant.truth.stroke_mm, plant.truth.speed_mm_s) == (before, 0.0)
