"""The motor takes a load from the brake: on drawn springs, loads and drives, judged by the plant's truth."""

from __future__ import annotations

import math

import pytest

from hil.studies.roll_back.takeover import AGAIN_S, DRAWS, LIMIT_MM, TakenOver, Takeover, draw, taken_over
from rigctl.config import rig_file as config
from rigctl.control.commands import command_checks
from rigctl.control.law.tension import Gains
from rigctl.design.margins import design_and_check
from tests.builders.paths import ROOT

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
DRAWN = draw()
ROUNDING_MM = 0.01
"""The torque offset is a whole number of per mille of 1500 N, and the tension is measured: 1.5 N each."""


@pytest.fixture(scope="module")
def gains() -> Gains:
    return design_and_check(SETTINGS).gains


def in_time(case: Takeover, found: TakenOver) -> bool:
    return found.again_s <= AGAIN_S + case.waits_ms * 1e-3


@pytest.mark.gate("0")
@pytest.mark.parametrize("case", DRAWN, ids=map(str, range(DRAWS)))
def test_with_a_preload_the_load_stays_within_the_limit_and_moves_again_in_time(gains: Gains, case: Takeover) -> None:
    found = taken_over(SETTINGS, gains, case)
    assert found.ended == "TENSIONING"
    assert found.rolled_mm <= LIMIT_MM, (case, found)
    assert found.rolled_mm <= abs(case.expected_mm) + ROUNDING_MM, (case, found)
    assert in_time(case, found), (case, found)


@pytest.mark.study
@pytest.mark.parametrize("case", DRAWN, ids=map(str, range(DRAWS)))
def test_without_a_preload_it_is_stated(gains: Gains, case: Takeover) -> None:
    """By the closed form where the motor keeps the load; else a fault, and the brake has it again."""
    bare = case._replace(preload=False)
    found = taken_over(SETTINGS, gains, bare)
    if found.ended == "TENSIONING":
        assert found.rolled_mm == pytest.approx(bare.expected_mm, rel=0.1, abs=ROUNDING_MM)
        assert in_time(case, found)
    else:
        assert found.ended.startswith("FAULT")
        assert math.isnan(found.again_s)


@pytest.mark.study
def test_a_read_back_of_every_object_is_in_that_time(gains: Gains, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_checks, "RECHECK_NS", 0)
    found = taken_over(SETTINGS, gains, DRAWN[0])
    assert found.ended == "TENSIONING"
    assert in_time(DRAWN[0], found), found


def test_the_draws_are_the_same_each_time_and_cover_the_ranges() -> None:
    assert draw() == DRAWN == draw(2 * DRAWS)[:DRAWS] != draw(seed=35)
    loads, springs = ({getattr(case, name) for case in DRAWN} for name in ("load_n", "spring_n_mm"))
    assert (min(loads) < 80.0, max(loads) > 320.0) == (True, True)
    assert (min(springs) < 9.0, max(springs) > 30.0) == (True, True)
    assert min(case.speed_loop_hz for case in DRAWN) < 30.0
