"""The trial of a frequency response on a stroke that follows at once: its course, its bounds, its ends."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.control.excitation import frequency_trial
from rigctl.control.excitation.frequency_trial import (
    HELD,
    LONGEST_S,
    PERIOD_S,
    PERIODS,
    REGULATED,
    STRAY_N,
    FrequencyTrial,
)
from rigctl.control.snapshot import Snapshot
from rigctl.model.verbs import Refusal
from tests.unit.control.test_plain_inbox import CONFIG, Bench

RIG = config.load(CONFIG / "paper_rig.yaml")
START_N, START_MM = 300.0, 50.0
Tension = Callable[[float, int], float]  # stretch in mm and tick to what is added to the tension


def played(
    tension: Tension, settings: RigSettings = RIG, *, start_n: float = START_N, regulated: bool = False
) -> tuple[Refusal, np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    """The trial's end, and its ticks: speed wanted, stroke from the start, tension from the start."""
    inbox, rows = Bench(settings).inbox, []
    inbox.cell.tension_n, inbox.drive.stroke_mm = start_n, START_MM
    trial, snapshot, ended = FrequencyTrial(settings, inbox, regulated=regulated), Snapshot(), None
    while ended is None:
        ended = trial.see(inbox, snapshot)
        rows.append((trial.wanted_mm_s, inbox.drive.stroke_mm - START_MM, inbox.cell.tension_n - start_n))
        inbox.drive.stroke_mm += trial.wanted_mm_s / settings.loop.rate_hz
        inbox.cell.tension_n = start_n + tension(inbox.drive.stroke_mm - START_MM, len(rows))
        snapshot.vertical_error_n = inbox.cell.tension_n - start_n
    assert len(rows) < LONGEST_S * settings.loop.rate_hz
    return ended, np.array(rows)


def spring(n_mm: float) -> Tension:
    return lambda stretch_mm, _tick: n_mm * stretch_mm


def test_it_ends_where_it_began_and_measures_whole_periods_at_one_level() -> None:
    ended, ticks = played(spring(6.0))
    assert ended is Refusal.NONE
    assert ticks[-1, 1] == pytest.approx(0.0, abs=1e-6)
    measured, after = frequency_trial.measured_ticks(RIG)
    assert measured == PERIODS * round(PERIOD_S * RIG.loop.rate_hz)
    wave = ticks[len(ticks) - after - measured - 1 : len(ticks) - after - 1, 0].reshape(PERIODS, -1)
    assert np.abs(wave - wave[0]).max() < 1e-6
    assert np.abs(wave).max() == pytest.approx(HELD.share * RIG.tension.speed_max_mm_s, rel=1e-6)  # what limits it here


def test_its_bounds_hold_whatever_the_stiffness() -> None:
    for n_mm in (1.0, 6.0, 34.0, 200.0, 2000.0):
        ended, ticks = played(spring(n_mm))
        assert ended is Refusal.NONE
        assert np.abs(ticks[:, 2]).max() <= max(HELD.tension_n, frequency_trial.FIRST_MM * n_mm) * 1.01
        assert np.abs(ticks[:, 1]).max() <= HELD.stroke_mm * 1.01
        assert np.abs(ticks[:, 0]).max() <= RIG.tension.speed_max_mm_s
        change = np.abs(np.diff(ticks[:, 0])) * RIG.loop.rate_hz
        assert change.max() <= RIG.tension.acceleration_max_mm_s2


def test_a_resonance_far_above_the_rig_files_stiffness_is_felt_before_the_level_is_set() -> None:
    """A rope 20 times as stiff as the file says is not pulled by more than the bound; the last growth is felt first."""
    _, soft = played(spring(6.0))
    ended, stiff = played(spring(120.0))
    assert ended is Refusal.NONE
    assert np.abs(stiff[:, 2]).max() <= HELD.tension_n
    assert np.abs(stiff[-20000:, 2]).max() > 0.6 * frequency_trial.USED_SHARE * HELD.tension_n
    assert np.abs(stiff[:, 1]).max() < np.abs(soft[:, 1]).max()


def test_while_compensating_what_the_tension_answers_sets_the_level() -> None:
    for n_mm in (1.0, 6.0, 34.0):  # of the tension that is left, as a loop that takes away nothing
        ended, ticks = played(spring(n_mm), regulated=True)
        assert ended is Refusal.NONE
        assert np.abs(ticks[:, 2]).max() <= REGULATED.tension_n
        assert np.abs(ticks[:, 0]).max() <= REGULATED.share * RIG.tension.speed_max_mm_s * 1.001


def test_a_cell_that_shows_nothing_ends_it_before_the_level_is_set() -> None:
    draw = np.random.default_rng(3)
    noise = RIG.tension_cell.noise_n * draw.standard_normal(100_000)
    ended, ticks = played(lambda _stretch_mm, tick: float(noise[tick]))
    assert ended is Refusal.UNFELT
    most = HELD.stroke_mm * frequency_trial.FEEL_SHARE * 2.0
    assert np.abs(ticks[:, 1]).max() < most


@pytest.mark.parametrize("swing_n", [0.0, 0.2, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_payload_on_a_soft_support_that_still_swings_is_felt(swing_n: float, seed: int) -> None:
    """A quarter of the rig file's stiffness, right after a motion of the stroke."""
    draw = np.random.default_rng(seed)
    noise = RIG.tension_cell.noise_n * draw.standard_normal(100_000)
    rate = RIG.loop.rate_hz

    def tension(stretch_mm: float, tick: int) -> float:
        swing = math.exp(-tick / (0.7 * rate)) * math.cos(2.0 * math.pi * 2.5 * tick / rate)
        return 1.5 * stretch_mm + swing_n * swing + float(noise[tick])

    ended, ticks = played(tension)
    assert ended is Refusal.NONE
    assert ticks[-1, 1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("regulated", [False, True])
def test_a_tension_that_strays_ends_it_in_that_tick(regulated: bool) -> None:
    bound = (REGULATED if regulated else HELD).tension_n
    leaves = bound + STRAY_N + 1.0
    ended, ticks = played(
        lambda stretch_mm, tick: 2.0 * stretch_mm + (leaves if tick >= 9000 else 0.0), regulated=regulated
    )
    assert ended is Refusal.STRAYED
    assert len(ticks) == 9001


def test_a_stroke_that_strays_ends_it() -> None:
    inbox = Bench(RIG).inbox
    inbox.cell.tension_n, inbox.drive.stroke_mm = START_N, START_MM
    trial = FrequencyTrial(RIG, inbox, regulated=False)
    assert trial.see(inbox, Snapshot()) is None
    inbox.drive.stroke_mm += HELD.stroke_mm + frequency_trial.STRAY_MM + 0.01
    assert trial.see(inbox, Snapshot()) is Refusal.STRAYED


@pytest.mark.parametrize(
    ("stroke_mm", "tension_n"),
    [(119.9, 300.0), (-19.9, 300.0), (50.0, RIG.safety.tension_high_n - 5.0), (50.0, RIG.tension.slack_n)],
)
def test_it_does_not_begin_near_an_end_of_the_stroke_or_a_limit_of_the_tension(
    stroke_mm: float, tension_n: float
) -> None:
    inbox = Bench(RIG).inbox
    inbox.cell.tension_n, inbox.drive.stroke_mm = tension_n, stroke_mm
    trial = FrequencyTrial(RIG, inbox, regulated=False)
    assert trial.see(inbox, Snapshot()) is Refusal.STRAYED
    assert trial.wanted_mm_s == 0.0


def test_a_weakly_tensioned_rope_is_not_slackened() -> None:
    ended, ticks = played(spring(6.0), start_n=25.0)
    assert ended is Refusal.NONE
    assert np.abs(ticks[:, 2]).max() <= frequency_trial.TARGET_SHARE * 20.0
