"""The comparison as a user runs it: one process, two short scenarios, every law."""

from __future__ import annotations

import json
import pathlib
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from hil.studies.compare.compared_runs import QUICK, compared_runs
from hil.studies.compare.comparison import compare as compare_laws
from hil.studies.compare.comparison import pieces, settling_s
from hil.studies.compare.rivals import LAWS
from rigctl.config import rig_file as config
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

RIG = config.load(ROOT / "config/paper_rig.yaml")
FIGURES = {"eta_true_max_pct", "eta_true_rms_pct", "speed_max_mm_s", "settle_s", "ended"}


def compare(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hil", "compare", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience_s(300.0), check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return tmp_path_factory.mktemp("compare")


@pytest.fixture(scope="module")
def done(folder: pathlib.Path) -> subprocess.CompletedProcess[str]:
    files = "--json", str(folder / "figures.json"), "--plots", str(folder / "plots")
    return compare("--only", "jolt", "--only", "shake_3hz", *files)


@pytest.fixture(scope="module")
def said(done: subprocess.CompletedProcess[str], folder: pathlib.Path) -> dict[str, Any]:
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads((folder / "figures.json").read_text())
    return document


@pytest.mark.long
def test_every_law_has_every_figure_in_every_scenario(said: dict[str, Any]) -> None:
    assert list(said["scenarios"]) == ["shake_3hz", "jolt"]  # the table's order, not that of the options
    for laws in said["scenarios"].values():
        assert list(laws) == list(LAWS)
        assert all(set(figures) == FIGURES for figures in laws.values())
        assert all(figures["eta_true_rms_pct"] <= figures["eta_true_max_pct"] for figures in laws.values())


@pytest.mark.long
def test_every_active_law_is_better_than_none_and_none_is_sandbagged(said: dict[str, Any]) -> None:
    shake, jolt = said["scenarios"]["shake_3hz"], said["scenarios"]["jolt"]
    for law in list(LAWS)[1:]:
        assert shake[law]["eta_true_max_pct"] < shake["passive"]["eta_true_max_pct"]
        assert jolt[law]["settle_s"] < 1.0  # at 10 mm/s the millimetre alone takes 0.1 s
        assert jolt[law]["speed_max_mm_s"] <= RIG.tension.speed_max_mm_s * 1.01
    assert jolt["passive"]["settle_s"] is None
    assert {laws[name]["ended"] for laws in (shake, jolt) for name in laws} == {"COMPENSATING", "LOCKED"}


@pytest.mark.long
def test_the_locked_cylinder_shakes_by_what_the_spring_says(said: dict[str, Any]) -> None:
    expected_pct = RIG.plant.stiffness_n_mm * 0.05 / RIG.tension.target_n * 100.0
    assert said["scenarios"]["shake_3hz"]["passive"]["eta_true_max_pct"] == pytest.approx(expected_pct, rel=0.03)


@pytest.mark.long
def test_ours_is_held_against_its_limits(said: dict[str, Any]) -> None:
    limits = {(row["scenario"], row["quantity"]): row for row in said["limits"]}
    assert set(limits) == {("shake_3hz", "eta_true_max_over_passive"), ("jolt", "settle_s")}
    jolt = limits["jolt", "settle_s"]
    assert jolt["measured"] == said["scenarios"]["jolt"]["ours"]["settle_s"]
    assert all(row["ok"] is (row["measured"] <= row["limit"]) for row in said["limits"])


@pytest.mark.long
def test_what_the_cell_is_wrong_by_the_load_is_wrong_by(said: dict[str, Any]) -> None:
    cell = said["cell"]
    sum_pct = sum(cell["budget_n"].values()) / 300.0 * 100.0
    assert 0.05 < cell["combined_n"] / 300.0 * 100.0 < sum_pct
    for name, having in cell["ours_with_errors"].items():
        without = said["scenarios"][name]["ours"]
        assert having["eta_true_max_pct"] == pytest.approx(sum_pct, abs=1.2 * without["eta_true_max_pct"])
        assert having["eta_true_rms_pct"] == pytest.approx(sum_pct, abs=2.0 * without["eta_true_rms_pct"])


@pytest.mark.long
def test_what_commissioning_leaves_of_the_cells_errors_is_small(said: dict[str, Any]) -> None:
    """All at once and of one sign, where the uncorrected cell adds 0.12 %."""
    for name, known in said["cell"]["ours_commissioned"].items():
        assert known["eta_true_max_pct"] < said["scenarios"][name]["ours"]["eta_true_max_pct"] + 0.04


@pytest.mark.long
def test_the_json_says_by_which_rule_and_at_what_price(said: dict[str, Any]) -> None:
    laws = said["controllers"]
    assert set(laws) == set(LAWS)
    assert all(laws[name]["rule"] for name in laws)
    assert laws["passive"]["ms"] is None
    assert min((laws[name]["ms_family"], name) for name in laws if laws[name]["ms_family"] is not None)[1] == "ours"


@pytest.mark.long
def test_the_terminal_says_where_ours_does_not_win(done: subprocess.CompletedProcess[str]) -> None:
    lines = done.stdout.splitlines()
    assert max(map(len, lines)) <= 100
    after = lines[lines.index("Where ours does not win") + 1 :]
    assert any(line.startswith("  jolt, settle: P ") for line in after)
    assert any("shake_3hz" in line and "at most" not in line for line in lines)
    progress = done.stderr.splitlines()  # no bar without a terminal, but a line each 10 s
    assert all(re.fullmatch(r"[a-z' ]+: [0-9]+ %.*", line) for line in progress)


@pytest.mark.long
def test_a_picture_of_all_and_one_per_trace(said: dict[str, Any], folder: pathlib.Path) -> None:
    assert said
    pictures = {file.name: file.read_bytes() for file in (folder / "plots").iterdir()}
    assert set(pictures) == {"eta_max.png", "jolt.png", "shake_3hz.png"}
    assert all(data.startswith(b"\x89PNG") and len(data) > 20_000 for data in pictures.values())


def test_a_run_changes_what_it_says_and_nothing_else() -> None:
    for run in compared_runs(RIG):
        settings = run.settings(RIG, "because")
        own = {"plant": RIG.plant, "simulation": RIG.simulation, "design": RIG.design, "safety": RIG.safety}
        assert settings.model_copy(update=own) == RIG
        heave_mm = run.changes.get("safety.heave_mm", RIG.safety.heave_mm)
        assert settings.safety == RIG.safety.model_copy(update={"heave_mm": heave_mm})
        assert settings.simulation is not None
        assert RIG.simulation is not None
        assert settings.simulation.seed == RIG.simulation.seed
        plant = {key.removeprefix("plant."): value for key, value in run.changes.items() if key.startswith("plant.")}
        assert settings.plant == RIG.plant.model_copy(update=plant)
        only_known = not any(key.startswith("simulation.") for key in run.changes)
        assert (settings.simulation == RIG.simulation) is only_known
    rubbing = next(s for s in compared_runs(RIG) if s.name == "friction_x2").settings(RIG, "because").simulation
    assert rubbing is not None
    assert rubbing.rail.friction_static == pytest.approx(2.0 * 0.012)
    assert rubbing.pulley.friction_dynamic == pytest.approx(2.0 * 0.0008)


def test_settling_is_over_when_the_error_stays_small() -> None:
    t_s = 1e-3 * np.arange(-100, 400, dtype=np.float64)
    error = np.where((t_s >= 0.0) & (t_s < 0.1), 1.0, 0.0)
    assert settling_s(t_s, error) == pytest.approx(0.1)
    again = error + np.where(np.isclose(t_s, 0.25), -0.2, 0.0)
    assert settling_s(t_s, again) == pytest.approx(0.251)
    assert settling_s(t_s, np.full_like(t_s, 0.2)) is None
    assert settling_s(t_s, np.where(t_s < 0.0, 9.0, 0.05)) == 0.0


def test_the_bar_moves_until_the_last_piece_of_work_is_done() -> None:
    chosen = [run for run in compared_runs(RIG) if run.name == "jolt"]
    laws = [LAWS[name] for name in ("passive", "ours")]
    done: list[tuple[float, str]] = []
    compare_laws(RIG, chosen, laws, lambda seconds, title: done.append((seconds, title)))
    total = sum(piece.cost for piece in pieces(RIG, chosen, laws).values())
    assert sum(seconds for seconds, _ in done) == pytest.approx(total)
    assert {title for _, title in done if title.startswith("robustness")} == {
        f"robustness: {law.title}" for law in laws
    }
    assert any("with the cell's errors" in title for _, title in done)


def test_the_quick_comparison_is_a_part_of_the_whole_one() -> None:
    whole = {run.name: run.seconds for run in compared_runs(RIG)}
    assert set(QUICK) < set(whole)
    assert sum(whole[name] for name in QUICK) < 0.3 * sum(whole.values())


@pytest.mark.long
def test_a_study_of_random_rigs_goes_on_where_it_was(tmp_path: pathlib.Path) -> None:
    """Processes share the rigs; a row is on disk once its rig is done, and none is played again."""
    rows, files = tmp_path / "rows.jsonl", [tmp_path / "two.json", tmp_path / "three.json", tmp_path / "again.json"]

    def said(count: int, file: pathlib.Path) -> tuple[str, list[dict[str, Any]]]:
        files = "--rows", str(rows), "--json", str(file)
        done = compare("--random", str(count), "--controllers", "ours_assumed", *files)
        assert done.returncode == 0, done.stderr
        return done.stdout, json.loads(file.read_text())["rigs"]

    two, three, again = (said(count, file) for count, file in zip((2, 3, 3), files, strict=True))
    assert [row["rig"] for row in three[1]] == [0, 1, 2]
    assert three[1][:2] == two[1]
    assert again[1] == three[1]
    assert [out.count("\nrig ") + out.startswith("rig ") for out, _ in (two, three, again)] == [2, 1, 0]
    assert len(rows.read_text().splitlines()) == 1 + 3
    assert len({row["stiffness_n_mm"] for row in three[1]}) == 3


@pytest.mark.long
def test_the_bound_of_a_jolt_is_below_ours(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "bound.json"
    done = compare("--bound", "--only", "jolt", "--designs", "1", "--json", str(file))
    assert done.returncode == 0, done.stderr
    row = json.loads(file.read_text())["rows"]["jolt"]
    assert 1.0 < row["ours_alone"]["over_bound"] < 2.0


@pytest.mark.long
def test_shares_of_a_group_go_on_where_they_were(tmp_path: pathlib.Path) -> None:
    """One law, one group, three seeds; the second time every figure is from the rows."""
    rows, files = tmp_path / "rows.jsonl", [tmp_path / "first.json", tmp_path / "second.json"]

    def said(file: pathlib.Path) -> dict[str, Any]:
        small = "--only", "shake_3hz", "--controllers", "pi", "--designs", "1"
        done = compare("--shares", str(file), *small, "--rows", str(rows))
        assert done.returncode == 0, done.stderr
        assert "lowest or tied, of 1 group: PI 1\n" in done.stdout
        found: dict[str, Any] = json.loads(file.read_text())
        return found

    first = said(files[0])
    kept = rows.read_text()
    assert said(files[1]) == first
    assert rows.read_text() == kept
    found = first["groups"]["shake_3hz"]
    assert found["laws"]["pi"]["over_bound"] == pytest.approx(
        found["laws"]["pi"]["error_pct"] / found["bounds_pct"]["shake_3hz"]
    )
    assert found["laws"]["pi"]["over_bound"] > 1.0
    assert 1.0 < found["laws"]["pi"]["spread"] < 1.1
    assert (first["seeds"], first["joint"]) == ([1, 2, 3], [])
