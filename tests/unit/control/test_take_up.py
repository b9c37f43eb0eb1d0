"""The motor's current while slack is taken up: what counts as its friction, and the rise that the rope makes."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.control.take_up import STEADY_S, TakeUp, limit_n
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
N_PER_A = SETTINGS.cylinder.force_per_ampere_n or 0.0
LIMIT_N = limit_n(SETTINGS.tension.slack_n, 300.0)
DT = SETTINGS.loop.period_ns * 1e-9
AGE_NS = 10_000_000
STEADY = round(STEADY_S / DT) + round(AGE_NS * 1e-9 / DT) + 2  # ticks at one speed until a reading counts


class Motor:
    """Takes up slack at ``speed_mm_s`` with ``current_a`` in the newest status."""

    def __init__(self) -> None:
        self.found = TakeUp(SETTINGS)
        self.speed_mm_s = 10.0

    def run(self, ticks: int, current_a: float, *, slack: bool = True, tensioning: bool = True) -> TakeUp:
        for _ in range(ticks):
            self.found.look(current_a, AGE_NS, self.speed_mm_s, 300.0, slack=slack, tensioning=tensioning)
        return self.found


def test_a_rise_above_the_friction_is_the_ropes_and_has_its_limit() -> None:
    motor = Motor()
    found = motor.run(STEADY, 0.2)
    assert (found.rise_n, found.limit_n, found.excess_n) == (0.0, LIMIT_N, -LIMIT_N)
    found = motor.run(1, 0.25)
    assert found.rise_n == pytest.approx(0.05 * N_PER_A)
    assert found.excess_n == pytest.approx(0.05 * N_PER_A - LIMIT_N)


def test_the_lowest_reading_is_the_friction() -> None:
    motor = Motor()
    for current_a in (0.2, 0.15, 0.3):
        motor.run(STEADY, current_a)
    assert motor.found.rise_n == pytest.approx(0.15 * N_PER_A)


def test_no_reading_counts_until_the_speed_has_been_constant() -> None:
    """The current of an acceleration is no friction: a lower one as the motor slows down would make a rise of it."""
    motor = Motor()
    motor.run(STEADY, 0.2)
    for _ in range(3 * STEADY):
        motor.speed_mm_s -= 0.01
        motor.run(1, -0.5)
    motor.run(STEADY - 4, -0.5)
    assert motor.found.rise_n == 0.0
    assert motor.run(STEADY, 0.2).rise_n == pytest.approx(0.0)


@pytest.mark.parametrize("other", [{"slack": False}, {"tensioning": False}])
def test_only_a_slack_rope_that_is_tensioned_is_looked_at(other: dict[str, bool]) -> None:
    found = Motor().run(3 * STEADY, 0.2, **other)
    assert (found.rise_n, found.limit_n, found.excess_n) == (0.0, 0.0, 0.0)


def test_a_stroke_at_rest_has_no_friction_to_compare_with() -> None:
    motor = Motor()
    motor.speed_mm_s = 0.0
    assert motor.run(3 * STEADY, 0.2).limit_n == 0.0


def test_what_was_found_is_kept_until_the_cell_shows_tension() -> None:
    motor = Motor()
    motor.run(STEADY, 0.2)
    motor.run(1, 0.6)
    assert motor.found.excess_n > 0.0
    assert motor.run(10, 0.2, tensioning=False).excess_n > 0.0
    assert motor.run(1, 0.2, slack=False).excess_n == 0.0
    assert motor.run(STEADY, 0.6).rise_n == 0.0, "the friction is found anew"
