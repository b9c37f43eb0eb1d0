"""The fits against independent signals: a drive integrated in small steps, a rope with play and noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rigctl.commission import identification as ident
from rigctl.commission import motion
from rigctl.commission.identification import Drive, IdentificationError, Rope, TrialSignals
from rigctl.commission.proposal import LAG_SHARE, rounded, signals_of
from rigctl.control.excitation.trials import DITHER
from rigctl.devices.objects import MM_PER_POSITION_UNIT
from rigctl.ipc.record import RECORD

SETTLING_S = 0.05  # a slower drive is far from its speed at the end of a step, and its stated error grows
STEPS = 50  # per tick: the reference is integrated with 20 us


def steps(pairs: int = 6, speed: float = 3.0) -> motion.Array:
    """Each pair a little shorter than the one before, as `Excitation` makes them: the rounding averages out."""
    found = [0.0] * 500
    for number in range(pairs):
        now = speed * (1.0 - DITHER) ** number
        found += [now] * 250 + [0.0] * 150 + [-now] * 250 + [0.0] * 150
    return np.array(found)


def simulated(
    lag_s: float, delay_s: float, *, noise_mm_s: float = 0.0, play_mm: float = 0.0, late: motion.Array | None = None
) -> TrialSignals:
    """Speed and tension (6 N/mm, 0.03 N noise) as a loop reads them: one tick after they were latched.

    ``late``: how long after its grid point each tick sends its SYNC, in steps of the reference.
    """
    rng, command = np.random.default_rng(7), steps()
    sent = np.arange(len(command)) * STEPS + (np.zeros(len(command)) if late is None else late).astype(int)
    fine = np.zeros(len(command) * STEPS)
    for value, begin, end in zip(command, sent, [*sent[1:], len(fine)], strict=True):
        fine[begin:end] = value
    acting = np.concatenate([np.zeros(round(delay_s * 1e3 * STEPS)), fine])[: len(fine)]
    speed, speeds, stroke, strokes = 0.0, [], 0.0, []
    share = 1.0 - math.exp(-1e-3 / STEPS / lag_s)
    for value in acting.tolist():
        speeds.append(speed)
        strokes.append(stroke)
        before, speed = speed, speed + (value - speed) * share
        stroke += 0.5 * (before + speed) * 1e-3 / STEPS
    latched = [np.concatenate([[0.0], np.array(x)[sent]])[:-1] for x in (speeds, strokes)]
    tension = 15.0 + 6.0 * motion.behind_play(latched[1], play_mm) + rng.normal(0.0, 0.03, len(command))
    return TrialSignals(
        sent * (1e-3 / STEPS),
        command,
        np.round(latched[1], 3),
        latched[0] + rng.normal(0.0, noise_mm_s, len(command)),
        tension,
        np.full(len(command), math.nan),
        np.zeros(len(command), bool),
    )


def drive_of(signals: TrialSignals) -> Drive:
    return ident.drive(signals, ident.pairs_of(signals))


def rope_of(signals: TrialSignals, drive: Drive) -> Rope:
    return ident.rope(signals, ident.pairs_of(signals), drive, 0.035)


@given(lag_s=st.floats(0.004, SETTLING_S), delay_s=st.floats(0.0, 0.015))
@example(lag_s=0.06, delay_s=0.01172)
@settings(max_examples=8, deadline=None)
def test_lag_and_delay_are_found_between_the_ticks(lag_s: float, delay_s: float) -> None:
    delay_s = round(delay_s * 5e4) / 5e4  # on the reference's own grid
    found = drive_of(simulated(lag_s, delay_s))
    for estimate, truth in ((found.lag_s, lag_s), (found.delay_s, delay_s)):
        # One of 20 intervals of 95 % misses, and hypothesis looks for it; tests/studies/test_intervals.py counts them.
        assert abs(estimate.value - truth) <= 3.0 * estimate.error
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
    drive = drive_of(signals)
    rising = replace(signals, tension=signals.tension + 2.0 * signals.at_s)
    found, steady = rope_of(rising, drive), rope_of(signals, drive)
    assert found.stiffness_n_mm.value == pytest.approx(6.0, rel=0.005)
    assert found.stiffness_n_mm.error == pytest.approx(steady.stiffness_n_mm.error, rel=0.2)
    assert found.backlash_mm.value == pytest.approx(0.05, abs=0.003)


def test_the_pitch_error_of_the_screw_widens_what_is_found_of_the_rope() -> None:
    signals = simulated(0.02, 0.002)
    found, reach_mm = rope_of(signals, drive_of(signals)), 0.75
    pitch_mm = 2.0 * ident.PITCH_ERROR_MM * math.sin(math.pi * min(0.5, reach_mm / ident.PITCH_LEAD_MM))
    bound_n_mm = 6.0 * pitch_mm / reach_mm
    assert bound_n_mm < found.stiffness_n_mm.error < bound_n_mm + 0.05
    assert MM_PER_POSITION_UNIT <= found.backlash_mm.error < pitch_mm  # which is no play


def test_the_standard_errors_cover_the_noise() -> None:
    found = drive_of(simulated(0.02, 0.002, noise_mm_s=0.1))
    for estimate, truth in ((found.lag_s, 0.02), (found.delay_s, 0.002), (found.gain, 1.0)):
        assert estimate.error > 0.0
        assert abs(estimate.value - truth) < 2.0 * estimate.error  # one of 20 misses


@pytest.mark.parametrize("late_ticks", [0, 3])
def test_the_age_of_the_speed_is_what_it_comes_later_than_the_stroke(late_ticks: int) -> None:
    signals = simulated(0.02, 0.002)
    late = np.concatenate([np.zeros(late_ticks), signals.speed])[: len(signals.speed)]
    found = drive_of(replace(signals, speed=late))
    assert found.speed_age_s.value == pytest.approx(late_ticks * 1e-3, abs=2e-5)
    assert found.speed_age_s.error < 1e-4
    assert np.abs(found.stroke - signals.stroke).max() < 2e-3  # the fit is the measured stroke without its rounding


@pytest.mark.parametrize("play_mm", [0.0, 0.05, 0.3])
def test_stiffness_and_play_are_told_apart(play_mm: float) -> None:
    signals = simulated(0.02, 0.002, play_mm=play_mm)
    found = rope_of(signals, drive_of(signals))
    assert found.stiffness_n_mm.value == pytest.approx(6.0, rel=0.005)
    assert found.backlash_mm.value == pytest.approx(play_mm, abs=0.003)


def test_the_first_pair_counts_for_nothing_since_its_play_is_unknown() -> None:
    signals = simulated(0.02, 0.002, play_mm=0.05)
    drive = drive_of(signals)
    tension, end = signals.tension.copy(), ident.pairs_of(signals).first.stop
    tension[:end] += 5.0 * np.sin(np.arange(end))
    assert rope_of(replace(signals, tension=tension), drive) == rope_of(signals, drive)


def test_noise_is_what_is_quicker_than_a_tenth_of_a_second() -> None:
    time = np.arange(1000) * 1e-3
    swing = 0.2 * np.sin(2.0 * math.pi * 0.4 * time)
    found = ident.noise(swing + np.random.default_rng(3).normal(0.0, 0.03, 1000), 1e-3)
    assert found.value == pytest.approx(0.03, rel=0.1)  # three standard errors
    assert found.error == pytest.approx(2.0 * 0.03 / math.sqrt(2000), rel=0.1)


def test_ticks_that_wake_late_move_nothing() -> None:
    """The drive takes a late command late, and latches late: on a quarter of the ticks, by up to 0.9 ms."""
    rng, count = np.random.default_rng(5), len(steps())
    late = np.where(rng.random(count) < 0.25, rng.uniform(0.0, 0.9 * STEPS, count), 0.0)
    found, prompt = drive_of(simulated(0.02, 0.002, late=late)), drive_of(simulated(0.02, 0.002))
    for estimate, best, truth in ((found.lag_s, prompt.lag_s, 0.02), (found.delay_s, prompt.delay_s, 0.002)):
        assert abs(estimate.value - truth) <= estimate.error
        assert estimate.error < 3.0 * best.error  # few pairs, whose scatter varies


def test_a_pair_in_which_the_loop_skipped_a_tick_is_left_out() -> None:
    signals = simulated(0.02, 0.002)
    third = ident.pairs_of(signals).kept[2]
    stroke, late = signals.stroke.copy(), signals.late.copy()
    stroke[third] += np.where(np.arange(third.stop - third.start) > 40, 0.05, 0.0)  # the drive did as it liked
    late[third.start + 40] = True
    cut = replace(signals, stroke=stroke, late=late)
    pairs = ident.pairs_of(cut)
    assert (len(pairs.kept), pairs.late) == (5, 1)
    assert third not in pairs.kept
    found = drive_of(cut)
    for estimate, truth in ((found.lag_s, 0.02), (found.delay_s, 0.002)):
        assert abs(estimate.value - truth) <= estimate.error < 0.3e-3
    assert abs(drive_of(replace(cut, late=signals.late)).delay_s.value - 0.002) > found.delay_s.error


def test_too_few_pairs_without_a_skipped_tick_are_refused() -> None:
    signals = simulated(0.02, 0.002)
    late = signals.late.copy()
    for where in ident.pairs_of(signals).kept[:3]:
        late[where.start + 40] = True
    why = "^the computer had the loop skip ticks in 3 of 6 repetitions, 4 are needed: repeat it$"
    with pytest.raises(IdentificationError, match=why):
        ident.pairs_of(replace(signals, late=late))


def test_records_give_the_time_of_each_sync_and_where_ticks_were_skipped() -> None:
    records = np.zeros(100, RECORD.dtype)
    records["seq"], records["t_ns"] = np.arange(1, 101), np.arange(100) * 1_000_000
    records["t_ns"][50:] += 3_000_000
    records["lateness_ns"][60], records["work_ns"] = 400_000, 100_000
    signals = signals_of(records, 1e-3)
    assert np.flatnonzero(signals.late).tolist() == [50]
    assert signals.at_s[[0, 50, 60]] == pytest.approx([0.1e-3, 53.1e-3, 63.5e-3])
    assert signals.latched_s[1:] == pytest.approx(signals.at_s[:-1])
    with pytest.raises(IdentificationError, match="records of the excitation are missing"):
        signals_of(np.delete(records, 7), 1e-3)


@pytest.mark.parametrize("command", [np.zeros(1000), steps(pairs=2)])
def test_too_little_is_said(command: motion.Array) -> None:
    some = np.zeros(len(command))
    with pytest.raises(IdentificationError):
        ident.pairs_of(TrialSignals(np.linspace(0.0, 1.0, len(command)), command, some, some, some, some, some > 0.0))
    with pytest.raises(IdentificationError):
        ident.noise(command[:20], 1e-3)


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [(5.9412, 0.0019, ("5.9412", "0.0019")), (20.0, 0.5, ("20.00", "0.50")), (123.4, 25.0, ("123", "25"))],
)
def test_a_value_is_shown_to_its_error(value: float, error: float, shown: tuple[str, str]) -> None:
    assert rounded(value, error) == shown
