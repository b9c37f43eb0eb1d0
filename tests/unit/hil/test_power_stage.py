"""Motor and brake: at least one of them always carries the load."""

from __future__ import annotations

import math

import pytest

from hil.nodes.power_stage import STANDSTILL_MM_S, PowerStage, StagePhase

BRAKE_NS = 50_000_000
MS = 1_000_000


@pytest.fixture
def driving() -> PowerStage:
    stage = PowerStage(BRAKE_NS)
    stage.start(0)
    stage.advance(BRAKE_NS, 0.0)
    stage.follow(10.0)
    return stage


def test_the_brake_opens_before_the_motor_follows() -> None:
    stage = PowerStage(BRAKE_NS)
    stage.start(0)
    stage.follow(10.0)
    stage.advance(BRAKE_NS - 1, 0.0)
    assert (stage.phase, stage.braked, stage.velocity_mm_s) == (StagePhase.OPENING, True, 0.0)
    stage.advance(BRAKE_NS, 0.0)
    assert (stage.phase, stage.braked) == (StagePhase.DRIVING, False)


@pytest.mark.parametrize("velocity", [10.0, -10.0])
def test_it_ramps_down_then_waits_for_standstill_then_for_the_brake(driving: PowerStage, velocity: float) -> None:
    driving.follow(velocity)
    driving.stop(100 * MS, 500.0)
    driving.advance(110 * MS, velocity)
    assert driving.velocity_mm_s == pytest.approx(math.copysign(5.0, velocity))
    driving.follow(velocity)  # commands are ignored on the way down
    driving.advance(130 * MS, 2 * STANDSTILL_MM_S)
    assert (driving.phase, driving.velocity_mm_s) == (StagePhase.STOPPING, 0.0)
    driving.advance(200 * MS, 0.5 * STANDSTILL_MM_S)
    assert (driving.phase, driving.braked) == (StagePhase.CLOSING, False)  # the motor still holds
    driving.advance(250 * MS, 0.0)
    assert (driving.phase, driving.braked) == (StagePhase.BRAKED, True)


def test_a_stop_again_does_not_begin_the_ramp_again(driving: PowerStage) -> None:
    driving.stop(100 * MS, 500.0)
    driving.advance(110 * MS, 10.0)
    driving.stop(110 * MS, 1.0)
    driving.advance(120 * MS, 10.0)
    assert driving.velocity_mm_s == 0.0


def test_a_cut_takes_power_off_at_once_and_closes_the_brake_though_it_moves(driving: PowerStage) -> None:
    driving.cut(100 * MS)
    assert (driving.phase, driving.powered, driving.velocity_mm_s) == (StagePhase.FALLING, False, 0.0)
    driving.advance(149 * MS, 10.0)
    assert driving.phase is StagePhase.FALLING
    driving.advance(150 * MS, 10.0)
    assert (driving.phase, driving.braked) == (StagePhase.BRAKED, True)


def test_a_cut_does_not_make_a_closing_brake_begin_again(driving: PowerStage) -> None:
    driving.stop(100 * MS, 1e6)
    driving.advance(101 * MS, 0.0)
    driving.cut(140 * MS)
    driving.advance(151 * MS, 0.0)
    assert driving.phase is StagePhase.BRAKED


def test_a_brake_that_is_closing_opens_again_in_full(driving: PowerStage) -> None:
    driving.stop(100 * MS, 1e9)
    driving.advance(101 * MS, 0.0)
    driving.start(110 * MS)
    phases = []
    for ms in (159, 160):
        driving.advance(ms * MS, 0.0)
        phases.append(driving.phase)
    assert phases == [StagePhase.OPENING, StagePhase.DRIVING]
