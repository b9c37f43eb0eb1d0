"""The law to the digit: the effect of each of its terms, limits and thresholds."""

from __future__ import annotations

import math

import pytest

from rigctl.config import rig_file as config
from rigctl.control.law.tension import Estimate, Gains, TensionLaw
from rigctl.model.states import Flag
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
GAINS = Gains(k_tension=1.5, k_speed=0.5, k_integral=2.0)
K, DT = SETTINGS.plant.stiffness_n_mm, 1e-3
FASTEST = SETTINGS.tension.speed_max_mm_s
STEP = SETTINGS.tension.acceleration_max_mm_s2 * DT
RAMP = SETTINGS.tension.ramp_n_s
SLACK = SETTINGS.tension.slack_n
HIGHEST, LOWEST = SETTINGS.cylinder.stroke_max_mm, SETTINGS.cylinder.stroke_min_mm


def law(setpoint: float | None = None) -> TensionLaw:
    subject = TensionLaw(SETTINGS, GAINS)
    if setpoint is not None:
        subject.begin(setpoint, 0.0)
        subject.target_n = setpoint
    return subject


def at(tension: float, stroke: float = 50.0, speed: float = 0.0, disturbance: float = 0.0) -> Estimate:
    return Estimate(tension, speed, disturbance, stroke)


def test_at_first_nothing_is_commanded_and_the_target_is_the_rig_files() -> None:
    subject = law()
    assert (subject.target_n, subject.setpoint_n, subject.rope_setpoint_n) == (SETTINGS.tension.target_n, 0.0, 0.0)
    assert (subject.integral_mm_s, subject.command_mm_s, subject.limits, subject.rope_lost) == (0.0, 0.0, 0, False)
    subject.follow_speed(1.0)
    subject.change_gains(Gains(9.0, 9.0, 9.0))
    assert subject.integral_mm_s == 0.0, "there were no errors yet"


@pytest.mark.parametrize(
    ("last", "wanted", "command", "limits"),
    [
        (5.0, 5.0, 5.0, 0), (5.0, 5.0 + STEP, 5.0 + STEP, 0), (5.0, 5.0 - STEP, 5.0 - STEP, 0),
        (-5.0, -5.0 + STEP / 2, -5.0 + STEP / 2, 0), (-5.0, -5.0 - STEP / 2, -5.0 - STEP / 2, 0),
        (5.0, 5.1 + STEP, 5.0 + STEP, Flag.LIMITED_ACCELERATION), (5.0, 0.0, 5.0 - STEP, Flag.LIMITED_ACCELERATION),
        (-5.0, 0.0, -5.0 + STEP, Flag.LIMITED_ACCELERATION), (-5.0, -9.0, -5.0 - STEP, Flag.LIMITED_ACCELERATION),
        (FASTEST, FASTEST, FASTEST, 0), (-FASTEST, -FASTEST, -FASTEST, 0),
        (FASTEST, 11.0, FASTEST, Flag.LIMITED_SPEED), (-FASTEST, -11.0, -FASTEST, Flag.LIMITED_SPEED),
        (0.0, 11.0, STEP, Flag.LIMITED_SPEED | Flag.LIMITED_ACCELERATION),
        (5.0, math.nan, 5.0 - STEP, Flag.LIMITED_ACCELERATION), (1.0, math.inf, 1.0 - STEP, 0),
    ],
)  # fmt: skip
def test_the_limits_of_a_command_and_what_is_said_of_them(
    last: float, wanted: float, command: float, limits: int
) -> None:
    subject = law()
    subject.follow_speed(last)
    assert subject.limited(wanted, 50.0) == pytest.approx(max(command, 0.0) if math.isinf(wanted) else command)
    assert subject.command_mm_s == pytest.approx(max(command, 0.0) if math.isinf(wanted) else command)
    if math.isfinite(wanted):
        assert subject.limits == limits


@pytest.mark.parametrize(("given", "taken"), [(3.0, 3.0), (-3.0, -3.0), (99.0, FASTEST), (-99.0, -FASTEST)])
def test_a_moving_drive_is_taken_over_at_its_speed_within_the_limit(given: float, taken: float) -> None:
    subject = law()
    subject.follow_speed(given)
    assert subject.command_mm_s == taken


@pytest.mark.parametrize("left", [0.0005, 0.004, 0.0])
def test_towards_an_end_of_the_stroke_the_speed_is_what_can_still_be_stopped(left: float) -> None:
    fastest = math.sqrt(2.0 * SETTINGS.tension.acceleration_max_mm_s2 * left)
    for stroke, sign in ((HIGHEST - left, 1.0), (LOWEST + left, -1.0)):
        subject = law()
        subject.follow_speed(sign * fastest)
        assert subject.limited(sign * 9.0, stroke) == pytest.approx(sign * fastest)
        assert subject.limits == Flag.LIMITED_STROKE
        subject.follow_speed(-sign * 1.0)
        assert subject.limited(-sign * 1.0, stroke) == -sign * 1.0, "away from the end as ever"
        assert subject.limits == 0


@pytest.mark.parametrize("beyond", [HIGHEST + 1.0, LOWEST - 1.0])
def test_beyond_an_end_the_only_way_is_back(beyond: float) -> None:
    subject, sign = law(), 1.0 if beyond > 0 else -1.0
    assert subject.limited(sign, beyond) == 0.0
    assert subject.limits == Flag.LIMITED_STROKE
    assert subject.limited(-sign, beyond) == -sign


def test_each_term_of_the_law() -> None:
    """u = -w - K_T (T - T_sp) - K_v (v + w) - I, dI/dt = K_i (T - T_sp), within the acceleration limit."""
    subject = law(300.0)
    command = subject.compensating(at(300.2, speed=0.3, disturbance=0.1), 1.0)
    assert command == pytest.approx(-0.1 - 1.5 * 0.2 - 0.5 * 0.4)
    assert subject.integral_mm_s == pytest.approx(2.0 * 0.2 * DT)
    assert subject.compensating(at(300.2, speed=0.3, disturbance=0.1), 1.0) == pytest.approx(command - 2.0 * 0.2 * DT)


def test_the_slope_of_the_ramp_is_fed_forward_in_both_terms_of_speed() -> None:
    subject = law()
    subject.begin(200.0, 2.0)
    subject.follow_speed(2.0)
    subject.target_n = 300.0
    slope = 2.0 * K + 4.0 * RAMP * DT  # eased in 0.25 s
    command = subject.compensating(at(200.0 + slope * DT, speed=2.0), 1.0)
    assert subject.setpoint_n == pytest.approx(200.0 + slope * DT)
    assert command == pytest.approx(slope / K - 0.5 * (2.0 - slope / K))


@pytest.mark.parametrize(
    ("speed", "slope"), [(1.0, K), (-1.0, -K), (99.0, RAMP), (-99.0, -RAMP), (math.nan, 0.0), (math.inf, 0.0)]
)
def test_a_ramp_begins_with_the_slope_the_cylinder_gives_it_within_its_bound(speed: float, slope: float) -> None:
    subject = law()
    subject.begin(100.0, speed)
    subject.target_n = 300.0
    before = subject.setpoint_n
    subject.compensating(at(100.0), 1.0)
    change = (subject.setpoint_n - before) / DT
    assert change == pytest.approx(min(RAMP, slope + 4.0 * RAMP * DT))


def test_a_ramp_begins_at_no_less_than_nothing_and_forgets_what_was() -> None:
    subject = law(300.0)
    subject.compensating(at(301.0, speed=1.0), 1.0)
    assert subject.integral_mm_s != 0.0
    subject.begin(-3.0, 0.0)
    assert (subject.setpoint_n, subject.integral_mm_s) == (0.0, 0.0)
    subject.change_gains(Gains(9.0, 9.0, 9.0))
    assert subject.integral_mm_s == 0.0


def test_hold_forgets_the_integral_and_the_errors() -> None:
    subject = law(300.0)
    subject.compensating(at(301.0, speed=1.0), 1.0)
    subject.hold(at(301.0))
    assert subject.integral_mm_s == 0.0
    subject.change_gains(Gains(9.0, 9.0, 9.0))
    assert subject.integral_mm_s == 0.0


def test_new_gains_take_over_from_both_errors_of_the_last_tick() -> None:
    subject = law(300.0)
    subject.compensating(at(300.2, speed=0.3), 1.0)
    integral = subject.integral_mm_s
    subject.change_gains(Gains(1.0, 0.2, 1.0))
    assert subject.integral_mm_s == pytest.approx(integral + 0.5 * 0.2 + 0.3 * 0.3)


def test_the_integral_takes_in_no_more_than_a_small_stretch() -> None:
    bound = 0.05 * K
    for error in (bound * 0.9, -bound * 0.9, bound * 1.5, -bound * 1.5):
        subject = law(300.0)
        subject.compensating(at(300.0 + error), 1.0)
        assert subject.integral_mm_s == pytest.approx(2.0 * max(-bound, min(bound, error)) * DT)


@pytest.mark.parametrize("error", [5.0, -5.0])
def test_under_a_limit_the_integral_moves_only_back_inside(error: float) -> None:
    subject = law(300.0)
    subject.compensating(at(300.0 + error), 1.0)
    assert subject.limits & Flag.LIMITED_ACCELERATION
    assert subject.integral_mm_s == 0.0, "it would lead further out"
    subject.begin(300.0, 0.0)
    subject.follow_speed(0.0)
    small = math.copysign(0.2, error)
    subject.compensating(at(300.0 + small, disturbance=-math.copysign(9.0, error)), 1.0)
    assert subject.limits & Flag.LIMITED_ACCELERATION
    assert subject.integral_mm_s == pytest.approx(2.0 * small * DT), "it leads back"


def test_the_integral_waits_where_the_drive_is_still_too_fast_for_what_is_wanted() -> None:
    subject = law(300.0)
    subject.follow_speed(9.0)
    subject.compensating(at(300.2), 1.0)
    assert subject.command_mm_s == pytest.approx(9.0 - STEP)
    assert subject.integral_mm_s == 0.0


@pytest.mark.parametrize("cosine", [1.0, 0.9])
def test_tensioned_is_on_the_target_within_half_a_percent(cosine: float) -> None:
    subject = law(300.0)
    assert subject.compensating(at(300.0 / cosine), cosine) == pytest.approx(0.0)
    for error, over in ((1.49, True), (-1.49, True), (1.51, False), (-1.51, False)):
        assert subject.tensioned(at(300.0 / cosine + error)) == over
    subject.target_n = 301.0
    assert not subject.tensioned(at(300.0 / cosine)), "the ramp goes on"


def test_a_rope_that_was_tight_and_is_slack_again_is_lost_and_held() -> None:
    subject = law()
    subject.begin(0.0, 0.0)
    subject.tensioning(at(2.0 * SLACK), 1.0)
    subject.tensioning(at(SLACK - 0.1), 1.0)
    assert not subject.rope_lost, "it was not tight yet"
    subject.tensioning(at(2.0 * SLACK + 0.1), 1.0)
    assert not subject.rope_lost
    subject.tensioning(at(SLACK), 1.0)
    assert not subject.rope_lost
    subject.follow_speed(0.0)
    assert subject.tensioning(at(SLACK - 0.1), 1.0) == 0.0
    assert subject.rope_lost
    subject.begin(0.0, 0.0)
    assert not subject.rope_lost
    assert subject.tensioning(at(SLACK - 0.1), 1.0) > 0.0


def test_a_probe_moves_a_tight_rope_only_and_the_ramp_begins_anew_after_it() -> None:
    subject = law()
    subject.begin(0.0, 0.0)
    assert subject.tensioning(at(SLACK - 0.1), 1.0, 0.7) == pytest.approx(STEP), "slack is taken up as ever"
    subject.follow_speed(0.7)
    assert subject.tensioning(at(60.0, speed=0.7), 0.9, 0.7) == pytest.approx(0.7)
    assert subject.setpoint_n == pytest.approx(54.0)


def test_slack_is_taken_up_no_faster_than_the_ramp_or_the_drive() -> None:
    quick = SETTINGS.model_copy(update={"tension": SETTINGS.tension.model_copy(update={"ramp_n_s": 900.0})})
    for settings, speed in ((SETTINGS, RAMP / K), (quick, FASTEST)):
        subject = TensionLaw(settings, GAINS)
        subject.begin(0.0, 0.0)
        for _ in range(20):
            subject.tensioning(at(0.0), 1.0)
        assert subject.command_mm_s == pytest.approx(speed)


def test_release_pays_out_a_stretch_and_a_millimetre_beyond_slack() -> None:
    subject = law()
    subject.begin(300.0, 0.0)
    assert not subject.slack(at(0.0, -19.0)), "it has not been slack yet"
    subject.releasing(at(300.0, 50.0), 1.0)
    assert subject.setpoint_n < 300.0
    subject.releasing(at(SLACK + 0.1, 4.0), 1.0)
    assert not subject.slack(at(0.0, -19.0))
    subject.follow_speed(0.0)
    assert subject.releasing(at(SLACK, 3.0), 1.0) == pytest.approx(-STEP)
    subject.releasing(at(SLACK + 5.0, 2.9), 1.0)
    enough = 3.0 - (SLACK / K + 1.0)
    assert not subject.slack(at(0.0, enough + 0.01))
    assert subject.slack(at(0.0, enough - 0.01))
    for _ in range(20):
        subject.releasing(at(99.0, 2.0), 1.0)
    assert subject.command_mm_s == pytest.approx(-RAMP / K), "once slack it goes on paying out"
    subject.begin(300.0, 0.0)
    assert not subject.slack(at(0.0, -19.0))


def test_gains_and_estimates_do_not_change() -> None:
    assert GAINS.in_order == (1.5, 0.5, 2.0)
    for value, name in ((GAINS, "k_tension"), (at(1.0), "tension_n")):
        with pytest.raises(AttributeError):
            setattr(value, name, 0.0)
