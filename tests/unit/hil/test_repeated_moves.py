"""What was tried against friction at the reversal, and the study's table and picture."""

from __future__ import annotations

import math
import pathlib
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rich.console import Console

from hil.studies.moves import moves_output
from hil.studies.moves.repeated_moves import MoveFigures, RepeatedResult, pieces, variants
from hil.studies.moves.reversal_laws import Dithered, Predicting
from rigctl.control.bus.inbox import Inbox
from rigctl.control.law.tension import Estimate, Gains, TensionLaw
from tests.builders.rig_bench import SETTINGS

GAINS = Gains(0.0, 0.0, 0.0)
AT_REST = Estimate(SETTINGS.tension.target_n, 0.0, 0.0, 50.0)


def on_target(law: TensionLaw) -> TensionLaw:
    law.setpoint_n = law.target_n
    return law


def test_a_dither_moves_the_stroke_by_its_amplitude_behind_the_drives_lag() -> None:
    law = on_target(Dithered(SETTINGS, GAINS, 0.01, 10.0))
    speeds, speed = [], 0.0
    blend = -math.expm1(-1e-3 / SETTINGS.plant.cylinder_lag_s)
    for _ in range(1000):
        speed += blend * (law.compensating(AT_REST, 1.0) - speed)
        speeds.append(speed)
    stroke = np.cumsum(speeds[-200:]) * 1e-3
    assert 0.5 * np.ptp(stroke) == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize(("by", "share"), [("rate", 1.0), ("acceleration", 1.0)])
def test_a_prediction_adds_the_change_of_the_stretch_until_the_cylinder_follows(by: Any, share: float) -> None:
    rate, plant = 0.1, SETTINGS.plant
    inbox: Any = SimpleNamespace(slope_fresh=False, slope=SimpleNamespace(tangential_rad=0.0, normal_rad=0.0))
    law = on_target(Predicting(SETTINGS, GAINS, cast(Inbox, inbox), by))
    command = 0.0
    for tick in range(2000):
        inbox.slope_fresh, inbox.slope.tangential_rad = tick % 10 == 0, rate * tick * 1e-3
        command = law.compensating(AT_REST, 1.0)
    ahead_s = plant.command_delay_s + plant.cylinder_lag_s
    assert -command == pytest.approx(share * plant.rope_length_mm * rate**2 * ahead_s, rel=0.02)


def test_each_variant_has_a_name_and_its_own_runs() -> None:
    rows = variants()
    assert len({row.name for row in rows}) == len(rows)
    found = pieces(SETTINGS, rows)
    assert set(found) == {(row.name, k) for row in rows for k in row.springs_n_mm}


def test_the_figures_and_the_picture(tmp_path: pathlib.Path) -> None:
    t_s = np.arange(0.0, 2.0, 0.01)
    result = RepeatedResult((MoveFigures(0.03, 0.01), MoveFigures(0.01, 0.002)), "COMPENSATING", t_s, (t_s, 0.1 * t_s))
    found = {("learning", 6.0): result, ("plain", 6.0): result}
    assert moves_output.document(found)["learning_k6"]["moves"][1] == {"most_pct": 0.01, "spread_pct": 0.002}
    with (tmp_path / "said").open("w") as file:
        moves_output.show(found, variants(), Console(file=file, width=100))
    said = (tmp_path / "said").read_text()
    assert "as it is" in said
    assert "learning, 6 N/mm, rms of each move: 0.0100, 0.0020 %" in said
    assert moves_output.draw({}, tmp_path) is None
    picture = moves_output.draw(found, tmp_path)
    assert picture is not None
    assert picture.stat().st_size > 10_000
