"""The speed controller against the load: closed forms, and the same equation integrated in small steps."""

from __future__ import annotations

import math

import pytest

from hil.nodes.speed_loop import IdealSpeedControl, SpeedLoop

MOVED_KG, BANDWIDTH_HZ, MOST_N = 80.0, 27.0, 4500.0
W = 2.0 * math.pi * BANDWIDTH_HZ
INTEGRAL_N_MM = MOVED_KG * 1e-3 * W**2 / 4.0
GRID_S = 1e-3


def carried(loop: SpeedLoop, seconds: float) -> list[float]:
    """Way off the commanded one after each grid step, mm."""
    off, ways = 0.0, []
    for _ in range(round(seconds / GRID_S)):
        off += loop.carry(GRID_S)[0]
        ways.append(off)
    return ways


@pytest.fixture
def loop() -> SpeedLoop:
    return SpeedLoop(MOVED_KG, BANDWIDTH_HZ, MOST_N)


@pytest.mark.parametrize("load_n", [50.0, 350.0])
def test_without_preload_the_load_sinks_by_what_the_integrator_takes(loop: SpeedLoop, load_n: float) -> None:
    loop.take_over(load_n, 0.0)
    ways = carried(loop, 0.5)
    assert ways[-1] == pytest.approx(-load_n / INTEGRAL_N_MM, rel=1e-6)
    assert min(ways) >= ways[-1] - 1e-9  # critically damped: it does not come back up
    assert loop.carry(GRID_S) == (0.0, 0.0)
    assert 0.08 < -ways[-1] < 0.62  # 50 to 350 N at the default values


def test_the_motion_is_that_of_mass_and_controller_integrated_in_small_steps(loop: SpeedLoop) -> None:
    loop.offset_n = 100.0
    loop.take_over(300.0, 0.0)
    mass, gain = MOVED_KG * 1e-3, MOVED_KG * 1e-3 * W
    x = v = 0.0
    h = 1e-6
    for off in carried(loop, 0.06):
        for _ in range(round(GRID_S / h)):
            v += h * (100.0 - gain * v - INTEGRAL_N_MM * x - 300.0) / mass
            x += h * v
        assert off == pytest.approx(x, abs=2e-5)


def test_the_motor_begins_with_its_offset_and_ends_with_the_load(loop: SpeedLoop) -> None:
    loop.offset_n = 40.0
    loop.take_over(300.0, 0.0)
    assert loop.against_brake(300.0) == 40.0
    first = loop.carry(1e-6)[1]
    assert first == pytest.approx(40.0 - 300.0, rel=1e-3)
    carried(loop, 0.5)
    assert loop.against_brake(300.0) == pytest.approx(300.0)
    assert loop.carry(GRID_S)[1] == 0.0


@pytest.mark.parametrize(("share", "sign"), [(1.0, 0), (0.95, -1), (1.05, 1)])
def test_only_the_error_of_a_preload_moves_the_load(loop: SpeedLoop, share: float, sign: int) -> None:
    loop.offset_n = 300.0 * share
    loop.take_over(300.0, 0.0)
    assert carried(loop, 0.5)[-1] == pytest.approx(300.0 * (share - 1.0) / INTEGRAL_N_MM, abs=1e-9)
    assert math.copysign(1.0, share - 1.0) == sign or sign == 0


def test_an_offset_that_changes_under_load_moves_it(loop: SpeedLoop) -> None:
    loop.offset_n = 300.0
    loop.take_over(300.0, 0.0)
    carried(loop, 0.1)
    loop.offset_n = 400.0
    assert carried(loop, 0.5)[-1] == pytest.approx(100.0 / INTEGRAL_N_MM)


def test_a_motor_that_has_the_load_already_does_not_yield_again(loop: SpeedLoop) -> None:
    loop.take_over(300.0, 0.0)
    carried(loop, 0.5)
    loop.take_over(300.0, 0.0)  # the brake closed and opened; the motor stayed on
    assert carried(loop, 0.1)[-1] == pytest.approx(0.0, abs=1e-9)
    loop.switch_off()
    loop.take_over(300.0, 0.0)
    assert carried(loop, 0.5)[-1] < -0.5


def test_friction_of_a_dragging_brake_holds_its_part(loop: SpeedLoop) -> None:
    loop.take_over(300.0, 120.0)
    assert carried(loop, 0.5)[-1] == pytest.approx(-180.0 / INTEGRAL_N_MM)
    loop.switch_off()
    loop.take_over(100.0, 120.0)
    assert carried(loop, 0.5)[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("way_mm", [20.0, -20.0])
def test_a_motor_that_the_brake_holds_winds_up_to_its_peak_torque(loop: SpeedLoop, way_mm: float) -> None:
    for _ in range(100):
        loop.wind_up(way_mm / 100)
    assert loop.against_brake(300.0) == pytest.approx(math.copysign(MOST_N, way_mm))
    loop.wind_up(-way_mm / 100)
    assert abs(loop.against_brake(300.0)) < MOST_N  # it turns back at once


def test_an_ideal_motor_never_yields() -> None:
    ideal = IdealSpeedControl()
    ideal.offset_n = 500.0
    ideal.take_over(300.0, 0.0)
    assert ideal.carry(GRID_S) == (0.0, 0.0)
    assert ideal.against_brake(300.0) == 300.0


@pytest.mark.parametrize("torque_s", [0.005, 0.02])
def test_the_torque_of_the_offset_builds_up_in_its_time(torque_s: float) -> None:
    loop = SpeedLoop(MOVED_KG, BANDWIDTH_HZ, MOST_N, torque_s)
    loop.offset_n = 100.0
    assert loop.against_brake(300.0) == 0.0
    loop.build_up(torque_s / 2.0)
    assert loop.against_brake(300.0) == pytest.approx(50.0)
    loop.build_up(torque_s)
    assert loop.against_brake(300.0) == 100.0
    loop.switch_off()
    assert loop.against_brake(300.0) == 0.0


def test_a_brake_that_opens_before_the_torque_is_there_lets_the_load_sink_meanwhile_and_not_in_the_end() -> None:
    loop = SpeedLoop(MOVED_KG, BANDWIDTH_HZ, MOST_N, 0.02)
    loop.offset_n = 300.0
    loop.take_over(300.0, 0.0)
    off, ways = 0.0, []
    for _ in range(500):
        loop.build_up(GRID_S)
        off += loop.carry(GRID_S)[0]
        ways.append(off)
    assert min(ways) < -0.05
    assert ways[-1] == pytest.approx(0.0, abs=1e-6)
