"""The sequence before the drive's power and its standstill, tick by tick."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rigctl.config import rig_file as config
from rigctl.control.power.arming import (
    AWAIT_NS,
    BRAKE_TEST_MM,
    BRAKE_TEST_NS,
    ArmingStep,
    Preparation,
    awaited,
    begin,
    prepare,
)
from rigctl.control.power.power_seen import STILL_NS, PowerSeen, Standstill
from rigctl.control.snapshot import Snapshot
from rigctl.model.checks import Check
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
SETTINGS = PAPER.model_copy(update={"cylinder": PAPER.cylinder.model_copy(update={"brake_test": True})})
MS, S = 1_000_000, 1_000_000_000
REST = Snapshot(tension_n=300.0, stroke_mm=50.0, power=PowerSeen(brake_time_over=True), still_ns=STILL_NS)


def begun() -> Preparation:
    return begin(1 * S, tests=True)


def in_its_test(moved_mm: float) -> tuple[Preparation, ArmingStep]:
    test, step = prepare(begun(), 1 * S, REST, slack=False)
    assert step is ArmingStep.WAIT
    return prepare(test, 1 * S + 1 * MS, replace(REST, stroke_mm=50.0 + moved_mm), slack=False)


def test_the_drive_gets_power_once_the_brake_has_held_for_its_time() -> None:
    test, step = in_its_test(0.9 * BRAKE_TEST_MM)
    assert step is ArmingStep.WAIT
    test, step = prepare(test, 1 * S + BRAKE_TEST_NS - 1, REST, slack=False)
    assert (test.tested, step) == (None, ArmingStep.WAIT)
    test, step = prepare(test, 1 * S + BRAKE_TEST_NS, REST, slack=False)
    assert (test.tested, test.tension_n, step) == (True, 300.0, ArmingStep.WAIT)
    assert prepare(test, 1 * S + BRAKE_TEST_NS + 1, REST, slack=False)[1] is ArmingStep.READY


@pytest.mark.parametrize("moved_mm", [1.1 * BRAKE_TEST_MM, -1.1 * BRAKE_TEST_MM, float("nan")])
def test_a_brake_that_gives_way_either_way_has_slipped(moved_mm: float) -> None:
    test, step = in_its_test(moved_mm)
    assert (test.tested, step) == (None, ArmingStep.SLIPPED)
    assert test.moved_mm == pytest.approx(moved_mm, nan_ok=True)


def test_a_slack_rope_tests_no_brake() -> None:
    test, step = prepare(begun(), 1 * S, REST, slack=True)
    assert (test.tested, step) == (False, ArmingStep.READY)


def test_what_is_awaited_is_waited_for_and_then_it_is_too_late() -> None:
    moving = replace(REST, still_ns=0)
    assert awaited(moving) == Check.NOT_AT_STANDSTILL
    assert prepare(begun(), 1 * S + AWAIT_NS - 1, moving, slack=True)[1] is ArmingStep.WAIT
    assert prepare(begun(), 1 * S + AWAIT_NS, moving, slack=True)[1] is ArmingStep.LATE
    assert awaited(replace(REST, power=PowerSeen())) == Check.SEQUENCE_RUNNING


def test_a_stroke_that_stops_comes_to_rest_and_one_that_is_not_seen_does_not() -> None:
    standstill, stroke_mm = Standstill(SETTINGS), 0.0
    for tick in range(100):
        stroke_mm += 5.0e-3
        assert standstill.look(tick * MS, stroke_mm, 5.0, True) < 10 * MS
    still_ns = [standstill.look(tick * MS, stroke_mm, 0.0, True) for tick in range(100, 500)]
    assert still_ns[-1] > STILL_NS
    assert standstill.look(500 * MS, stroke_mm, 0.0, False) == 0
