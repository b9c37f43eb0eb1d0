"""The grid is absolute; missed ticks are skipped and counted, never run in a burst."""

from __future__ import annotations

import itertools
import time

import pytest

from rigctl.control.clock import GridClock, SimulatedClock

MS = 1_000_000


class FakeTime:
    """A clock that moves only by sleeping or by the test."""

    def __init__(self) -> None:
        self.now = 123_456_789

    def monotonic_ns(self) -> int:
        self.now += 100
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    subject = FakeTime()
    monkeypatch.setattr("rigctl.control.clock.time", subject)
    return subject


def test_points_lie_on_one_grid(fake: FakeTime) -> None:
    clock = GridClock(MS, 50_000)
    points = []
    for work in (0, 300_000, 900_000, 10_000):
        point, skipped = clock.next_tick()
        points.append(point)
        assert skipped == 0
        assert 0 <= fake.now - point < 1000
        fake.now += work
    assert [b - a for a, b in itertools.pairwise(points)] == [MS] * 3
    assert points[0] % MS == 0


def test_an_overrun_skips_whole_periods_on_the_same_grid(fake: FakeTime) -> None:
    clock = GridClock(MS)
    first, _ = clock.next_tick()
    fake.now += 3_400_000
    late, skipped = clock.next_tick()
    assert (late, skipped) == (first + 3 * MS, 2)
    following, skipped = clock.next_tick()
    assert (following, skipped) == (first + 4 * MS, 0)
    assert fake.now >= following


def test_a_point_just_missed_is_late_not_skipped(fake: FakeTime) -> None:
    clock = GridClock(MS)
    first, _ = clock.next_tick()
    fake.now += 1_200_000
    assert clock.next_tick() == (first + MS, 0)
    assert clock.next_tick() == (first + 2 * MS, 0)


def test_on_the_real_clock_it_never_wakes_early() -> None:
    clock = GridClock(MS, 60_000)
    last = 0
    for _ in range(50):
        point, _ = clock.next_tick()
        assert time.monotonic_ns() >= point > last
        last = point


def test_the_simulated_twin_runs_the_world_to_each_point() -> None:
    world: list[int] = []
    clock = SimulatedClock(MS, world.append, start_ns=5 * MS)
    assert [clock.next_tick() for _ in range(3)] == [(6 * MS, 0), (7 * MS, 0), (8 * MS, 0)]
    assert world == [6 * MS, 7 * MS, 8 * MS]
    assert clock.now() == 8 * MS


def test_it_leaves_the_processor_to_others_until_its_point(fake: FakeTime, monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    sleep = fake.sleep

    def noted(seconds: float) -> None:
        slept.append(seconds)
        sleep(seconds)

    monkeypatch.setattr(fake, "sleep", noted)
    clock = GridClock(MS, 50_000)
    clock.next_tick()
    slept.clear()
    clock.next_tick()
    assert sum(slept) > 0.9e-3
