"""The sensor budget before and after what the ledger knows of the cell."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from rigctl.config import rig_file as config
from rigctl.config.compensation_section import CompensationSettings
from rigctl.ipc.correction import CreepTerm
from rigctl.ipc.ledger import Standing
from rigctl.report.sensor_budget import budget, combined_n, compensated, sum_n
from tests.builders.paths import ROOT

RIG = config.load(ROOT / "config/paper_rig.yaml", study=True)
TARED = datetime(2026, 11, 1, 8, tzinfo=UTC)
KNOWN = Standing(
    zero_u_n=0.02, tared="2026-11-01T08:00:00Z", zero_n_k=0.01, zero_u_n_k=0.001, scale_u=1e-4,
    creep=(CreepTerm(1e-4, 30.0), CreepTerm(1e-4, 600.0)), creep_u=3e-5, creep_seen_s=1800.0,
)  # fmt: skip


def sizes(section: CompensationSettings | None, standing: Standing = KNOWN, hours: float = 1.0) -> dict[str, float]:
    rig = RIG.model_copy(update={"compensation": section})
    errors = compensated(rig, standing, 300.0, TARED + timedelta(hours=hours))
    return {error.name: error.newtons for error in errors}


def test_where_nothing_is_known_it_is_that_of_the_class() -> None:
    plain = {error.name: error.newtons for error in budget(RIG, 300.0)}
    assert sizes(CompensationSettings(temperature="cell"), Standing()) == plain
    assert sizes(None, Standing()) == plain


def test_each_known_error_takes_the_place_of_its_class() -> None:
    found = sizes(CompensationSettings(temperature="cell"))
    assert found["bias"] == 0.02
    assert found["drift"] == pytest.approx(0.008)
    assert found["creep"] == pytest.approx(0.009)
    assert found["gain"] == pytest.approx(300.0 * (1e-4**2 + 5e-5**2) ** 0.5)


@pytest.mark.parametrize(
    ("section", "name"),
    [({"creep": False, "temperature": "cell"}, "creep"), ({"temperature": None}, "drift")],
)
def test_what_is_known_and_not_taken_out_is_that_of_the_class(section: dict[str, Any], name: str) -> None:
    plain = {error.name: error.newtons for error in budget(RIG, 300.0)}
    assert sizes(CompensationSettings(**section))[name] == plain[name]


def test_a_tare_is_worth_a_shift() -> None:
    section = CompensationSettings(temperature="cell")
    assert sizes(section, hours=9.0)["bias"] == pytest.approx(0.15)


def test_the_root_of_squares_is_no_more_than_the_sum() -> None:
    errors = budget(RIG, 300.0)
    assert combined_n(errors) == pytest.approx(0.195, abs=0.001)
    assert sum_n(errors) == pytest.approx(0.363, abs=0.001)
