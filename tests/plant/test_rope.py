"""Tension: slack, damping, the paper's disturbance k v tau, and what a compliant mechanism makes of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.plant import Plant
from hil.plant.inputs import Track
from hil.plant.layout import HEIGHT, MECHANISM
from hil.plant.moves import out_and_back
from tests.plant.bench import SETTINGS, K, S, build, loaded, look, ramp, rig, tone

UNDAMPED = {"rope": {"damping_n_s_mm": 0.0}}


def test_spring_and_rope_are_in_series() -> None:
    """Equation (17)."""
    assert pytest.approx(1.0 / (1.0 / 6.0 + 1.0 / 1000.0)) == K
    assert loaded().parameters[0]["stiffness"] == K


def test_more_lag_is_more_tension_by_the_stretch_of_the_rope() -> None:
    plant = loaded()
    plant.start_motion({MECHANISM: out_and_back(*map(math.radians, (13.0, 0.5, 0.25)))}, 0)
    worst = max(look(plant, 25.0), key=lambda truth: truth.tension_n)
    across, outwards = 1800.0 * math.tan(worst.tangential_rad), 1800.0 * math.tan(worst.normal_rad)
    stretch = math.hypot(1800.0, across, outwards) - 1800.0
    assert worst.tension_n - 300.0 == pytest.approx(K * stretch, rel=0.02)  # damping adds a little
    cosine = math.cos(worst.tangential_rad) * math.cos(worst.normal_rad)
    assert worst.vertical_n == pytest.approx(worst.tension_n * cosine, rel=1e-9)
    assert 300.0 < worst.vertical_n < 303.0


def test_a_slack_rope_pulls_with_exactly_nothing() -> None:
    plant = build()
    plant.set_drive(-5.0, braked=False)
    plant.advance(S)
    plant.start_motion({MECHANISM: out_and_back(*map(math.radians, (1.0, 0.5, 0.25)))}, plant.t_ns)
    seen = list(look(plant, 8.0))
    assert {truth.tension_n for truth in seen} == {0.0}
    assert seen[-1].rail_rad == 0.0


def test_a_rope_that_went_slack_tightens_at_the_same_stroke() -> None:
    plant = loaded(UNDAMPED, tension=30.0)
    for velocity in (-10.0, 10.0):
        plant.set_drive(velocity, braked=False)
        for truth in look(plant, plant.t_ns / S + 1.0):
            assert truth.tension_n == pytest.approx(K * max(0.0, truth.stroke_mm - 2.0), abs=1e-9)
    assert plant.truth.tension_n > 20.0


def test_damping_adds_its_share_while_the_rope_is_stretched() -> None:
    fast, slow = (build({"rope": {"damping_n_s_mm": c}}) for c in (0.05, 0.0))
    for plant in (fast, slow):
        plant.set_drive(10.0, braked=False)
        plant.advance(2 * S)
    assert fast.truth.tension_n - slow.truth.tension_n == pytest.approx(0.05 * 10.0)


def test_damping_never_makes_a_rope_push() -> None:
    plant = loaded({"rope": {"damping_n_s_mm": 1.0}}, tension=50.0)
    plant.set_drive(-100.0, braked=False)
    seen = [truth.tension_n for truth in look(plant, 0.2)]
    assert seen[0] > 40.0
    assert min(seen) == 0.0


def test_damping_does_not_pull_on_a_slack_rope() -> None:
    plant = loaded(tension=50.0)
    plant.set_drive(-30.0, braked=False)
    plant.advance(plant.t_ns + S // 2)
    plant.set_drive(100.0, braked=False)
    for truth in look(plant, plant.t_ns / S + 0.3):
        assert (truth.tension_n > 0.0) == (truth.stroke_mm > 2.0)
    assert plant.truth.tension_n > 0.0


@pytest.mark.parametrize("down", [1.0, -1.0])
def test_a_cylinder_that_follows_the_payload_trails_by_k_v_tau(down: float) -> None:
    """The paper's interference tension, section 2.1; the command's delay adds k v Td."""
    speed, lag = 6.3, SETTINGS.plant.cylinder_lag_s
    for delay_scale, late in ((0.0, lag), (1.0, lag + 0.002)):
        plant = loaded(UNDAMPED, {"delay_scale": delay_scale})
        plant.start_motion({HEIGHT: ramp(-down * speed)}, 0)
        plant.set_drive(-down * speed, braked=False)
        plant.advance(S)
        # to rounding and e^-50 of the lag; a delay is rounded to the step whose middle it precedes
        assert plant.truth.tension_n - 300.0 == pytest.approx(down * K * speed * late, rel=1e-6)


def test_while_the_speed_still_rises_the_disturbance_is_that_of_the_speed_a_lag_ago() -> None:
    lag, acceleration = SETTINGS.plant.cylinder_lag_s, 20.0
    plant = loaded(UNDAMPED, {"delay_scale": 0.0})
    plant.start_motion({HEIGHT: _speeding_up(-acceleration)}, 0)
    for i in range(3000):
        plant.set_drive(-acceleration * (i + 0.5) * 1e-4, braked=False)
        plant.advance((i + 1) * 100_000)
    expected = K * acceleration * lag * (0.3 - lag)  # e^-15 of the start is left
    assert plant.truth.tension_n - 300.0 == pytest.approx(expected, rel=1e-4)  # commands are steps of 0.1 ms


def test_tension_trails_a_constant_speed_by_delay_and_lag() -> None:
    plant = build(UNDAMPED)
    plant.set_drive(10.0, braked=False)
    plant.advance(2 * S)
    assert plant.truth.tension_n == pytest.approx(K * (10.0 * (2.0 - 0.002 - 0.02) - 2.0), rel=1e-9)


@pytest.mark.parametrize("stiffness", [20.0, 60.0, 1000.0])
def test_a_compliant_mechanism_is_a_spring_in_series(stiffness: float) -> None:
    plant = build({"mechanism": {"vertical_n_mm": stiffness, "damping_ratio": 0.2}})
    plant.set_drive(10.0, braked=False)
    plant.advance(5 * S)
    plant.set_drive(0.0, braked=False)
    plant.advance(20 * S)  # 20 % damping: e^-75 at the slowest
    truth = plant.truth
    series = 1.0 / (1.0 / K + 1.0 / stiffness)
    assert truth.tension_n == pytest.approx(series * (truth.stroke_mm - 2.0), rel=1e-9)
    assert truth.height_mm == pytest.approx(truth.tension_n / stiffness, rel=1e-9)


def test_a_stiffer_mechanism_comes_closer_to_prescribed_motion() -> None:
    """All axes; ten times the stiffness, a tenth of the difference."""

    def tensions(stiffness: float | None) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        axes = dict.fromkeys(("tangential_n_mm", "normal_n_mm", "vertical_n_mm"), stiffness)
        plant = loaded({"mechanism": axes | {"damping_ratio": 1.0}, "step_us": 20})
        plant.start_motion({MECHANISM: ramp(0.01), HEIGHT: tone(1.0, 2.0)}, 0)
        return np.array([truth.tension_n for truth in look(plant, 1.5)][500:])  # less the jolt of the start

    rigid = tensions(None)
    errors = [np.abs(tensions(stiffness) - rigid).max() for stiffness in (1e3, 1e4, 1e5)]
    assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(10.0, rel=0.1)
    assert errors[2] < 0.002  # N


def test_a_step_too_long_for_the_mechanism_is_refused() -> None:
    with pytest.raises(ValueError, match="step_us: found 100, expected at most"):
        build({"mechanism": {"vertical_n_mm": 900_000.0}})


def test_a_rope_shorter_than_the_stroke_is_refused() -> None:
    with pytest.raises(ValueError, match="rope_length_mm: found 100, expected more than the stroke 125"):
        Plant(rig({"plant": {"rope_length_mm": 100.0}}), 0)


def _speeding_up(acceleration: float) -> Track:
    track = ramp(0.0)
    track.segments[0, 3] = 0.5 * acceleration
    return track
