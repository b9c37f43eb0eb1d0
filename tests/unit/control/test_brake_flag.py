"""The flag "the brake does not hold" as a loop takes it over from the one before it."""

from __future__ import annotations

import math

import pytest

from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.control.load.brake_flag import TESTED_SHARE, BrakeFlag, KeptBrake
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.snapshot import Snapshot
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
MOST_N = SETTINGS.tension.target_max_n
DAMAGED = KeptBrake(fails=True, why="paper_rig.stroke.json is damaged")
SLIPS = Fault.STROKE_MOVES.bit


def taken_over(kept: KeptBrake, tension_n: float, standing: int = 0) -> BrakeFlag:
    """The flag after a tick with this tension on the closed brake."""
    rope = RopeMemory(SETTINGS)
    found = BrakeFlag(SETTINGS, rope, kept)
    seen = Snapshot(tension_n=tension_n, cell_heard=True, stroke_mm=50.0)
    rope.look(standing, seen)
    found.look(standing, seen, braked=True)
    return found


def test_nothing_kept_is_a_brake_that_holds() -> None:
    found = taken_over(KeptBrake(), 200.0)
    assert (found.fails, found.changed) == (False, False)


def test_a_kept_load_is_the_one_of_the_test_also_under_another_load() -> None:
    found = taken_over(KeptBrake(fails=True, slipped_n=300.0), 200.0)
    assert (found.fails, found.assumed, found.slipped_n) == (True, False, 300.0)
    found.tested(TESTED_SHARE * 300.0 - 1.0)
    assert found.fails
    found.tested(TESTED_SHARE * 300.0)
    assert not found.fails
    assert math.isnan(found.slipped_n)


@pytest.mark.parametrize("kept", [DAMAGED, KeptBrake(fails=True)], ids=["damaged", "at no known load"])
def test_the_load_at_the_start_is_not_the_one_at_which_the_brake_slipped(kept: KeptBrake) -> None:
    found = taken_over(kept, 60.0)
    assert found.wanted_n == TESTED_SHARE * MOST_N
    found.tested(60.0)
    assert found.fails


def test_a_flag_that_this_loop_sets_has_its_load() -> None:
    found = taken_over(KeptBrake(), 200.0, SLIPS)
    assert (found.fails, found.slipped_n) == (True, 200.0)


def test_a_rig_without_a_brake_takes_no_flag_over() -> None:
    without = changed(SETTINGS, {"cylinder.brake_waiver": "a screw that holds itself", "cylinder.brake_test": False})
    assert not BrakeFlag(without, RopeMemory(without), DAMAGED).fails


@pytest.mark.parametrize(
    ("assumed", "tension_n", "why", "begins"),
    [
        (1, 0.0, DAMAGED.why, "the brake counts as one that does not hold: paper_rig.stroke.json is damaged; "),
        (0, 0.0, "known before this start", "the brake does not hold: known before this start; "),
        (
            0,
            299.0,
            "the brake test has failed",
            "the brake does not hold: the brake test has failed, 299 N on the rope; ",
        ),
    ],
)
def test_the_event_says_what_where_and_what_to_do(assumed: int, tension_n: float, why: str, begins: str) -> None:
    event = worded(Kind.BRAKE_FLAG, 1, assumed, tension_n, 280.0, why)
    assert event.severity == "error"
    assert event.text.startswith(begins)
    assert event.text.endswith("clears this: rigctl arm on a tight rope of 280 N at least, once nothing bars it")
