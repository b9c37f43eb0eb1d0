"""``rigctl tune`` as a user runs it: exit codes, table, JSON, picture."""

from __future__ import annotations

import json
import pathlib
import re
import subprocess
import sys
import threading
from collections.abc import Callable

import pytest

from rigctl.cli import progress as progress_lines
from rigctl.cli.progress import progress
from rigctl.config import rig_file
from rigctl.config.settings import RigSettings
from rigctl.design import design_text, margin_plot
from rigctl.design.in_use import design_in_use
from rigctl.design.margins import design_and_check
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import until

Rig = Callable[..., RigSettings]
Command = Callable[..., "subprocess.CompletedProcess[str]"]
PAPER = "config/paper_rig.yaml"
NO_SPRING = {"spring_n_mm": None}  # unstable with a compliant mechanism, fine with a rigid one
WAIVER = "rigid mechanism,\nchecked by hand"


def test_json_has_what_the_contract_says(in_process: Command) -> None:
    answer = in_process("rigctl", "tune", PAPER, "--json", "-")
    assert (answer.returncode, answer.stderr) == (0, "")
    said = json.loads(answer.stdout)
    assert set(said["gains"]) == {"k_tension", "k_speed", "k_integral"}
    keys = {"k_m", "k_scale", "delay_scale", "ms", "gm_db", "pm_deg", "dm_ms"}
    assert all(keys <= set(member) for member in said["margins"])
    family = {(m["k_m"], m["k_scale"], m["delay_scale"]) for m in said["margins"]}
    assert family == {(k_m, k, d) for k_m in (None, 1000.0, 60.0, 20.0, 6.0) for k in (0.8, 1.0, 1.2) for d in (1, 2)}
    assert {m["k_m"] for m in said["reported"]} == {2.0}
    assert said["accepted"] is True
    assert said["ms_max"] == max(max(m["ms"], m["ms_output"]) for m in said["margins"])
    assert said["ms_max"] <= 1.6
    assert len(said["provenance"]["inputs_sha256"]) == 64


def test_everything_at_once(tmp_path: pathlib.Path, in_process: Command) -> None:
    figures, plot, gains = tmp_path / "t.json", tmp_path / "t.PNG", tmp_path / "gains.yaml"
    answer = in_process("rigctl", "tune", PAPER, "--json", str(figures), "--plot", str(plot), "--gains", str(gains))
    assert (answer.returncode, answer.stderr) == (0, "")
    assert "accepted: Ms 1.5" in answer.stdout
    assert answer.stdout.count("<- worst") == 1
    assert plot.read_bytes().startswith(b"\x89PNG")
    made = json.loads(figures.read_text())["provenance"]["inputs_sha256"]
    assert made in gains.read_text()
    # The file is overwritten, and used from a rig file beside it.
    assert in_process("rigctl", "tune", PAPER, "--gains", str(gains)).returncode == 0
    rig = daemons.rig_file(tmp_path, {"design": {"gains_file": gains.name}})
    assert f"takes the gains of {gains}, not these" in in_process("rigctl", "tune", str(rig)).stdout


def test_a_refused_design_is_exit_code_1_and_said_in_words(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = daemons.rig_file(tmp_path, {"plant": NO_SPRING})
    answer = in_process("rigctl", "tune", str(file), "--gains", str(tmp_path / "g.yaml"))
    assert answer.returncode == 1
    assert answer.stdout.count("UNSTABLE") > 1
    assert answer.stderr.count("\n") == 1
    assert (
        "design refused: unstable with 12 of 30 plants, expected at most 1.6 (or a design.waiver in words)"
        in answer.stderr
    )
    assert "accepted: false" in (tmp_path / "g.yaml").read_text()
    said = json.loads(in_process("rigctl", "tune", str(file), "--json", "-").stdout)
    assert (said["accepted"], said["ms_max"]) == (False, None)
    assert {m["ms"] for m in said["margins"] if not m["stable"]} == {None}


def test_numbers_no_plant_has_are_one_line(tmp_path: pathlib.Path, in_process: Command) -> None:
    answer = in_process("rigctl", "tune", str(daemons.rig_file(tmp_path, {"plant": {"spring_n_mm": 1e-300}})))
    assert answer.returncode == 2
    assert "no design" in answer.stderr
    assert answer.stderr.count("\n") == 1


def test_a_closed_pipe_is_no_error() -> None:
    answer = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m rigctl tune {PAPER} | head -1"],
        capture_output=True, text=True, check=True, cwd=ROOT,
    )  # fmt: skip
    assert answer.stdout == "paper_rig: gains\n"
    assert answer.stderr == ""


@pytest.mark.parametrize("plant", [{}, NO_SPRING, {**NO_SPRING, "mechanism_n_mm": 6.0}])
def test_table_fits_80_columns_and_shows_every_plant(rig: Rig, plant: dict[str, float | None]) -> None:
    settings = rig(plant=plant)
    found = design_and_check(settings)
    shown = list(design_text.lines(settings, found))
    assert sum(" x 0.8 " in line or " x 1 " in line or " x 1.2 " in line for line in shown) == 36
    assert sum("UNSTABLE" in line for line in shown) == sum(not m.stable for m in (*found.margins, *found.reported)) + (
        found.performance is None
    )
    assert max(len(line) for line in shown[:-1] if not line.startswith(("accepted", "design", "WARNING"))) <= 80


def test_a_waiver_is_shown_with_its_words_on_one_line(rig: Rig) -> None:
    settings = rig(plant=NO_SPRING, design={"waiver": WAIVER})
    *_, verdict, warning = design_text.lines(settings, design_and_check(settings))
    assert verdict == "accepted: unstable with 12 of 30 plants (limit 1.6, waived)"
    assert warning.endswith("waived: rigid mechanism, checked by hand")


def test_a_waiver_that_does_not_help_is_said_so(rig: Rig) -> None:
    settings = rig(plant={**NO_SPRING, "mechanism_n_mm": 6.0}, design={"waiver": WAIVER})
    assert "no waiver helps" in design_and_check(settings).verdict()


def test_an_ms_just_above_its_limit_is_not_shown_as_equal(rig: Rig) -> None:
    ms = design_and_check(rig()).ms_max
    assert f"Ms {ms:.6f}" in design_and_check(rig(design={"ms_max": ms - 1e-5})).verdict()


@pytest.mark.parametrize(
    ("suffix", "start", "plant"),
    [(".png", b"\x89PNG", {}), (".svg", b"<?xml", {**NO_SPRING, "mechanism_n_mm": 6.0}), (".pdf", b"%PDF", {})],
)
def test_picture_of_any_design_in_every_format(
    rig: Rig, tmp_path: pathlib.Path, suffix: str, start: bytes, plant: dict[str, float | None]
) -> None:
    settings = rig(plant=plant)
    margin_plot.draw(settings, design_and_check(settings), tmp_path / f"x{suffix}")
    assert (tmp_path / f"x{suffix}").read_bytes().startswith(start)


def test_check_refuses_the_design_that_run_refuses(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = daemons.rig_file(tmp_path, {"design": {"stretch_weight": 500.0}})
    answer = in_process("rigctl", "check", file)
    assert (answer.returncode, answer.stderr.count("\n")) == (1, 1)
    refused = design_in_use(rig_file.load(file))
    assert answer.stderr == f"rigctl: {file}: {refused.verdict()}\n"
    said = json.loads(in_process("rigctl", "check", file, "--json").stdout)
    assert said["accepted"] is said["design"]["accepted"] is False


def test_check_refuses_a_gain_file_that_run_refuses(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = daemons.rig_file(tmp_path, {"design": {"gains_file": "none.yaml"}})
    answer = in_process("rigctl", "check", file)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert "none.yaml: " in answer.stderr


def test_check_says_the_design_that_run_says(in_process: Command) -> None:
    answer = in_process("rigctl", "check", PAPER)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert re.search(
        r"^design: Ms 1\.5\d+ over the assumed family of plants \(limit 1\.6\)$", answer.stdout, re.MULTILINE
    )


def test_a_long_search_says_every_few_seconds_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with progress("a moment", 1.0) as advance:
        advance(1.0, "")
    assert capsys.readouterr().err == ""
    assert progress_lines.LINE_EVERY_S == 10.0
    monkeypatch.setattr(progress_lines, "LINE_EVERY_S", 0.01)
    with progress("weights", 600.0) as advance:
        advance(30.0, "first")
        until(lambda: "weights: 5 %, first\n" in capsys.readouterr().err, "the share")
        advance(570.0, "")
        until(lambda: "weights: 100 %, first\n" in capsys.readouterr().err, "the whole")
    with progress("compiling", None):
        until(lambda: "compiling: 0 s\n" in capsys.readouterr().err, "the time")
    capsys.readouterr()
    assert "progress" not in [thread.name for thread in threading.enumerate()]
