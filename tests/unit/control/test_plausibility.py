"""Plausibility of signals against each other, tick by tick on synthetic signals."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable

import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.findings import PlausibilitySeen
from rigctl.control.watch.plausibility import STRETCH_MEMORY_S, Plausibility
from rigctl.model.states import Mode
from tests.builders import inboxes
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
K = SETTINGS.plant.stiffness_n_mm
LAG = SETTINGS.plant.cylinder_lag_s
DELAY = round(SETTINGS.plant.command_delay_s * 1000) + 1
DT = 1e-3
Signal = Callable[[float], float]
DITHER = itertools.cycle((0.0, 0.002))


class Stand:
    """Feeds the signals; the drive is on and the rope tight unless the test changes it."""

    def __init__(self, settings: RigSettings = SETTINGS) -> None:
        self.inbox = inboxes.alone(SETTINGS)
        self.drive_enabled = True
        self.subject = Plausibility(settings)
        self.mode = Mode.COMPENSATING

    def run(
        self, seconds: float, tension: Signal, stroke: Signal = lambda _: 50.0, speed: Signal = lambda _: 0.0,
        command: Signal = lambda _: 0.0, *, slack: bool = False, fresh: Callable[[int], bool] = lambda _: True,
    ) -> list[PlausibilitySeen]:  # fmt: skip
        inbox, seen = self.inbox, []
        for n in range(round(seconds / DT)):
            t = n * DT
            inbox.cell_fresh = inbox.drive_fresh = fresh(n)
            if fresh(n):
                inbox.cell.reading_n = inbox.cell.tension_n = tension(t) + next(DITHER)
                inbox.drive.stroke_mm, inbox.drive.speed_mm_s = stroke(t), speed(t)
            self.look(command(t - DT), slack=slack)
            seen.append(copy.copy(self.subject.seen))
        return seen

    def look(self, command_mm_s: float, ticks: int = 1, *, slack: bool = False) -> None:
        self.subject.look(
            self.inbox, command_mm_s, ticks=ticks, drive_enabled=self.drive_enabled, slack=slack, mode=self.mode
        )


def runaway_mm_s(seen: list[PlausibilitySeen]) -> float:
    return max(one.runaway_mm_s for one in seen)


def turned_back(t: float) -> float:
    """Speed in mm/s of 300 N that a speed controller of 27 Hz on 80 kg takes over: 16 mm/s at most."""
    return -300.0 / 80e-3 * t * math.exp(-84.8 * t)


def as_commanded(lag_s: float = LAG, delay: int = DELAY, level: float = 10.0) -> tuple[Signal, Signal, Signal]:
    """Stroke, speed and command of a step of speed through a drive of this lag, ``delay`` in ticks."""

    def since(t: float) -> float:
        return max(0.0, t - 0.1 - (delay - 1) * DT)

    def speed(t: float) -> float:
        return level * (1.0 - math.exp(-since(t) / lag_s))

    def stroke(t: float) -> float:
        return 50.0 + level * (since(t) - lag_s * (1.0 - math.exp(-since(t) / lag_s)))

    return stroke, speed, lambda t: level if t >= 0.1 else 0.0


def follow(stroke: Signal) -> Signal:
    return lambda t: 300.0 + K * (stroke(t) - 50.0)


def test_a_drive_that_does_as_modelled_shows_nothing() -> None:
    stroke, speed, command = as_commanded()
    seen = Stand().run(1.0, follow(stroke), stroke, speed, command)
    assert max(s.speed_error_mm_s for s in seen) < 0.6
    assert max(abs(s.stroke_error_mm) for s in seen) < 0.03
    assert max(abs(s.contradiction_mm) for s in seen) < 0.03
    assert max(abs(s.unexplained_mm) for s in seen) < 0.01


def test_a_drive_half_as_slow_again_stays_well_below_what_trips() -> None:
    stroke, speed, command = as_commanded(1.5 * LAG)
    seen = Stand().run(1.0, follow(stroke), stroke, speed, command)
    assert 1.0 < max(s.speed_error_mm_s for s in seen) < 2.2
    assert max(abs(s.stroke_error_mm) for s in seen) < 0.2


def test_a_runaway_shows_in_speed_at_once_and_in_stroke_soon() -> None:
    seen = Stand().run(0.2, lambda _t: 300.0, lambda t: 50.0 + 3.0 * t, lambda _t: 3.0)
    assert seen[0].speed_error_mm_s == pytest.approx(3.0)
    assert seen[-1].stroke_error_mm == pytest.approx(3.0 * 0.2, rel=0.15)


def test_a_drive_that_ignores_its_command_shows_the_stroke_it_owes() -> None:
    _, _, command = as_commanded(level=2.0)
    seen = Stand().run(0.6, lambda _t: 300.0, command=command)
    assert seen[-1].speed_error_mm_s == pytest.approx(2.0, abs=0.01)
    assert seen[-1].stroke_error_mm == pytest.approx(-2.0 * (0.5 - LAG - 0.002) * 0.8, rel=0.1)


def test_with_the_drive_off_nothing_is_expected_of_it() -> None:
    stand = Stand()
    stand.drive_enabled = False
    seen = stand.run(0.2, lambda t: 300.0 - 200.0 * t, lambda t: 50.0 + 5.0 * t, lambda _t: 5.0)
    last = seen[-1]
    assert (last.speed_error_mm_s, last.stroke_error_mm, last.unexplained_mm) == (0.0, 0.0, 0.0)
    stand.drive_enabled = True
    assert stand.run(0.002, lambda _t: 300.0, lambda _t: 51.0, lambda _t: 5.0)[0].speed_error_mm_s < 0.5


def test_speed_and_position_that_contradict_each_other_add_up_but_lost_frames_do_not() -> None:
    honest = Stand().run(1.0, lambda _t: 300.0, lambda t: 50.0 + 8.0 * t, lambda _t: 8.0, fresh=lambda n: n % 3 != 1)
    assert max(abs(s.contradiction_mm) for s in honest) < 0.01
    lying = Stand().run(0.2, lambda _t: 300.0, lambda t: 50.0 + 3.0 * t, lambda _t: 0.0)
    assert lying[-1].contradiction_mm == pytest.approx(3.0 * 0.2 * (1 - math.exp(-1)), rel=0.02)


def test_tension_that_no_stroke_explains_is_counted_as_stretch_and_forgotten() -> None:
    stand = Stand()
    seen = stand.run(0.5, lambda t: 300.0 - (60.0 if t > 0.1 else 0.0))
    assert seen[90].unexplained_mm == pytest.approx(0.0, abs=1e-3)
    assert seen[102].unexplained_mm == pytest.approx(-60.0 / K, rel=0.01)
    later = stand.run(STRETCH_MEMORY_S, lambda _t: 240.0)
    assert later[-1].unexplained_mm == pytest.approx(-60.0 / K * math.exp(-0.4 / STRETCH_MEMORY_S - 1), rel=0.02)
    for held in (Mode.HOLD, Mode.FAULT, Mode.DISARMED):
        stand.mode, stand.subject.seen.unexplained_mm = held, 5.0
        stand.run(DT, lambda _t: 240.0)
        assert stand.subject.seen.unexplained_mm == 0.0, "of a held stroke the stretch is latched instead"


def test_stroke_that_the_tension_does_not_show_is_counted_too_but_not_on_a_slack_rope() -> None:
    moving: tuple[Signal, Signal] = lambda t: 50.0 + 10.0 * t, lambda _t: 10.0
    tight = Stand().run(0.5, lambda _t: 300.0, *moving)
    assert tight[-1].unexplained_mm == pytest.approx(-5.0, rel=0.15)
    slack = Stand().run(0.5, lambda _t: 0.0, *moving, slack=True)
    assert slack[-1].unexplained_mm == pytest.approx(0.0, abs=1e-3)


def test_what_a_soft_mechanism_gives_way_by_explains_stroke_but_no_sudden_change() -> None:
    """A slow pull moves the payload too; what changes within a period of the mechanism is stretch as before."""
    soft = changed(SETTINGS, {"plant.mechanism_n_mm": 6.0})
    pull: tuple[Signal, Signal, Signal] = (
        lambda t: 50.0 * t, lambda t: 50.0 + 50.0 * t * (1.0 / K + 1.0 / 6.0), lambda _t: 50.0 * (1.0 / K + 1.0 / 6.0)
    )  # fmt: skip
    assert abs(Stand(soft).run(4.0, *pull)[-1].unexplained_mm) < 1.0  # it lags by its own time constant
    assert Stand().run(4.0, *pull)[-1].unexplained_mm < -10.0
    jolted = Stand(soft)
    jolted.run(0.1, lambda _t: 300.0)
    assert jolted.run(0.005, lambda _t: 330.0)[-1].unexplained_mm == pytest.approx(30.0 / K, rel=0.1)


def test_a_tension_that_goes_in_one_step_is_unexplained_even_though_the_rope_then_is_slack() -> None:
    stand = Stand()
    stand.run(0.1, lambda _t: 300.0)
    seen = stand.run(0.02, lambda _t: 0.0, slack=True)
    assert seen[-1].unexplained_mm == pytest.approx(-300.0 / K, rel=0.02)


def test_equal_samples_in_a_row_are_counted_and_one_other_ends_it() -> None:
    stand = Stand()
    values = [300.0] * 25 + [300.001] + [300.001] * 3
    counts = []
    for value in values:
        stand.inbox.cell_fresh, stand.inbox.drive_fresh = True, False
        stand.inbox.cell.reading_n = stand.inbox.cell.tension_n = value
        stand.look(0.0)
        counts.append(stand.subject.seen.cell_repeats)
    assert counts == [*range(25), 0, 1, 2, 3]


def test_unrest_is_the_mean_step_and_a_spike_alone_counts_little() -> None:
    noisy = Stand().run(0.5, lambda t: 300.0 + (10.0 if round(t / DT) % 2 else -10.0))
    assert noisy[-1].cell_unrest_n == pytest.approx(min(20.0, 150 * 0.03 + K), rel=0.02)
    assert noisy[20].cell_unrest_n > 0.9
    spike = Stand().run(0.5, lambda t: 380.0 if round(t / DT) == 100 else 300.0)
    assert max(s.cell_unrest_n for s in spike) < 0.3


def test_the_rate_of_tension_is_its_slope() -> None:
    seen = Stand().run(0.2, lambda t: 300.0 - 500.0 * t)
    assert seen[-1].tension_rate_n_s == pytest.approx(-500.0, rel=0.05)


def test_ticks_that_were_skipped_are_caught_up() -> None:
    stroke, speed, command = as_commanded()
    stand = Stand()
    for n in range(0, 600, 3):
        t = n * DT
        stand.inbox.cell_fresh = stand.inbox.drive_fresh = True
        stand.inbox.cell.reading_n = stand.inbox.cell.tension_n = follow(stroke)(t) + next(DITHER)
        stand.inbox.drive.stroke_mm, stand.inbox.drive.speed_mm_s = stroke(t), speed(t)
        stand.look(command(t - DT), 3)
        assert stand.subject.seen.speed_error_mm_s < 1.6
        assert abs(stand.subject.seen.stroke_error_mm) < 0.1


@pytest.mark.parametrize("late", [0, 2])
@pytest.mark.parametrize("stopped_ticks", [10, 60, 400])
@pytest.mark.parametrize("at", [110, 130, 300])
def test_a_loop_that_was_stopped_does_not_blame_the_drive_that_went_on(at: int, stopped_ticks: int, late: int) -> None:
    """The tick after the stop reads the sample latched at its end, or does so ``late`` ticks later."""
    stroke, speed, command = as_commanded()
    stand = Stand()
    silent = 0
    for n in [*range(at), *range(at + stopped_ticks, at + stopped_ticks + 300)]:
        ticks = 1 + stopped_ticks if n == at + stopped_ticks else 1
        silent = late if ticks > 1 else silent - 1
        stand.inbox.cell_fresh = stand.inbox.drive_fresh = silent <= 0
        if silent <= 0:
            stand.inbox.cell.reading_n = stand.inbox.cell.tension_n = follow(stroke)(n * DT) + next(DITHER)
            stand.inbox.drive.stroke_mm, stand.inbox.drive.speed_mm_s = stroke(n * DT), speed(n * DT)
        stand.look(command((n - 1) * DT), ticks)
        assert abs(stand.subject.seen.stroke_error_mm) < 0.05
        assert silent > 0 or stand.subject.seen.speed_error_mm_s < 0.6


# -- a motor that the load turns -------------------------------------------------------------------------------------
@pytest.mark.parametrize("level", [10.0, -10.0])
def test_a_speed_that_follows_its_command_late_or_beyond_it_is_no_runaway(level: float) -> None:
    stand = Stand()
    stroke, speed, command = as_commanded(1.5 * LAG, DELAY + 2, level)
    assert runaway_mm_s(stand.run(0.5, lambda _: 300.0, stroke, speed, command)) == 0.0
    back = stand.run(0.5, lambda _: 300.0, speed=lambda t: 1.2 * level * math.exp(-t / (1.5 * LAG)))
    assert runaway_mm_s(back) == 0.0


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_speed_that_grows_beyond_its_command_is_one_within_three_samples(way: float) -> None:
    stand = Stand()
    stand.run(0.2, lambda _: 300.0)
    seen = stand.run(0.01, lambda _: 300.0, speed=lambda t: 4800.0 * way * t)
    assert [one.runaway_mm_s > 2.5 for one in seen[:4]] == [False, False, True, True]


def test_a_command_of_a_second_ago_excuses_no_speed() -> None:
    stand = Stand()
    stroke, speed, command = as_commanded(level=40.0)
    stand.run(0.5, lambda _: 300.0, stroke, speed, command)
    stand.run(1.0, lambda _: 300.0)
    assert runaway_mm_s(stand.run(0.006, lambda _: 300.0, speed=lambda t: 4800.0 * t)) > 20.0


def test_only_while_the_motor_takes_a_load_from_the_brake_may_the_load_turn_it_back() -> None:
    stand = Stand()
    assert runaway_mm_s(stand.run(0.05, lambda _: 300.0, speed=turned_back)) < 2.5
    stand.run(0.2, lambda _: 300.0)
    assert runaway_mm_s(stand.run(0.05, lambda _: 300.0, speed=turned_back)) > 2.5


@pytest.mark.parametrize("count_mm_s", [1.0, 5.0])
def test_a_count_of_a_coarse_encoder_that_toggles_is_no_runaway(count_mm_s: float) -> None:
    toggles = itertools.cycle((0.0, count_mm_s, 0.0, -count_mm_s, -count_mm_s, count_mm_s))
    assert runaway_mm_s(Stand().run(0.3, lambda _: 300.0, speed=lambda _: next(toggles))) == 0.0
