"""The preload follows the tension on the brake, and nothing else."""

from __future__ import annotations

import math

import pytest

from rigctl.control.modes import HeldBy
from rigctl.control.preload import Preload
from rigctl.control.snapshot import Snapshot
from tests.builders.rig_bench import SETTINGS


def looked(preload: Preload, held_by: HeldBy, tension_n: float, quality: int = 0) -> float:
    return preload.look(Snapshot(held_by=held_by, tension_n=tension_n, cell_quality=quality))


@pytest.mark.parametrize("held_by", [held_by for held_by in HeldBy if held_by is not HeldBy.BRAKE])
def test_it_stays_while_anything_but_the_brake_holds_the_load(held_by: HeldBy) -> None:
    preload = Preload(SETTINGS)
    assert looked(preload, held_by, 300.0) == 0.0
    assert looked(preload, HeldBy.BRAKE, 120.0) == 120.0
    assert looked(preload, held_by, 300.0) == 120.0
    assert looked(preload, HeldBy.BRAKE, 300.0) == 300.0


@pytest.mark.parametrize(("tension_n", "quality"), [(math.nan, 0), (math.inf, 0), (50.0, 1)])
def test_a_tension_that_is_not_known_changes_nothing(tension_n: float, quality: int) -> None:
    preload = Preload(SETTINGS)
    looked(preload, HeldBy.BRAKE, 200.0)
    assert looked(preload, HeldBy.BRAKE, tension_n, quality) == 200.0


@pytest.mark.parametrize(("tension_n", "force_n"), [(-5.0, 0.0), (1e4, SETTINGS.safety.tension_high_n)])
def test_it_is_a_load_that_a_rope_may_have(tension_n: float, force_n: float) -> None:
    assert looked(Preload(SETTINGS), HeldBy.BRAKE, tension_n) == force_n
