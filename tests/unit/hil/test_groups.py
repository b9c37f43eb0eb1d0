"""The groups of the comparison: every run in one, and what counts as a tie."""

from __future__ import annotations

import pytest

from hil.studies.compare.compared_runs import compared_runs
from hil.studies.compare.groups import GROUPS, GroupError, group_error, places, seeds
from rigctl.config.changed_settings import changed
from tests.builders.rig_bench import SETTINGS


def test_every_run_is_in_one_group() -> None:
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted(run.name for run in compared_runs(SETTINGS))
    assert len(grouped) == 18
    assert len(GROUPS) == 8


def test_the_seeds_are_that_of_the_file_and_the_two_after_it() -> None:
    assert seeds(changed(SETTINGS, {"simulation.seed": 1})) == (1, 2, 3)
    assert seeds(changed(SETTINGS, {"simulation.seed": 7})) == (7, 8, 9)


def test_an_error_is_the_geometric_mean_and_its_spread_that_of_the_seeds() -> None:
    found = group_error([(0.001, 0.004), (0.002, 0.008), (0.001, 0.004)])
    assert found is not None
    assert found.error_pct == pytest.approx(0.002 * 2.0 ** (1.0 / 3.0))
    assert found.spread == pytest.approx(2.0)
    assert group_error([(0.001, 0.004), (0.002, None), (0.001, 0.004)]) is None, "one run was not ended"


def test_a_law_within_the_larger_of_both_spreads_is_tied() -> None:
    wide, narrow = GroupError(1.0, 1.2), GroupError(1.0, 1.01)
    other = GroupError(1.15, 1.02)
    assert places({"a": wide, "b": other}) == {"a": "lowest", "b": "tied"}
    assert places({"a": narrow, "b": other}) == {"a": "lowest", "b": "above"}
    assert places({"b": other._replace(spread=1.2), "a": narrow}) == {"b": "tied", "a": "lowest"}
    assert places({"a": narrow, "b": None}) == {"a": "lowest", "b": None}
    assert places({"a": None}) == {"a": None}
