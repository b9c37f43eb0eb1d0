"""The preload follows the tension on the brake, and nothing else."""

from __future__ import annotations

import math
from typing import Any

import pytest

from rigctl.control.power.power_seen import PowerSeen
from rigctl.control.power.preload import Preload
from rigctl.control.snapshot import Snapshot
from tests.builders.rig_bench import SETTINGS


def looked(
    preload: Preload,
    brake_time_over: bool,
    tension_n: float,
    cell_quality: int = 0,
    cell_heard: bool = True,
    drive_heard: bool = True,
) -> float:
    return preload.look(
        Snapshot(
            drive_off=True,
            power=PowerSeen(brake_time_over=brake_time_over),
            tension_n=tension_n,
            cell_quality=cell_quality,
            cell_heard=cell_heard,
            drive_heard=drive_heard,
        )
    )


def test_it_stays_until_the_drive_has_been_off_for_its_brakes_time() -> None:
    preload = Preload(SETTINGS)
    assert looked(preload, False, 300.0) == 0.0
    assert looked(preload, True, 120.0) == 120.0
    assert looked(preload, False, 300.0) == 120.0
    assert looked(preload, True, 300.0) == 300.0


@pytest.mark.parametrize(
    ("tension_n", "more"),
    [(math.nan, {}), (math.inf, {}), (50.0, {"cell_quality": 1}), (50.0, {"cell_heard": False}),
     (50.0, {"drive_heard": False})],
)  # fmt: skip
def test_a_tension_or_a_drive_that_is_not_known_changes_nothing(tension_n: float, more: dict[str, Any]) -> None:
    preload = Preload(SETTINGS)
    looked(preload, True, 200.0)
    assert looked(preload, True, tension_n, **more) == 200.0


@pytest.mark.parametrize(("tension_n", "force_n"), [(-5.0, 0.0), (1e4, SETTINGS.safety.tension_high_n)])
def test_it_is_a_load_that_a_rope_may_have(tension_n: float, force_n: float) -> None:
    assert looked(Preload(SETTINGS), True, tension_n) == force_n
