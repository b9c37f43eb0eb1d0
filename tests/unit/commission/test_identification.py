"""The fits against independent signals: a drive integrated in small steps, a rope with play and noise."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rigctl.commission import identification as ident
from rigctl.commission import motion
from rigctl.commission.identification import IdentificationError, TrialSignals
from rigctl.commission.proposal import LAG_SHARE, rounded, signals_of
from rigctl.ipc.record import RECORD

SETTLING_S = 0.05  # a slower drive is far from its speed at the end of a step, and its stated error grows
STEPS = 50  # per tick: the reference is integrated with 20 us


def steps(pairs: int = 6, speed: float = 3.0) -> motion.Array:
    one = [speed] * 250 + [0.0] * 150 + [-speed] * 250 + [0.0] * 150
    return np.array([0.0] * 500 + one * pairs)


def simulated(lag_s: float, delay_s: float, *, noise_mm_s: float = 0.0, play_mm: float = 0.0) -> TrialSignals:
    """Speed and tension (6 N/mm, 0.03 N noise) as a loop reads them: one tick after they were latched."""
    rng, command = np.random.default_rng(7), steps()
    fine = np.repeat(command, STEPS)
    late = np.concatenate([np.zeros(round(delay_s * 1e3 * STEPS)), fine])[: len(fine)]
    speed, speeds, stroke, strokes = 0.0, [], 0.0, []
    share = 1.0 - math.exp(-1e-3 / STEPS / lag_s)
    for value in late.tolist():
        speeds.append(speed)
        strokes.append(stroke)
        stroke += speed * 1e-3 / STEPS
        speed += (value - speed) * share
    latched = [np.concatenate([[0.0], np.array(x)[::STEPS]])[:-1] for x in (speeds, strokes)]
    tension = 15.0 + 6.0 * motion.behind_play(latched[1], play_mm) + rng.normal(0.0, 0.03, len(command))
    return TrialSignals(
        1e-3, command, np.round(latched[1], 3), latched[0] + rng.normal(0.0, noise_mm_s, len(command)), tension
    )


@given(lag_s=st.floats(0.004, SETTLING_S), delay_s=st.floats(0.0, 0.015))
@example(lag_s=0.06, delay_s=0.01172)
@settings(max_examples=8, deadline=None)
def test_lag_and_delay_are_found_between_the_ticks(lag_s: float, delay_s: float) -> None:
    delay_s = round(delay_s * 5e4) / 5e4  # on the reference's own grid
    found = ident.drive(simulated(lag_s, delay_s))
    for estimate, truth in ((found.lag_s, lag_s), (found.delay_s, delay_s)):
        assert abs(estimate.value - truth) <= estimate.error
        # Seven tenths of the position's unit, at this speed; of a slow drive a share, for it does not settle in a step.
        share = 0.05 if lag_s <= SETTLING_S else LAG_SHARE
        assert estimate.error < max(0.7e-3 / 3.0, share * lag_s)
    assert found.gain.value == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("freedom", "point", "share"),
    [(3, 3.1824, 0.02), (6, 2.44691, 1e-3), (13, 2.16037, 1e-4), (30, 2.04227, 1e-5), (1000, 1.96234, 1e-5)],
)
def test_few_pairs_widen_the_uncertainty_as_students_t_says(freedom: int, point: float, share: float) -> None:
    assert ident.student_t(freedom) == pytest.approx(point, rel=share)  # the expansion is in powers of 1 / freedom


def test_a_load_that_comes_steadily_is_neither_stiffness_nor_play() -> None:
    signals = simulated(0.02, 0.002, play_mm=0.05)
    drive = ident.drive(signals)
    rising = replace(signals, tension=signals.tension + 2.0 * np.arange(len(signals.tension)) * signals.period_s)
    found, steady = ident.rope(rising, drive, 0.035), ident.rope(signals, drive, 0.035)
    assert found.stiffness_n_mm.value == pytest.approx(6.0, rel=0.005)
    assert found.stiffness_n_mm.error == pytest.approx(steady.stiffness_n_mm.error, rel=0.2)
    assert found.backlash_mm.value == pytest.approx(0.05, abs=0.003)


def test_the_pitch_error_of_the_screw_widens_what_is_found_of_the_rope() -> None:
    signals = simulated(0.02, 0.002)
    found, reach_mm = ident.rope(signals, ident.drive(signals), 0.035), 0.75
    pitch_mm = 2.0 * ident.PITCH_ERROR_MM * math.sin(math.pi * min(0.5, reach_mm / ident.PITCH_LEAD_MM))
    bound_n_mm = 6.0 * pitch_mm / reach_mm
    assert bound_n_mm < found.stiffness_n_mm.error < bound_n_mm + 0.05
    assert pitch_mm < found.backlash_mm.error < pitch_mm + 0.01


def test_the_standard_errors_cover_the_noise() -> None:
    found = ident.drive(simulated(0.02, 0.002, noise_mm_s=0.1))
    for estimate, truth in ((found.lag_s, 0.02), (found.delay_s, 0.002), (found.gain, 1.0)):
        assert estimate.error > 0.0
        assert abs(estimate.value - truth) < estimate.error


@pytest.mark.parametrize("late_ticks", [0, 3])
def test_the_age_of_the_speed_is_what_it_comes_later_than_the_stroke(late_ticks: int) -> None:
    signals = simulated(0.02, 0.002)
    late = np.concatenate([np.zeros(late_ticks), signals.speed])[: len(signals.speed)]
    found = ident.drive(replace(signals, speed=late))
    assert found.speed_age_s.value == pytest.approx(late_ticks * 1e-3, abs=2e-5)
    assert found.speed_age_s.error < 1e-4
    assert np.abs(found.stroke - signals.stroke).max() < 2e-3  # the fit is the measured stroke without its rounding


@pytest.mark.parametrize("play_mm", [0.0, 0.05, 0.3])
def test_stiffness_and_play_are_told_apart(play_mm: float) -> None:
    signals = simulated(0.02, 0.002, play_mm=play_mm)
    found = ident.rope(signals, ident.drive(signals), 0.035)
    assert found.stiffness_n_mm.value == pytest.approx(6.0, rel=0.005)
    assert found.backlash_mm.value == pytest.approx(play_mm, abs=0.003)


def test_the_first_pair_counts_for_nothing_since_its_play_is_unknown() -> None:
    signals = simulated(0.02, 0.002, play_mm=0.05)
    drive = ident.drive(signals)
    tension, end = signals.tension.copy(), ident.pairs_of(signals.command)[0].stop
    tension[:end] += 5.0 * np.sin(np.arange(end))
    assert ident.rope(replace(signals, tension=tension), drive, 0.035) == ident.rope(signals, drive, 0.035)


def test_noise_is_what_is_quicker_than_a_tenth_of_a_second() -> None:
    time = np.arange(1000) * 1e-3
    swing = 0.2 * np.sin(2.0 * math.pi * 0.4 * time)
    found = ident.noise(swing + np.random.default_rng(3).normal(0.0, 0.03, 1000), 1e-3)
    assert found.value == pytest.approx(0.03, rel=0.1)  # three standard errors
    assert found.error == pytest.approx(2.0 * 0.03 / math.sqrt(2000), rel=0.1)


@pytest.mark.parametrize(("skipped", "told"), [(1, True), (10, True), (11, False)])
def test_what_the_loop_did_not_see_is_no_measurement(skipped: int, told: bool) -> None:
    records = np.zeros(1000, RECORD.dtype)
    records["seq"], records["t_ns"] = np.arange(1, 1001), np.arange(1000) * 1_000_000
    records["t_ns"][500:] += skipped * 1_000_000
    refused = pytest.raises(IdentificationError, match=f"skip {skipped} periods during the excitation: repeat it")
    with contextlib.nullcontext() if told else refused:
        assert len(signals_of(records, 1e-3).tension) == 1000 + skipped


@pytest.mark.parametrize("command", [np.zeros(1000), steps(pairs=2)])
def test_too_little_is_said(command: motion.Array) -> None:
    with pytest.raises(IdentificationError):
        ident.pairs_of(command)
    with pytest.raises(IdentificationError):
        ident.noise(command[:20], 1e-3)


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [(5.9412, 0.0019, ("5.9412", "0.0019")), (20.0, 0.5, ("20.00", "0.50")), (123.4, 25.0, ("123", "25"))],
)
def test_a_value_is_shown_to_its_error(value: float, error: float, shown: tuple[str, str]) -> None:
    assert rounded(value, error) == shown
