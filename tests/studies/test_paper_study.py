"""The paper's study as a user runs it: one process, every case, both ways."""

from __future__ import annotations

import json
import pathlib
import re
import subprocess
import sys
from typing import Any

import pytest

from hil.studies.paper.cases import FIGURE_9, NO_SPRING, cases
from hil.studies.paper.claims import CLAIMS
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

pytestmark = pytest.mark.long


def study(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hil", "paper", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience_s(300.0), check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return tmp_path_factory.mktemp("paper")


@pytest.fixture(scope="module")
def done(folder: pathlib.Path) -> subprocess.CompletedProcess[str]:
    return study("--json", str(folder / "rows.json"), "--plots", str(folder / "plots"))


@pytest.fixture(scope="module")
def said(done: subprocess.CompletedProcess[str], folder: pathlib.Path) -> dict[str, Any]:
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads((folder / "rows.json").read_text())
    return document


def test_every_claim_agrees_but_those_known_to_differ(said: dict[str, Any]) -> None:
    differing = {row["id"] for row in said["rows"] if not row["ok"]}
    assert differing == {claim.id for claim in CLAIMS if claim.shortfall}  # a shortfall that is not needed must go
    assert said["total"] == len(said["rows"]) == len(CLAIMS)
    assert said["ok_count"] == said["total"] - len(differing)


def test_a_row_says_what_its_verdict_rests_on(said: dict[str, Any]) -> None:
    for row in said["rows"]:
        assert row["ok"] is (row["low"] <= row["model"] <= row["high"]), row["id"]
        assert row["ok"] or row["note"]


def test_the_loop_holds_every_case_an_order_better_than_the_locked_cylinder(said: dict[str, Any]) -> None:
    closed = said["closed_loop"]
    assert set(closed) == {case.name for case in cases()}
    assert {run["ended"] for run in closed.values()} == {"COMPENSATING"}
    rows = {row["id"]: row["model"] for row in said["rows"]}
    for k in (6, 13, 20, 27, 34):
        assert 10.0 * closed[f"k={k}"]["eta_max_pct"] < rows[f"fig6_k{k}_peak_eta"]
    assert closed[NO_SPRING]["waived"]
    assert closed[FIGURE_9]["stroke_mm"] == pytest.approx(1.5, abs=0.3)  # it takes up the level error and the lag


def test_a_picture_per_figure(said: dict[str, Any], folder: pathlib.Path) -> None:
    assert said
    pictures = {file.name: file.read_bytes() for file in (folder / "plots").iterdir()}
    assert set(pictures) == {f"fig{n}.png" for n in (4, 5, 6, 7, 9)}
    assert all(data.startswith(b"\x89PNG") and len(data) > 20_000 for data in pictures.values())


def test_the_terminal_shows_a_table_per_figure(done: subprocess.CompletedProcess[str]) -> None:
    lines = done.stdout.splitlines()
    for title in ("Figure 4", "Figures 5 and 6", "Figure 7", "Figure 9", "The same cases"):
        assert any(line.startswith(title) for line in lines), title
    assert max(map(len, lines)) <= 80
    assert "DIFFERS" in done.stdout
    progress = done.stderr.splitlines()  # no bar without a terminal, but a line each 10 s
    assert all(re.fullmatch(r"[a-z' ]+: [0-9]+ %.*", line) for line in progress)
