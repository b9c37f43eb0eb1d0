"""How long a load may delay the end of the loop."""

from __future__ import annotations

import math

import pytest

from rigctl.config import rig_file
from rigctl.config.settings import RigSettings
from rigctl.control.load.carried_load import LOWERS_MM_S, SPARE_MM, longest_lowering_s
from rigctl.control.power.ending import LIMIT_S, WAITS_NS, Ending, limit_s
from rigctl.model.states import EndStep
from tests.builders.paths import ROOT
from tests.unit.conftest import Rig

SHIPPED = [rig_file.load(ROOT / f"config/{name}.yaml") for name in ("rig", "paper_rig", "plain_rig")]
S = 1_000_000_000


@pytest.mark.parametrize("settings", SHIPPED, ids=lambda settings: settings.rig)
def test_the_limit_covers_the_longest_lowering_of_each_rig_that_we_ship(settings: RigSettings) -> None:
    full_stretch_mm = settings.tension.target_max_n / settings.plant.slow_stiffness_n_mm
    by_encoder_s = (full_stretch_mm + SPARE_MM) / LOWERS_MM_S
    assert by_encoder_s <= longest_lowering_s(settings)
    assert WAITS_NS * 1e-9 + longest_lowering_s(settings) < 0.5 * LIMIT_S, "a HOLD may stop it once"
    assert limit_s(settings) == LIMIT_S


def test_a_softer_rope_has_a_longer_limit(rig: Rig) -> None:
    soft = rig(plant={"spring_n_mm": 2.0})
    assert soft.plant.slow_stiffness_n_mm < 2.5
    assert limit_s(soft) > LIMIT_S
    assert limit_s(soft) >= 2.0 * (10.0 + soft.tension.target_max_n / soft.plant.slow_stiffness_n_mm / LOWERS_MM_S)


def test_a_slower_ramp_has_a_longer_limit(rig: Rig) -> None:
    assert longest_lowering_s(rig(tension={"ramp_n_s": 1.0})) > SHIPPED[1].tension.target_max_n


def test_the_end_comes_at_the_limit_though_the_load_is_not_lowered() -> None:
    """An operator stops each lowering with HOLD."""
    ending = Ending(SHIPPED[1])
    for second in range(round(LIMIT_S) + 1):
        assert ending.step in (None, EndStep.WAITS, EndStep.LOWERS)
        ending.look((1 + second) * S, 0, carries=True, lowers=second % 12 == 11, lowered=False)
    assert ending.step is EndStep.LATE
    assert math.isnan(ending.left_s)
    assert not ending.delayed
