"""Learning from move to move: the table that a lesson gives, its bounds, and what ends it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from rigctl.config.settings import LearningSettings
from rigctl.control.law.move_learning import MOST_N, TAPER_S, MoveLearning, learning_filter
from rigctl.control.law.tension import Gains, TensionLaw
from rigctl.design.learning_margin import learning_law, low_pass
from rigctl.model.states import Mode
from tests.builders.rig_bench import SETTINGS

Wave = Callable[[float], float]
Floats = npt.NDArray[np.float64]
SECTION = LearningSettings(move_s=20.0, cutoff_hz=2.0, rate=0.5, stroke_max_mm=5.0)
GAINS = Gains(1.3, 0.15, 1.0)
TARGET_N = SETTINGS.tension.target_n
TICK_S = 1.0 / SETTINGS.loop.rate_hz


class Moves:
    """Moves of ``seconds`` with an error given as a function of time since the mark, and the speeds played in them."""

    def __init__(self, **section: float) -> None:
        self.settings = SETTINGS.model_copy(update={"learning": SECTION.model_copy(update=section)})
        self.law = TensionLaw(self.settings, GAINS)
        self.law.rope_setpoint_n = TARGET_N
        self.learning = MoveLearning(self.settings, self.law)
        self.mode = Mode.COMPENSATING

    def tick(
        self,
        error_n: float = 0.0,
        stroke_mm: float = 0.0,
        angle_rad: float = 0.0,
        ticks: int = 1,
        normal_rad: float = 0.0,
    ) -> float:
        return self.learning.step(self.mode, ticks, TARGET_N + error_n, stroke_mm, angle_rad, normal_rad)

    def move(self, error: Wave, seconds: float = 10.0, stroke: Wave = lambda _t: 0.0, number: int = 1) -> Floats:
        """One move, its end marked, and the time that the lesson takes."""
        self.learning.begin(number, stroke(0.0), 0.0, 0.0)
        times = np.arange(round(seconds / TICK_S)) * TICK_S
        played = np.array([self.tick(error(t), stroke(t)) for t in times])
        self.learning.begin(0, 0.0, 0.0, 0.0)
        for _ in range(3000):
            self.tick()
        return played

    def said(self) -> list[str]:
        found = [news.ended for news in self.learning.news]
        self.learning.news.clear()
        return found


def sine(hz: float, amplitude_n: float = 0.02) -> Wave:
    return lambda t: amplitude_n * math.sin(2.0 * math.pi * hz * t)


@pytest.mark.parametrize("hz", [0.3, 1.0, 2.0])
def test_a_lesson_is_the_low_passed_inverse_without_phase(hz: float) -> None:
    moves = Moves()
    moves.move(sine(hz))
    played = moves.move(sine(hz))
    by = learning_filter(moves.settings, GAINS)
    response = low_pass(by, np.array([hz])) * learning_law(by, np.array([hz]))
    # the speed precedes the error by the lead; far from the tapers, over whole periods
    at = np.arange(2000, 2000 + round(math.floor(6.0 * hz) / hz / TICK_S))
    wave = np.exp(-2j * np.pi * hz * (at + by.lead_ticks) * TICK_S)
    found = 2.0 * np.mean(played[at] * wave) * 1j / 0.02
    assert found == pytest.approx(-response[0], rel=0.03)


def test_the_first_move_plays_nothing_and_is_told() -> None:
    moves = Moves()
    assert not moves.move(sine(0.5)).any()
    (news,) = moves.learning.news
    assert (news.number, news.taught, news.ended) == (1, 1, "")
    assert news.rms_n == pytest.approx(0.02 / math.sqrt(2.0), rel=0.02)


def test_a_table_keeps_its_bounds_of_speed_and_stroke_and_begins_and_ends_at_nothing() -> None:
    moves = Moves(speed_max_mm_s=0.1, stroke_max_mm=0.05)
    moves.move(sine(0.2, 5.0))
    played = moves.move(sine(0.2, 5.0))
    assert np.abs(played).max() == pytest.approx(0.1)
    assert np.abs(np.cumsum(played) * TICK_S).max() <= 0.05 * 1.001
    # a step of the command is at most what the tapers and the bound give in a tick
    assert np.abs(np.diff(played, prepend=0.0)).max() <= 0.2 / 10 + 1e-9
    assert abs(played[0]) <= 0.1 * TICK_S / TAPER_S * 1.001
    assert abs(played[-1]) < 0.1 * 20 * TICK_S / TAPER_S


def test_a_stiff_rope_bounds_the_stroke_by_its_force() -> None:
    moves = Moves()
    moves.move(sine(0.2, 30.0))
    played = moves.move(sine(0.2, 30.0))
    most_mm = MOST_N / SETTINGS.plant.stiffness_n_mm
    assert most_mm < SECTION.stroke_max_mm
    assert np.abs(np.cumsum(played) * TICK_S).max() == pytest.approx(most_mm, rel=0.1)


def test_another_stroke_drops_the_table_and_what_was_played_fades() -> None:
    moves = Moves()
    moves.move(sine(0.2, 1.0))
    moves.said()
    played = moves.move(sine(0.2, 1.0), stroke=lambda t: 0.6 if t > 4.0 else 0.0)
    assert np.abs(played[1000:3900]).max() > 0.1
    assert np.abs(np.diff(played)).max() < 0.02
    assert np.abs(played[5500:]).max() < 1e-5
    (why,) = moves.said()
    assert why.startswith("another move from 4.")
    assert not moves.move(sine(0.2, 1.0)).any(), "it begins anew"


@pytest.mark.parametrize(("tangential_rad", "normal_rad"), [(0.02, 0.0), (0.0, 0.02)])
@pytest.mark.parametrize("again", [1.0, 0.0])
def test_a_slope_that_comes_again_is_the_same_move_and_another_is_not(
    tangential_rad: float, normal_rad: float, again: float
) -> None:
    moves = Moves()
    for share in (1.0, again):
        moves.said()
        moves.learning.begin(1, 0.0, 0.0, 0.0)
        for tick in range(8000):
            part = share * min(1.0, tick / 4000)
            moves.tick(0.02, angle_rad=part * tangential_rad, normal_rad=part * normal_rad)
        moves.learning.begin(0, 0.0, 0.0, 0.0)
        for _ in range(3000):
            moves.tick()
    assert any(why.startswith("another move") for why in moves.said()) is (again == 0.0)


def test_another_start_drops_the_table_before_it_is_played() -> None:
    moves = Moves()
    moves.move(sine(0.2))
    moves.said()
    moves.learning.begin(1, 0.0, math.radians(0.4), 0.0)
    assert moves.said() == ["another start: 0.00 mm, 0.40 deg"]
    assert moves.learning.taught == 0


@pytest.mark.parametrize(
    ("mode", "kept"), [(Mode.HOLD, True), (Mode.RELEASING, True), (Mode.FAULT, False), (Mode.DISARMED, False)]
)
def test_another_mode_ends_the_move(mode: Mode, kept: bool) -> None:
    moves = Moves()
    moves.move(sine(0.2, 1.0))
    moves.learning.begin(1, 0.0, 0.0, 0.0)
    for _ in range(2000):
        last = moves.tick()
    assert abs(last) > 0.1
    moves.mode = mode
    played = [moves.tick() for _ in range(2000)]
    if mode is Mode.RELEASING:  # a closed law: what is played fades out
        assert max(abs(np.diff([last, *played]))) < 0.02 * abs(last)
    else:  # the stroke is held: nothing is added
        assert not any(played)
    assert abs(played[-1]) < 1e-5
    moves.mode = Mode.COMPENSATING
    moves.learning.begin(1, 0.0, 0.0, 0.0)
    assert moves.learning.taught == (1 if kept else 0)


@pytest.mark.parametrize("what", ["target", "gains"])
def test_another_target_and_other_gains_end_it(what: str) -> None:
    moves = Moves()
    moves.move(sine(0.2))
    moves.learning.begin(1, 0.0, 0.0, 0.0)
    for _ in range(1000):
        moves.tick()
    moves.said()
    if what == "target":
        moves.law.target_n -= 10.0
    else:
        moves.law.change_gains(Gains(1.0, 0.1, 1.0))
    moves.tick()
    assert moves.said() == ["target or gains have changed"]
    assert moves.learning.number == 0
    moves.learning.begin(1, 0.0, 0.0, 0.0)
    assert moves.learning.taught == 0


def test_the_same_gains_given_again_end_nothing() -> None:
    moves = Moves()
    moves.learning.begin(1, 0.0, 0.0, 0.0)
    moves.tick()
    moves.law.change_gains(Gains(*GAINS.in_order))
    moves.tick()
    assert moves.learning.number == 1


def test_a_table_under_which_the_error_grows_is_dropped() -> None:
    moves = Moves()
    moves.move(sine(0.2, 0.1))
    moves.move(sine(0.2, 0.13))
    assert moves.said()[-1] == "the error has grown"
    assert not moves.move(sine(0.2, 0.1)).any()


def test_moves_are_kept_apart_by_their_numbers() -> None:
    moves = Moves()
    moves.move(sine(0.2, 0.1), number=1)
    assert not moves.move(sine(0.2, 0.1), number=2).any()
    assert moves.move(sine(0.2, 0.1), number=1).any()


def test_a_mark_ends_the_move_before_and_one_that_comes_too_soon_teaches_nothing() -> None:
    moves = Moves()
    moves.learning.begin(1, 0.0, 0.0, 0.0)
    for _ in range(1000):
        moves.tick(0.1)
    moves.learning.begin(2, 0.0, 0.0, 0.0)
    assert moves.said() == ["shorter than 2 s"]
    for _ in range(5000):
        moves.tick(0.1)
    moves.learning.begin(2, 0.0, 0.0, 0.0)
    assert moves.said() == ["marked again before it was worked out"]


def test_what_comes_later_than_the_longest_move_is_not_learnt() -> None:
    moves = Moves(move_s=5.0)
    moves.learning.begin(1, 0.0, 0.0, 0.0)
    for _ in range(5200):
        moves.tick(0.1)
    assert moves.learning.number == 0
    for _ in range(2000):
        moves.tick()
    assert [news.taught for news in moves.learning.news] == [1]


def test_skipped_ticks_advance_the_phase() -> None:
    def move(ticks: int) -> Floats:
        moves = Moves()
        moves.move(sine(0.2, 0.1))
        moves.learning.begin(1, 0.0, 0.0, 0.0)
        return np.array([moves.tick(ticks=ticks) for _ in range(5000 // ticks)])

    assert move(5) == pytest.approx(move(1)[4::5], abs=1e-12)
