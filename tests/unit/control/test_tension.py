"""The law's limits, ramps and bumplessness."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config import rig_file as config
from rigctl.control.law.tension import RAMP_EASE_S, Estimate, Gains, TensionLaw
from rigctl.model.states import Flag
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
GAINS = Gains(k_tension=1.0, k_speed=0.5, k_integral=2.0)
K = SETTINGS.plant.stiffness_n_mm
DT = 1e-3
STEP = SETTINGS.tension.acceleration_max_mm_s2 * DT


def law() -> TensionLaw:
    return TensionLaw(SETTINGS, GAINS)


def at(tension: float, stroke: float = 50.0, speed: float = 0.0, disturbance: float = 0.0) -> Estimate:
    return Estimate(tension, speed, disturbance, stroke)


anything = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(anything, anything, anything, st.floats(-500, 500)), min_size=1, max_size=50))
def test_every_command_is_finite_and_inside_its_limits_whatever_is_estimated(values: list) -> None:  # type: ignore[type-arg]
    subject, last = law(), 0.0
    subject.start_ramp(300.0, 0.0)
    for tension, speed, disturbance, stroke in values:
        command = subject.compensating(Estimate(tension, speed, disturbance, stroke), 1.0)
        assert math.isfinite(command)
        assert abs(command) <= SETTINGS.tension.speed_max_mm_s
        assert abs(command - last) <= STEP * (1 + 1e-9)
        last = command


def test_the_stroke_limit_is_approached_at_a_speed_that_can_still_stop() -> None:
    subject, stroke, commands = law(), 119.0, []
    subject.start_ramp(100.0, 0.0)
    for _ in range(2000):
        command = subject.tensioning(at(0.0, stroke), 1.0)
        commands.append(command)
        stroke += command * DT
    assert stroke <= SETTINGS.cylinder.stroke_max_mm + 0.01
    assert commands[-1] == pytest.approx(0.0, abs=0.05)
    assert subject.limits & Flag.LIMITED_STROKE


def test_a_change_of_gains_leaves_the_command_as_it_is_whatever_the_errors_are() -> None:
    subject = law()
    subject.start_ramp(300.0, 0.0)
    estimate = at(300.4, speed=0.7, disturbance=0.3)
    for _ in range(2000):  # the acceleration limit no longer acts
        before = subject.compensating(estimate, 1.0)
    integrated = GAINS.k_integral * 0.4 * DT
    subject.change_gains(Gains(k_tension=4.0, k_speed=0.1, k_integral=0.5))
    after = subject.compensating(estimate, 1.0)
    assert after == pytest.approx(before, abs=1.01 * integrated)
    subject.compensating(at(300.6, speed=0.7, disturbance=0.3), 1.0)
    assert subject.command_mm_s == pytest.approx(after - 4.0 * 0.2, abs=1e-2), "the new gains are in force"


def test_hold_comes_to_rest_at_the_acceleration_limit_and_stays() -> None:
    subject = law()
    subject.follow_speed(8.0)
    commands = [subject.hold(at(300.0)) for _ in range(100)]
    assert commands[0] == pytest.approx(8.0 - STEP)
    assert commands[-1] == 0.0


def test_slack_is_taken_up_at_a_fixed_speed_then_the_ramp_begins_at_the_tension_there_is() -> None:
    subject = law()
    subject.start_ramp(0.0, 0.0)
    for _ in range(100):
        command = subject.tensioning(at(0.0), 1.0)
    assert command == pytest.approx(SETTINGS.tension.ramp_n_s / K)
    subject.tensioning(at(4.9, speed=command), 1.0)
    subject.tensioning(at(6.0, speed=command), 1.0)
    assert subject.setpoint_n == pytest.approx(4.9 + SETTINGS.tension.ramp_n_s * DT)


@pytest.mark.parametrize(("start", "target"), [(200.0, 300.0), (299.99, 300.0), (300.0, 120.0), (0.0, 300.0)])
def test_the_ramp_eases_in_and_out_is_bounded_and_never_passes_its_target(start: float, target: float) -> None:
    subject = law()
    subject.target_n = target
    subject.start_ramp(start, 0.0)
    setpoints = [start]
    while setpoints[-1] != target:
        subject.compensating(at(setpoints[-1]), 1.0)
        setpoints.append(subject.setpoint_n)
        assert len(setpoints) < 10_000
    slopes = [(b - a) / DT for a, b in itertools.pairwise(setpoints)]
    low, high = sorted((start, target))
    assert all(low <= setpoint <= high for setpoint in setpoints)
    assert max(map(abs, slopes)) <= SETTINGS.tension.ramp_n_s * (1 + 1e-9)
    bends = [abs(b - a) for a, b in zip([0.0, *slopes], slopes, strict=False)]
    assert max(bends[:-1], default=0.0) <= SETTINGS.tension.ramp_n_s / RAMP_EASE_S * DT * (1 + 1e-6)
    assert abs(slopes[-1]) < 1.0


def test_tensioning_is_over_only_on_the_target() -> None:
    subject = law()
    subject.start_ramp(299.99, 0.0)
    for _ in range(50):
        subject.tensioning(at(300.0), 1.0)
    assert subject.tensioned(at(300.0))
    assert not subject.tensioned(at(297.0))


def test_the_setpoint_is_the_vertical_component() -> None:
    subject = law()
    subject.start_ramp(300.0, 0.0)
    cosine = math.cos(math.radians(8.0))
    subject.compensating(at(300.0), cosine)
    assert subject.rope_setpoint_n == pytest.approx(300.0 / cosine)
    assert subject.rope_setpoint_n / 300.0 - 1.0 == pytest.approx(0.0098, abs=1e-4)  # 1 / cos 8 deg: 1 %


def test_the_disturbance_is_fed_forward() -> None:
    subject = law()
    subject.start_ramp(300.0, 0.0)
    for _ in range(200):
        command = subject.compensating(at(300.0, speed=-2.0, disturbance=2.0), 1.0)
    assert command == pytest.approx(-2.0)


def test_nothing_jumps_when_the_loop_is_closed() -> None:
    subject = law()
    subject.start_ramp(300.0, 0.0)
    assert subject.compensating(at(300.0), 1.0) == pytest.approx(0.0)


def test_the_integral_does_not_wind_up_while_limited() -> None:
    subject = law()
    subject.start_ramp(300.0, 0.0)
    for _ in range(5000):
        subject.compensating(at(100.0), 1.0)
    wound = subject.integral_mm_s
    assert abs(wound) < 2 * STEP + GAINS.k_integral * 200 * DT * 100
    for _ in range(200):
        command = subject.compensating(at(310.0), 1.0)
    assert command < 0.0


def test_release_ends_slack_with_rope_to_spare() -> None:
    subject, stroke = law(), 52.0
    tension = 300.0
    subject.start_ramp(tension, 0.0)
    for _ in range(20_000):
        estimate = at(tension, stroke)
        if subject.slack(estimate):
            break
        stroke += subject.releasing(estimate, 1.0) * DT
        tension = max(0.0, K * (stroke - 2.0))
    assert tension == 0.0
    assert -5.0 < stroke < 2.0


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_target_set_just_ahead_of_a_moving_setpoint_is_met_not_passed(direction: float) -> None:
    subject = law()
    subject.start_ramp(200.0, 0.0)
    subject.target_n = 200.0 + 100.0 * direction
    while abs(subject.setpoint_n - 200.0) < 40.0:
        before, _ = subject.setpoint_n, subject.compensating(at(subject.setpoint_n), 1.0)
    step = abs(subject.setpoint_n - before)
    subject.target_n = subject.setpoint_n + 0.6 * step * direction
    subject.compensating(at(subject.setpoint_n), 1.0)
    assert subject.setpoint_n == subject.target_n


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_target_set_just_behind_a_moving_setpoint_is_reached_without_a_jump(direction: float) -> None:
    subject = law()
    subject.start_ramp(200.0, 0.0)
    subject.target_n = 200.0 + 100.0 * direction
    while abs(subject.setpoint_n - 200.0) < 40.0:
        before, _ = subject.setpoint_n, subject.compensating(at(subject.setpoint_n), 1.0)
    last, step = subject.setpoint_n, subject.setpoint_n - before
    subject.target_n = last - 0.6 * step
    subject.compensating(at(last), 1.0)
    assert (subject.setpoint_n - last) / step == pytest.approx(1.0, abs=DT / RAMP_EASE_S + 1e-6)
