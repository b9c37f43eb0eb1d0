"""The run-out table: it learns a rail's level from the filter's disturbance speed, and nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rigctl.config.rail_sections import RailEncoderSettings, RunOutSettings
from rigctl.control.law.run_out import STOPPED_S, RunOutTable, stale_ns
from tests.builders import observers
from tests.builders.rig_bench import SETTINGS

SECTION = RunOutSettings(angle_min_deg=0.0, angle_max_deg=20.0, bins=40, learning_rate=0.5)
LEVEL_MM, PERIOD_RAD = 0.3, math.radians(20.0)
RATE = math.radians(3.0)

Slope = Callable[[float, float], float]


def sine(angle_rad: float, _rate: float) -> float:
    """h' of a rail that goes up and down by 0.3 mm over 20 deg, mm/rad."""
    return LEVEL_MM * math.tau / PERIOD_RAD * math.cos(math.tau * angle_rad / PERIOD_RAD)


class Rail:
    """Turns a rail under a table at 1 kHz; the filter is perfect: it finds exactly what the table lacks."""

    def __init__(self, section: RunOutSettings = SECTION, slope: Slope = sine, zero_rad: float = 0.0) -> None:
        self.table = RunOutTable(section, SETTINGS)
        self.angle = 0.0
        self._slope, self._zero = slope, zero_rad
        self.beside: list[float] = []

    def turn(self, angle_deg: float, rate: float = RATE) -> None:
        ticks = round(abs(math.radians(angle_deg)) / rate * 1000)
        self.pass_ticks(ticks, math.copysign(rate, angle_deg) if angle_deg else 0.0)

    def pass_ticks(self, ticks: int, rate: float) -> None:
        for _ in range(ticks):
            self.angle += rate * 1e-3
            seen = math.remainder(self.angle + self._zero, math.tau)
            self.table.follow(seen, 1, fresh=True)
            beside = self._slope(self.angle, rate) * rate - self.table.speed_mm_s
            self.beside.append(beside)
            self.table.learn(beside)

    def stop(self) -> None:
        self.pass_ticks(round(1000 * STOPPED_S) + 100, 0.0)

    def out_and_back(self, angle_deg: float = 19.9) -> float:
        """Root mean square of what the table lacks, mm/s."""
        self.beside.clear()
        self.turn(angle_deg)
        self.stop()
        self.turn(-angle_deg)
        self.stop()
        return math.sqrt(sum(b * b for b in self.beside) / len(self.beside))


def test_what_it_lacks_shrinks_with_every_move() -> None:
    rail = Rail()
    found = [rail.out_and_back() for _ in range(6)]
    assert found[1] < 0.6 * found[0]
    assert found[5] < 0.25 * found[0]  # of it 0.5 / (0.5 + 0.1) is learnt at last: the table forgets the unconfirmed


def test_the_table_has_the_sign_and_the_shape_of_the_rail() -> None:
    rail = Rail()
    for _ in range(8):
        rail.out_and_back()
    for i in range(3, 38):
        centre = math.radians(20.0 / 40 * (i - 0.5))
        assert rail.table.slopes_mm_rad[i] == pytest.approx(sine(centre, 0.0) / 1.2, abs=0.8)


def test_the_table_stands_still_within_a_pass_and_until_both_ways_are_seen() -> None:
    rail = Rail()
    rail.turn(19.0)
    assert not any(rail.table.slopes_mm_rad)
    rail.stop()
    assert not any(rail.table.slopes_mm_rad)
    rail.turn(-19.0)
    assert not any(rail.table.slopes_mm_rad)
    rail.stop()
    learnt = list(rail.table.slopes_mm_rad)
    assert any(learnt)
    rail.turn(10.0)
    assert rail.table.slopes_mm_rad == learnt


def test_a_rail_that_sticks_for_a_moment_is_still_in_its_pass() -> None:
    rail = Rail()
    rail.turn(19.0)
    rail.stop()
    for _ in range(9):
        rail.turn(-1.0)
        rail.pass_ticks(round(1000 * STOPPED_S) - 100, 0.0)
    assert not any(rail.table.slopes_mm_rad)


def test_what_changes_sign_with_the_direction_is_no_run_out() -> None:
    rail = Rail(slope=lambda _, rate: math.copysign(9.5, rate))
    for _ in range(3):
        rail.out_and_back()
    assert max(map(abs, rail.table.slopes_mm_rad)) < 0.5


def test_no_slope_passes_its_bound_and_no_speed_the_laws() -> None:
    rail = Rail(slope=lambda _angle, _rate: 1e6)
    bound = rail.table.slope_max_mm_rad
    assert bound == pytest.approx(SETTINGS.tension.speed_max_mm_s / math.radians(10.0))
    for _ in range(3):
        rail.out_and_back()
    assert max(map(abs, rail.table.slopes_mm_rad)) == pytest.approx(bound)
    rail.turn(10.0, rate=math.radians(50.0))
    assert abs(rail.table.speed_mm_s) <= SETTINGS.tension.speed_max_mm_s
    assert abs(rail.table.speed_mm_s + rail.table.lead_mm_s) <= SETTINGS.tension.speed_max_mm_s


def test_a_range_across_the_encoders_end_of_turn_is_learnt_like_any_other() -> None:
    there = SECTION.model_copy(update={"angle_min_deg": 170.0, "angle_max_deg": 190.0})
    plain, wrapped = Rail(), Rail(there, zero_rad=math.radians(170.0))
    for _ in range(3):
        assert wrapped.out_and_back() == pytest.approx(plain.out_and_back(), rel=1e-3)


def test_outside_its_range_it_says_and_learns_nothing() -> None:
    rail = Rail()
    rail.out_and_back()
    rail.angle = math.radians(40.0)
    rail.table.lose()
    learnt = list(rail.table.slopes_mm_rad)
    rail.out_and_back()
    assert rail.table.slopes_mm_rad == learnt
    assert rail.table.speed_mm_s == rail.table.lead_mm_s == 0.0


def test_a_lost_encoder_ends_the_feed_forward_and_spoils_the_pass() -> None:
    rail = Rail()
    rail.out_and_back()
    rail.turn(5.0)
    assert rail.table.speed_mm_s != 0.0
    learnt = list(rail.table.slopes_mm_rad)
    rail.table.lose()
    assert rail.table.speed_mm_s == rail.table.lead_mm_s == rail.table.rate_rad_s == 0.0
    rail.stop()
    assert rail.table.slopes_mm_rad == learnt


def test_a_jump_of_the_encoder_is_no_rate() -> None:
    rail = Rail()
    rail.turn(5.0)
    rail.table.follow(rail.angle + 1.0, 1, fresh=True)
    assert rail.table.rate_rad_s == 0.0
    rail.angle += 1.0
    rail.turn(1.0)
    assert rail.table.rate_rad_s == pytest.approx(RATE, rel=0.01)


@pytest.mark.parametrize("divisor", [1, 10, 50])
def test_the_rate_is_right_at_any_sample_rate(divisor: int) -> None:
    table = RunOutTable(SECTION, SETTINGS)
    for tick in range(2000):
        table.follow(RATE * 1e-3 * tick, 1, fresh=tick % divisor == 0)
    assert table.rate_rad_s == pytest.approx(RATE, rel=1e-3)


def test_two_samples_may_be_missing() -> None:
    assert stale_ns(RailEncoderSettings(counts_per_turn=4096, rate_hz=100)) == 30_000_000


AHEAD_TICKS = round(1000 * (SETTINGS.plant.command_delay_s + SETTINGS.plant.cylinder_lag_s))


def test_with_its_lead_the_table_says_what_will_be_when_the_cylinder_follows() -> None:
    rail = Rail()
    for _ in range(6):
        rail.out_and_back()
    now, then = [], []
    for _ in range(3000):
        rail.pass_ticks(1, RATE)
        now.append(rail.table.speed_mm_s)
        then.append(rail.table.speed_mm_s + rail.table.lead_mm_s)
    late = [abs(later - earlier) for earlier, later in zip(now[500:], now[500 + AHEAD_TICKS :], strict=False)]
    off = [abs(said - later) for said, later in zip(then[500:], now[500 + AHEAD_TICKS :], strict=False)]
    assert max(off) < 0.15 * max(late)


def test_the_law_is_given_the_rails_speed_of_when_its_command_acts() -> None:
    """A rope over a rail of 0.02 mm every 1.5 deg, the drive at rest: what the rail does next is known from before."""
    wave_rad, rate = math.radians(1.5), math.radians(3.0)
    section = RunOutSettings(angle_min_deg=0.0, angle_max_deg=6.0, bins=60, learning_rate=0.5)
    encoder = RailEncoderSettings(counts_per_turn=1 << 20, rate_hz=1000)
    settings = SETTINGS.model_copy(update={"rail_encoder": encoder, "run_out": section})
    observer, inbox, _ = observers.alone(settings)
    inbox.drive.stroke_mm, inbox.rail.quality = 50.0, 0
    angle, k = math.radians(0.2), settings.plant.stiffness_n_mm
    found: list[tuple[float, float]] = []
    for tick in range(24_000):
        moving = tick % 3000 < 1800
        speed = (1.0 if tick // 3000 % 2 == 0 else -1.0) * rate * moving
        inbox.cell.tension_n = 300.0 + k * 0.02 * math.sin(math.tau * angle / wave_rad)
        inbox.rail.rad, inbox.rail.t_ns = angle, tick * 1_000_000
        inbox.cell_fresh = inbox.drive_fresh = inbox.rail_fresh = True
        observer.look(tick * 1_000_000, 0)
        estimate = observer.estimate(0, regulated=True)
        observer.filter.command(0.0)
        rises = 0.02 * math.tau / wave_rad * math.cos(math.tau * angle / wave_rad) * speed
        found.append((rises, estimate.disturbance_mm_s))
        angle += speed * 1e-3
    passes = range(18_300, 19_600)
    lacks = [sum((found[i + later][0] - found[i][1]) ** 2 for i in passes) for later in (0, AHEAD_TICKS)]
    assert lacks[1] < 0.5 * lacks[0]
