"""The sequence before the drive's power and its standstill, tick by tick."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rigctl.config import rig_file as config
from rigctl.control.arming import (
    AWAIT_NS,
    BRAKE_TEST_MM,
    BRAKE_TEST_NS,
    ArmingStep,
    Sequence,
    awaited,
)
from rigctl.control.checks import Check
from rigctl.control.power_seen import STILL_NS, PowerSeen, Standstill
from rigctl.control.snapshot import Snapshot
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
SETTINGS = PAPER.model_copy(update={"cylinder": PAPER.cylinder.model_copy(update={"brake_test": True})})
MS, S = 1_000_000, 1_000_000_000
REST = Snapshot(tension_n=300.0, stroke_mm=50.0, power=PowerSeen(brake_time_over=True), still_ns=STILL_NS)


def begun() -> Sequence:
    sequence = Sequence(SETTINGS)
    sequence.begin(1 * S, tests=True)
    return sequence


def in_its_test(sequence: Sequence, moved_mm: float) -> ArmingStep:
    assert sequence.step(1 * S, REST, slack=False) is ArmingStep.WAIT
    return sequence.step(1 * S + 1 * MS, replace(REST, stroke_mm=50.0 + moved_mm), slack=False)


def test_the_drive_gets_power_once_the_brake_has_held_for_its_time() -> None:
    sequence = begun()
    assert in_its_test(sequence, 0.9 * BRAKE_TEST_MM) is ArmingStep.WAIT
    assert sequence.step(1 * S + BRAKE_TEST_NS - 1, REST, slack=False) is ArmingStep.WAIT
    assert sequence.tested is None
    assert sequence.step(1 * S + BRAKE_TEST_NS, REST, slack=False) is ArmingStep.WAIT
    assert (sequence.tested, sequence.tension_n) == (True, 300.0)
    assert sequence.step(1 * S + BRAKE_TEST_NS + 1, REST, slack=False) is ArmingStep.READY


@pytest.mark.parametrize("moved_mm", [1.1 * BRAKE_TEST_MM, -1.1 * BRAKE_TEST_MM, float("nan")])
def test_a_brake_that_gives_way_either_way_has_slipped(moved_mm: float) -> None:
    sequence = begun()
    assert in_its_test(sequence, moved_mm) is ArmingStep.SLIPPED
    assert sequence.tested is None
    assert sequence.moved_mm == pytest.approx(moved_mm, nan_ok=True)


def test_a_slack_rope_tests_no_brake() -> None:
    sequence = begun()
    assert sequence.step(1 * S, REST, slack=True) is ArmingStep.READY
    assert sequence.tested is False


def test_what_is_awaited_is_waited_for_and_then_it_is_too_late() -> None:
    sequence, moving = begun(), replace(REST, still_ns=0)
    assert awaited(moving) == Check.NOT_AT_STANDSTILL
    assert sequence.step(1 * S + AWAIT_NS - 1, moving, slack=True) is ArmingStep.WAIT
    assert sequence.step(1 * S + AWAIT_NS, moving, slack=True) is ArmingStep.LATE
    assert awaited(replace(REST, power=PowerSeen())) == Check.SEQUENCE_RUNNING


def test_a_stroke_that_stops_comes_to_rest_and_one_that_is_not_seen_does_not() -> None:
    standstill, stroke_mm = Standstill(SETTINGS), 0.0
    for tick in range(100):
        stroke_mm += 5.0e-3
        assert standstill.look(tick * MS, stroke_mm, 5.0, True) < 10 * MS
    still_ns = [standstill.look(tick * MS, stroke_mm, 0.0, True) for tick in range(100, 500)]
    assert still_ns[-1] > STILL_NS
    assert standstill.look(500 * MS, stroke_mm, 0.0, False) == 0
