"""Shares of the groups: what is played with which seed, what is printed, and which rows are of another law."""

from __future__ import annotations

import json
import pathlib
from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from hil.runs.rows_file import RowsFile
from hil.scenario.errors import ScenarioError
from hil.studies.cli import compare_tuned
from hil.studies.compare import shares, shares_tables, tuned_laws
from hil.studies.compare.bound.joint_groups import JointGroups, JointLaw
from hil.studies.compare.compared_runs import ComparedRun, compared_runs
from hil.studies.compare.equal_limits import Known, LoopLaw, RunErrors
from hil.studies.compare.groups import GROUPS
from hil.studies.compare.measured_ms import Peak
from hil.studies.compare.rivals import OURS
from hil.studies.compare.shares import PlayedLaw, Shares
from hil.studies.compare.tuned_laws import LAW_VERSION, TunedLaw
from rigctl.config import rig_file as config
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.design import plant_family, surrogate
from rigctl.design.gains import design
from tests.builders.daemons import PAPER
from tests.builders.paths import ROOT
from tests.builders.rig_bench import SETTINGS

RIG = changed(SETTINGS, {"simulation.seed": 1})
PEAK = Peak(1.4, 0.01, 20.0, "input", 1.0)
FIGURES_N = {
    4: {
        "rest": 0.005947330871,
        "move": 0.00599554677,
        "vertical": 0.04373978492,
        "shake_3hz": 0.1047551945,
        "shake_8hz": 0.1884578748,
        "jolt": 2.20775317,
    }
}
"""By version of the law: the rms error of each scenario of the search with the design of the paper's rig."""


def row(*rms_pct: float | None, ms: float = 1.4) -> PlayedLaw:
    return PlayedLaw(rms_pct, rms_pct, ("COMPENSATING",) * 3, PEAK._replace(ms=ms), within=True)


def found() -> Shares:
    groups = {group: GROUPS[group] for group in ("heave", "jolt")}
    played = {
        ("vertical", "pi"): row(0.004, 0.004, 0.004),
        ("vertical", OURS): row(0.0041, 0.0038, 0.0043),
        ("jolt", "pi"): row(0.2, 0.2, None),
        ("jolt", OURS): row(0.2, 0.2, 0.2, ms=1.63),
        ("mass", "pi"): row(0.05, 0.05, 0.05),
        ("mass", OURS): row(0.05, 0.05, 0.05),
    }
    bounds = {"vertical": 0.002, "jolt": 0.1, "mass": None}
    return Shares(RIG, groups, ("pi", OURS), played, bounds)


def joint() -> JointGroups:
    reach = JointLaw(6.0, {"move": 1.5, "jolt": 1.0}, 1.59, {"move": 5.5, "jolt": 6.0})
    return JointGroups("6 N/mm", 0.1, "own bound", {"move": 0.004, "jolt": 0.6}, reach, None)


def shown() -> str:
    said = StringIO()
    shares_tables.show(found(), [joint()], Console(file=said, width=132))
    return said.getvalue()


def test_error_place_share_and_ms_of_each_group() -> None:
    said = json.loads(json.dumps(shares.document(found(), []), allow_nan=False))
    heave, jolt = (said["groups"][group]["laws"] for group in ("heave", "jolt"))
    assert (heave["pi"]["place"], heave[OURS]["place"]) == ("lowest", "tied")
    assert heave["pi"]["over_bound"] == pytest.approx(2.0)
    assert heave[OURS]["spread"] == pytest.approx(0.0043 / 0.0038)
    assert jolt[OURS]["error_pct"] == pytest.approx(0.1)  # of 0.2 and 0.05
    assert jolt[OURS]["over_bound"] == pytest.approx(2.0)  # of the jolt alone: the other run has no bound
    assert (jolt["pi"]["error_pct"], jolt["pi"]["place"], jolt["pi"]["over_bound"]) == (None, None, None)
    assert jolt[OURS]["ms_measured"]["ms"] == 1.63
    assert said["lowest_or_tied"] == {"pi": 1, OURS: 2}
    assert (said["seeds"], said["law_version"]) == ([1, 2, 3], LAW_VERSION)


def test_the_headline_counts_groups() -> None:
    said = shown()
    assert "lowest or tied, of 2 groups: PI 1, ours 2\n" in said
    assert "measured Ms above 1.6: ours in jolt 1.63\n" in said
    lines = [line.split() for line in said.splitlines()]
    assert ["heave", "0.0040*", "0.0041="] in lines
    assert any("5.50" in line and "6.00" in line for line in said.splitlines()), "prices of the joint bound"
    assert max(map(len, said.splitlines())) <= 132


def test_our_run_that_ends_early_is_named() -> None:
    study = found()
    assert study.ended_early() == []
    assert study._replace(played={**study.played, ("mass", OURS): row(0.05, None, 0.05)}).ended_early() == ["mass"]


def test_the_least_of_the_laws_needs_every_run() -> None:
    least = found().least_by_case({"move": "vertical", "jolt": "jolt"})
    assert least is not None
    assert least["move"] == pytest.approx(0.012)  # 0.004 % of 300 N
    assert least["jolt"] == pytest.approx(0.6)
    assert found().least_by_case({"move": "paper_k6"}) is None


def test_each_seed_is_played_once_and_a_law_is_tuned_once(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played, tuned = list[int](), list[str]()

    def play(settings: RigSettings, _law: LoopLaw, _run: ComparedRun) -> RunErrors:
        assert settings.simulation is not None
        played.append(settings.simulation.seed)
        return RunErrors(0.01, 0.002 * len(played), None, 20.0, "COMPENSATING")

    def tune(_known: Known, law: str, *_: Any, **_options: Any) -> TunedLaw:
        tuned.append(law)
        return TunedLaw(law, (0.05, 4.0), True, 0.0, 1.5, 0.1, (0.0, 0.0, 0.0))

    monkeypatch.setattr(shares, "played", play)
    monkeypatch.setattr(shares, "tuning", tune)
    monkeypatch.setattr(shares, "identified_by", lambda *_: None)
    monkeypatch.setattr(shares, "peak_by", lambda *_: PEAK)

    def study() -> Shares:
        rows = RowsFile(tmp_path / "rows.jsonl", {})
        return shares.study(RIG, compared_runs(RIG), ["heave"], ["pi"], rows, lambda _: None, lambda _: 0.001)

    first = study()
    assert played == [1, 2, 3]
    assert tuned == ["pi", "pi"]  # for the rig of the file, and for that of the run
    assert first.played["vertical", "pi"].rms_pct == pytest.approx((0.002, 0.004, 0.006))
    assert study() == first
    assert played == [1, 2, 3], "the rows have them"


def test_rows_of_another_version_of_the_law_are_refused(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = compare_tuned.Asked(["heave"], ["pi"], None, tmp_path / "rows.jsonl")
    RowsFile(asked.rows, compare_tuned._of(config.load(PAPER), asked))
    monkeypatch.setattr(tuned_laws, "LAW_VERSION", LAW_VERSION + 1)
    with pytest.raises(ScenarioError, match=r"another study \(law differs\)"):
        compare_tuned.run_shares(PAPER, tmp_path / "shares.json", asked)


def test_a_group_that_does_not_exist_is_refused(tmp_path: pathlib.Path) -> None:
    asked = compare_tuned.Asked(["vertical"], [], None, None)
    with pytest.raises(ScenarioError, match="expected move_6, move_34, heave"):
        compare_tuned.run_shares(ROOT / "config/paper_rig.yaml", tmp_path / "shares.json", asked)


def test_the_version_of_the_law_is_that_of_its_figures() -> None:
    """Where this fails the law's arithmetic has changed: raise ``LAW_VERSION``, and enter the figures under it."""
    settings = Known.of(config.load(PAPER)).settings
    law, plant = surrogate.OurLaw(settings, design(settings)), plant_family.nominal(settings)
    found = {case.name: surrogate.play(settings, law, plant, case).rms_n for case in surrogate.scenarios(settings)}
    assert found == pytest.approx(FIGURES_N[LAW_VERSION], rel=1e-7)
