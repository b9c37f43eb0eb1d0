"""The motor's current in TENSIONING: what counts as its friction, and the rise that the rope makes and the cell not."""

from __future__ import annotations

import pytest

from rigctl.config import rig_file as config
from rigctl.control.findings import TakeUpSeen
from rigctl.control.load.take_up import FACTOR_SHARE, STEADY_S, TakeUp, limit_n, smallest_scale
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
N_PER_A = SETTINGS.cylinder.force_per_ampere_n or 0.0
LIMIT_N = limit_n(SETTINGS.tension.slack_n, 300.0)
DT = SETTINGS.loop.period_ns * 1e-9
AGE_NS = 10_000_000
STEADY = round(STEADY_S / DT) + round(AGE_NS * 1e-9 / DT) + 2  # ticks at one speed until a reading counts


class Motor:
    """Tensions the rope at ``speed_mm_s`` with ``current_a`` in the newest status; each is new if ``fresh``."""

    def __init__(self) -> None:
        self.found = TakeUp(SETTINGS)
        self.speed_mm_s = 10.0

    def run(
        self, ticks: int, current_a: float, tension_n: float = 0.0, *,
        slack: bool = True, tensioning: bool = True, fresh: bool = True,
    ) -> TakeUpSeen:  # fmt: skip
        for tick in range(ticks):
            age_ns = AGE_NS - tick if fresh else AGE_NS
            self.found.look(
                current_a, age_ns, self.speed_mm_s, tension_n, 300.0, slack=slack, tensioning=tensioning
            )  # fmt: skip
        return self.found.seen

    def tight(self, current_a: float, tension_n: float, *, fresh: bool = True, tensioning: bool = True) -> TakeUpSeen:
        return self.run(STEADY, current_a, tension_n, slack=False, fresh=fresh, tensioning=tensioning)


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
    assert motor.found.seen.rise_n == pytest.approx(0.15 * N_PER_A)


def test_no_reading_counts_until_the_speed_has_been_constant() -> None:
    """The current of an acceleration is no friction: a lower one as the motor slows down would make a rise of it."""
    motor = Motor()
    motor.run(STEADY, 0.2)
    for _ in range(3 * STEADY):
        motor.speed_mm_s -= 0.01
        motor.run(1, -0.5)
    motor.run(STEADY - 4, -0.5)
    assert motor.found.seen.rise_n == 0.0
    assert motor.run(STEADY, 0.2).rise_n == pytest.approx(0.0)


@pytest.mark.parametrize("slack", [True, False])
def test_only_a_rope_that_is_tensioned_is_looked_at(slack: bool) -> None:
    found = Motor().run(3 * STEADY, 0.2, slack=slack, tensioning=False)
    assert (found.rise_n, found.limit_n, found.excess_n) == (0.0, 0.0, 0.0)


def test_a_stroke_at_rest_has_no_friction_to_compare_with() -> None:
    motor = Motor()
    motor.speed_mm_s = 0.0
    assert motor.run(3 * STEADY, 0.2).limit_n == 0.0


def test_what_was_found_is_kept_until_the_cell_shows_tension() -> None:
    motor = Motor()
    motor.run(STEADY, 0.2)
    motor.run(1, 0.6)
    assert motor.found.seen.excess_n > 0.0
    assert motor.run(10, 0.2, tensioning=False).excess_n > 0.0
    assert motor.run(1, 0.2, slack=False).excess_n == 0.0
    assert motor.run(STEADY, 0.6).rise_n == 0.0, "the friction is found anew"


def test_on_a_tight_rope_the_tension_has_to_rise_with_the_current() -> None:
    motor = Motor()
    motor.run(STEADY, 0.2)
    found = motor.tight(0.4, 100.0)
    assert (found.rise_n, found.shown_n) == (pytest.approx(0.2 * N_PER_A), 100.0)
    assert found.limit_n == pytest.approx(LIMIT_N + FACTOR_SHARE * 100.0)
    assert found.excess_n == pytest.approx(-found.limit_n)
    assert motor.tight(0.4, 60.0).excess_n > 0.0
    motor.tight(0.4, 100.0, tensioning=False)
    assert motor.found.seen.excess_n > 0.0, "kept in FAULT"
    motor.tight(0.4, 60.0)
    assert motor.found.seen.excess_n > 0.0, "and in the next TENSIONING"
    motor.found.forget()
    assert motor.tight(0.4, 60.0).excess_n < 0.0, "the cell was corrected: what is there now is the first reading"


def test_a_tension_that_begins_on_a_tight_rope_is_compared_from_its_first_reading_on() -> None:
    motor = Motor()
    assert motor.tight(0.6, 200.0).rise_n == 0.0
    assert motor.tight(0.5, 150.0).rise_n == pytest.approx(-0.1 * N_PER_A), "the first, not the lowest"
    assert motor.tight(0.64, 220.0).shown_n == pytest.approx(20.0)
    motor.tight(0.64, 220.0, tensioning=False)
    assert motor.tight(0.8, 270.0).rise_n == 0.0, "the next TENSIONING takes a reading of its own"


def test_an_old_reading_is_not_compared_with_a_tension_that_has_risen_since() -> None:
    motor = Motor()
    motor.run(STEADY, 0.2)
    motor.tight(0.4, 100.0)
    assert motor.tight(0.4, 60.0, fresh=False).shown_n == 100.0


@pytest.mark.parametrize("speed_mm_s", [-10.0, 0.0, 1.0])
def test_only_the_current_of_an_upward_motion_is_compared(speed_mm_s: float) -> None:
    """Below a quarter of the ramp's speed the friction need not be that of a motion; downward it has the other sign."""
    motor = Motor()
    motor.run(STEADY, 0.2)
    motor.speed_mm_s = speed_mm_s
    motor.tight(0.6, 50.0)
    assert motor.found.seen.shown_n == 0.0


@pytest.mark.parametrize(("scale", "found"), [(-0.01, True), (0.01, False)])
def test_the_smallest_error_of_the_scale_is_the_one_stated(scale: float, found: bool) -> None:
    scale += smallest_scale(SETTINGS.tension.slack_n, 300.0)
    motor = Motor()
    motor.run(STEADY, 0.2)
    motor.tight(0.2 + 300.0 / scale / N_PER_A, 300.0)
    assert (motor.found.seen.excess_n > 0.0) is found
