"""The rivals against linear theory: margins, ultimate gain, poles; and the limits they share with our law."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import control
import numpy as np
import pytest

from hil.studies.compare.law_robustness import REST, Robustness, response, robustness, sensitivity, swing
from hil.studies.compare.rivals import LAWS, OURS, PASSIVE
from hil.studies.compare.rivals.adrc import Adrc
from hil.studies.compare.rivals.disturbance_observer import DisturbanceObserver
from hil.studies.compare.rivals.feedback import Feedback, Model, Newest, Rival
from hil.studies.compare.rivals.lqi import Lqi, bryson, kalman_gain
from hil.studies.compare.rivals.pid import STRETCH_LAG_S, PidFeedForward
from hil.studies.compare.rivals.proportional import Proportional, ProportionalIntegral, ultimate
from hil.studies.compare.tuned_laws import NewestSample
from rigctl.control.law.estimator import filter_model
from rigctl.control.law.tension import Estimate, Gains
from rigctl.design.plant_family import Member, member
from tests.builders.rig_bench import SETTINGS

MODEL = Model.of(SETTINGS)
K, DT = MODEL.stiffness_n_mm, MODEL.period_s
PLANT = member(SETTINGS, None)
SPEED_MAX = SETTINGS.tension.speed_max_mm_s
MAKE: dict[str, Callable[[], Feedback]] = {
    "p": lambda: Proportional(MODEL),
    "pi": lambda: ProportionalIntegral(MODEL),
    "pid_ff": lambda: PidFeedForward(MODEL, SPEED_MAX, SETTINGS.plant.rope_length_mm),
    "lqi": lambda: Lqi(SETTINGS),
    "pi_dob": lambda: DisturbanceObserver(MODEL),
    "adrc": lambda: Adrc(MODEL),
}


def at(hz: float) -> np.ndarray:
    return np.array([cmath.exp(2j * math.pi * hz * DT)])


def kicked(feedback: Feedback, plant: Member = PLANT, seconds: float = 3.0) -> np.ndarray:
    kick = np.zeros(round(seconds / DT))
    kick[0] = 1.0
    return swing(plant, feedback, kick)


def test_the_model_has_every_delay_of_the_loop() -> None:
    # A tick from sample to command, the drive's delay, and half a tick for the held command.
    tension, _, _ = PLANT.response(at(5.0))
    sampled = tension[0] / at(5.0)[0]
    s = 2j * math.pi * 5.0
    modelled = K / s * cmath.exp(-MODEL.delay_s * s) / (MODEL.lag_s * s + 1.0)
    assert sampled == pytest.approx(modelled, rel=2e-3)  # of a ZOH at a hundredth of Nyquist


def test_at_the_ultimate_gain_the_loop_keeps_swinging_at_the_ultimate_frequency() -> None:
    gain, w = ultimate(MODEL)
    law = Proportional(MODEL)
    assert law.gain == pytest.approx(0.5 * gain)
    law.gain = gain
    tension = kicked(law)
    early, late = (np.abs(tension[a:b]).max() for a, b in ((500, 1000), (2500, 3000)))
    assert late == pytest.approx(early, rel=0.5)  # the rule's model is in continuous time: half a percent of gain
    crossings = np.flatnonzero(np.diff(np.signbit(tension[1000:])))
    assert math.pi / (np.mean(np.diff(crossings)) * DT) == pytest.approx(w, rel=0.02)


def test_half_of_it_leaves_a_gain_margin_of_two() -> None:
    s = control.tf("s")
    numerator, denominator = control.pade(MODEL.delay_s, 6)
    loop = Proportional(MODEL).gain * K / (s * (MODEL.lag_s * s + 1)) * control.tf(numerator, denominator)
    assert control.margin(loop)[0] == pytest.approx(2.0, rel=1e-3)


def test_a_proportional_law_leaves_what_theory_says_against_a_steady_disturbance() -> None:
    law = Proportional(MODEL)
    tension = swing(PLANT, law, np.full(3000, 0.5))
    assert tension[-1] == pytest.approx(0.5 / law.gain, rel=1e-3)


def test_simc_pi_has_the_gains_of_the_rule() -> None:
    law, theta = ProportionalIntegral(MODEL), 0.0035 + 1.0 / (2.0 * math.pi * 500.0) + 0.01  # with the cell
    assert law.gain == pytest.approx(1.0 / (K * 2.0 * theta))
    assert law.integral_time_s == pytest.approx(8.0 * theta)


@pytest.mark.parametrize("hz", [0.5, 3.0, 20.0])
def test_pi_is_the_transfer_function_it_is_said_to_be(hz: float) -> None:
    law = ProportionalIntegral(MODEL)
    z = at(hz)[0]
    wanted = -law.gain * (1.0 + DT / law.integral_time_s / (z - 1.0)) / z  # the integral acts from the next tick on
    found = response(law, at(hz))
    assert found[0, 0] == pytest.approx(wanted, rel=1e-6)
    assert found[1, 0] == 0.0


@pytest.mark.parametrize("hz", [1.0, 5.0, 20.0])
def test_pid_is_the_series_form_behind_its_filter(hz: float) -> None:
    law = PidFeedForward(MODEL, SPEED_MAX, SETTINGS.plant.rope_length_mm)
    s = 2j * math.pi * hz
    theta = MODEL.delay_s + 0.5 * law.filter_s
    series = 1.0 / (2.0 * K * theta)
    ideal = series * (1.0 + 1.0 / (8.0 * theta * s)) * (law.derivative_time_s * s + 1.0) / (law.filter_s * s + 1.0)
    assert abs(response(law, at(hz))[0, 0] * cmath.exp(s * DT)) == pytest.approx(abs(ideal), rel=0.04)  # sampled


def test_the_ropes_stretch_is_given_way_to_once_and_no_more() -> None:
    law = PidFeedForward(MODEL, SPEED_MAX, 1800.0)
    law.start(REST)
    tilted = REST._replace(tangential_rad=0.012)
    given = sum(law.wanted(tilted) for _ in range(round(10 * STRETCH_LAG_S / DT))) * DT
    assert given == pytest.approx(-1800.0 * (1.0 / math.cos(0.012) - 1.0), rel=1e-3)


def test_lqi_has_the_poles_of_its_riccati_equation_behind_an_observer_of_its_own() -> None:
    model, gains = filter_model(SETTINGS), bryson(SETTINGS)
    f, b = model.f[:2, :2], model.b[:2]
    augmented = np.block([[f, np.zeros((2, 1))], [np.array([[DT, 0.0, 1.0]])]])
    feedback = np.array([[gains.k_tension, gains.k_speed, gains.k_integral]])
    closed = np.abs(np.linalg.eigvals(augmented - np.vstack([b, [[0.0]]]) @ feedback))
    observer = np.abs(np.linalg.eigvals(f @ (np.eye(2) - kalman_gain(SETTINGS))))
    assert closed.max() < 1.0
    assert observer.max() < 1.0
    slowest_s = -DT / math.log(closed.max())
    tension = kicked(Lqi(SETTINGS))
    assert abs(tension[round(12 * slowest_s / DT)]) < 1e-3 * np.abs(tension).max()  # e^-12, and delays and overshoot


def test_the_disturbance_observer_finds_a_steady_disturbance_whatever_is_commanded() -> None:
    with_it = swing(PLANT, DisturbanceObserver(MODEL), np.full(4000, 2.0))
    without = swing(PLANT, ProportionalIntegral(MODEL, 5.0 * 3.0 * MODEL.delay_s), np.full(4000, 2.0))
    assert np.sqrt(np.mean(with_it**2)) < 0.5 * np.sqrt(np.mean(without**2))
    assert abs(with_it[-1]) < 1e-3


def test_adrc_puts_all_poles_of_its_observer_where_the_rule_says() -> None:
    law = Adrc(MODEL)
    l1, l2, l3 = law.observer_gains
    predicted = np.array([[1.0, DT, 0.5 * DT**2], [0.0, 1.0, DT], [0.0, 0.0, 1.0]])
    poles = np.linalg.eigvals((np.eye(3) - np.array([[l1], [l2], [l3]]) @ [[1.0, 0.0, 0.0]]) @ predicted)
    # A triple pole is only found to the cube root of the rounding.
    assert poles == pytest.approx(math.exp(-law.observer_rad_s * DT), abs=1e-4)
    assert law.observer_rad_s == pytest.approx(4.0 * law.bandwidth_rad_s)


@pytest.mark.parametrize("name", sorted(MAKE))
def test_every_law_is_stable_on_its_own_plant_and_keeps_no_error_from_a_passing_disturbance(name: str) -> None:
    tension = kicked(MAKE[name]())
    assert np.abs(tension[-300:]).max() < 1e-3 * np.abs(tension).max()


@pytest.mark.parametrize("name", sorted(set(MAKE) - {"p"}))
def test_every_law_with_an_integral_leaves_no_error_to_a_steady_disturbance(name: str) -> None:
    assert abs(swing(PLANT, MAKE[name](), np.full(4000, 2.0))[-1]) < 1e-3


@pytest.mark.parametrize("name", sorted(MAKE))
def test_the_linear_response_foretells_a_swing(name: str) -> None:
    hz = 3.0
    times = np.arange(6000) * DT
    kick = 0.1 * np.sin(2.0 * math.pi * hz * times)
    sensitive = sensitivity(PLANT, response(MAKE[name](), at(hz)), at(hz))[1, 0]
    locked = PLANT.response(at(hz))[2, 0]
    amplitude = np.abs(swing(PLANT, MAKE[name](), kick)[-1000:]).max()
    assert amplitude == pytest.approx(0.1 * abs(sensitive * locked), rel=0.01)


def test_robustness_is_that_of_the_published_rules_and_ours_is_the_most_robust() -> None:
    found: dict[str, Robustness | None] = {name: robustness(SETTINGS, law) for name, law in LAWS.items()}
    assert found.pop(PASSIVE) is None
    family = {name: r.ms_family for name, r in found.items() if r is not None}
    assert min(family, key=family.__getitem__) == OURS
    own = {name: r.ms for name, r in found.items() if r is not None}
    assert 1.5 < own["pi"] < 2.0  # Skogestad: 1.59 to 1.70 for his models; the half rule raises it
    assert own["p"] > 3.0  # a gain margin of two beside a lag: the known weakness of the rule


@pytest.mark.parametrize("name", sorted(MAKE))
def test_every_law_passes_the_same_limits_and_does_not_wind_up(name: str) -> None:
    sample = NewestSample(100.0)
    law = Rival(SETTINGS, Gains(1.0, 0.5, 2.0), Newest(sample, sample, sample), MAKE[name]())
    law.start_ramp(300.0, 0.0)
    last, step = 0.0, SETTINGS.tension.acceleration_max_mm_s2 * DT
    for i in range(4000):
        sample.tension_n = 100.0 if i < 2000 else 310.0
        sample.speed_mm_s = last
        command = law.compensating(Estimate(sample.tension_n, 0.0, 0.0, 50.0), 1.0)
        assert abs(command) <= SPEED_MAX
        assert abs(command - last) <= step * (1 + 1e-9)
        last = command
        if i == 1999:
            assert command == pytest.approx(SPEED_MAX)
        if i == 2500:
            assert command < 0.0  # half a second after the error has changed its sign
    law.hold(Estimate(310.0, 0.0, 0.0, 50.0))


def test_a_new_ramp_begins_with_nothing_remembered() -> None:
    sample = NewestSample(290.0)
    law = Rival(SETTINGS, Gains(1.0, 0.5, 2.0), Newest(sample, sample, sample), ProportionalIntegral(MODEL))
    law.start_ramp(300.0, 0.0)
    for _ in range(1000):
        law.compensating(Estimate(290.0, 0.0, 0.0, 50.0), 1.0)
    sample.tension_n = 300.0
    law.start_ramp(300.0, 0.0)
    for _ in range(20):  # the acceleration limit brings the last command down
        command = law.compensating(Estimate(300.0, 0.0, 0.0, 50.0), 1.0)
    assert command == pytest.approx(0.0)
