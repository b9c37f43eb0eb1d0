"""What the figures of a tare or calibration mean, and what is refused before and after them."""

from __future__ import annotations

import pathlib
from dataclasses import replace
from typing import Any

import pytest

from rigctl.config import rig_file as config
from rigctl.config.settings import RigSettings
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Standing
from rigctl.model.requests import Request
from rigctl.model.verbs import Setting, Verb
from rigctl.operations import calibration_findings as findings
from rigctl.operations.calibration_findings import FindingError, Measured
from tests.builders.paths import ROOT

PAPER = config.load(ROOT / "config/paper_rig.yaml")
assert PAPER.calibration is not None
SECTION = PAPER.calibration.model_copy(update={"waiver": None, "shunt_n": 250.0})
NOW_NS = 1_800_000_000 * 10**9
TARE, CALIBRATE = Request(Verb.TARE, "kim"), Request(Verb.CALIBRATE, "kim")


@pytest.fixture
def settings(tmp_path: pathlib.Path) -> RigSettings:
    return PAPER.model_copy(update={"calibration": SECTION, "directory": str(tmp_path)})


def measured(mean_n: float) -> Measured:
    return Measured(mean_n, 0.03, NOW_NS)


@pytest.mark.parametrize("adopt", [False, True])
@pytest.mark.parametrize("reading_n", [0.0, 1.2, -0.8, 29.0])
def test_a_check_of_an_empty_hook_is_refused_and_the_one_before_stays(
    settings: RigSettings, reading_n: float, adopt: bool
) -> None:
    passed = findings.calibrate(settings, CALIBRATE, Standing(), measured(294.2)).entry
    standing = ledger.standing(settings, [passed], NOW_NS)
    assert not standing.overdue
    with pytest.raises(FindingError, match=r"no weight hangs on the cell; nothing was recorded"):
        findings.calibrate(settings, replace(CALIBRATE, adopt=adopt), standing, measured(reading_n))


def test_a_shunt_that_is_not_on_is_no_failed_check(settings: RigSettings) -> None:
    with pytest.raises(FindingError, match="the shunt is not on"):
        findings.calibrate(settings, Request(Verb.CALIBRATE, "kim", shunt=True), Standing(), measured(0.3))


@pytest.mark.parametrize("reading_n", [294.2 * 1.03, 294.2 * 0.97, -294.2])
def test_no_scale_beyond_its_bound_is_adopted(settings: RigSettings, reading_n: float) -> None:
    with pytest.raises(FindingError, match="nothing was changed"):
        findings.calibrate(settings, Request(Verb.CALIBRATE, "kim", adopt=True), Standing(), measured(reading_n))


def test_an_adopted_scale_goes_on_from_the_one_in_force_and_counts_as_a_check(settings: RigSettings) -> None:
    adopt = replace(CALIBRATE, adopt=True)
    given = findings.calibrate(settings, adopt, Standing(zero_n=1.0, scale=1.01), measured(294.2 / 1.005 + 1.0))
    assert given.good
    assert given.entry.passed
    assert given.order == (Setting.SCALE, (pytest.approx(1.005), 0.0))


def test_the_shunt_is_held_against_its_own_reference(settings: RigSettings) -> None:
    found = findings.calibrate(settings, Request(Verb.CALIBRATE, "kim", shunt=True), Standing(), measured(250.5))
    assert found.entry.figures["deviation_pct"] == pytest.approx(0.2)
    assert found.entry.figures["against"] == "shunt"


@pytest.mark.parametrize(
    ("request_", "change", "why"),
    [
        (TARE, {"calibration": None}, "no calibration section"),
        (CALIBRATE, {"calibration": None}, "no calibration section"),
        (Request(Verb.CALIBRATE, "kim", shunt=True), {"calibration": PAPER.calibration}, "shunt_n"),
        (Request(Verb.CALIBRATE, "kim", shunt=True, adopt=True), {}, "the shunt has its reference"),
        (Request(Verb.CALIBRATE, "kim", 501.0), {}, "above 0 to 500 N"),
        (Request(Verb.CALIBRATE, "kim", -1.0), {}, "above 0 to 500 N"),
    ],
)
def test_what_can_lead_to_nothing_is_refused_before_it_is_measured(
    settings: RigSettings, request_: Request, change: dict[str, Any], why: str
) -> None:
    assert why in str(findings.impossible(settings.model_copy(update=change), request_))


@pytest.mark.parametrize(
    ("weight_n", "possible"),
    [(0.5, True), (PAPER.tension_cell.range_n, True), (0.0, False), (-1.0, False), (1e6, False)],
)
def test_a_known_weight_is_above_nothing_and_within_the_cells_range(weight_n: float, possible: bool) -> None:
    why = findings.impossible(PAPER, Request(Verb.CALIBRATE, "kim", weight_n))
    assert (why is None) is possible
