"""``python -m hil scenario`` as users run it: real processes, files in, figures out."""

from __future__ import annotations

import json
import os
import pathlib
import pty
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from hil.plant import layout
from hil.plant.inputs import Track
from hil.scenario.case import load
from hil.scenario.figures import LOOP_FIGURES, TRUTH_FIGURES, figures, first_peak
from hil.scenario.play import play
from rigctl.config import rig_file as config
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

SCENARIOS = ROOT / "config/scenarios"

LOCKED = """\
scenario: probe
rig: RIG
sets: [ideal]
controller: locked
duration_s: 3.0
disturbances:
  mechanism:
    - {kind: rotate, angle_deg: 5.0, speed_deg_s: 0.5, acceleration_deg_s2: 0.25}
windows:
  end: {from_s: 2.0, to_s: 3.0}
""".replace("RIG", str(ROOT / "config/paper_rig.yaml"))

Write = Callable[..., pathlib.Path]
Command = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def scenario(in_process: Command) -> Command:
    return lambda *arguments: in_process("hil", "scenario", *arguments)


@pytest.fixture
def write(tmp_path: pathlib.Path) -> Write:
    def file(*changes: tuple[str, str]) -> pathlib.Path:
        text = LOCKED
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "probe.yaml").write_text(text)
        return tmp_path / "probe.yaml"

    return file


def test_the_papers_passive_case_has_the_papers_figures(tmp_path: pathlib.Path, scenario: Command) -> None:
    done = scenario(SCENARIOS / "paper_k6.yaml", "--json", tmp_path / "k6.json", "--plot", tmp_path / "k6.svg")
    assert (done.returncode, done.stderr) == (0, "")
    said = json.loads((tmp_path / "k6.json").read_text())
    run, plateau = said["truth"]["run"], said["truth"]["plateau"]
    assert set(run) == {figure.name for figure in TRUTH_FIGURES}
    assert said["loop"] is None
    assert said["ended"] == {"mode": "LOCKED", "fault": "NONE", "tripped": False, "tripped_at_s": None}
    # section 2: eta 0.31 %, lag 0.69 to 0.70 deg, its plateau below, normal +-0.07 deg; the paper's texts differ
    assert run["eta_max_pct"] == pytest.approx(0.31, abs=0.05)
    assert run["tangential_peak_deg"] == pytest.approx(0.70, abs=0.08)
    assert 0.45 < plateau["tangential_mean_deg"] < 0.72
    assert abs(run["normal_peak_deg"]) < 0.08
    assert run["vertical_first_peak_at_s"] == pytest.approx(4.5, abs=1.0)
    assert run["stroke_used_mm"] == run["speed_max_mm_s"] == 0.0
    # the table shows the figures of the file and fits a terminal
    assert f"{run['eta_max_pct']:.4f}" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "\x1b" not in done.stdout
    assert (tmp_path / "k6.svg").read_text().startswith("<?xml")


def test_the_loop_does_better_and_says_what_it_saw(tmp_path: pathlib.Path, write: Write, scenario: Command) -> None:
    change = ("sets: [ideal]\ncontroller: locked\nduration_s: 3.0", "duration_s: 6.0")
    done = scenario(write(change), "--json", "-", "--plot", tmp_path / "loop.png")
    assert (done.returncode, done.stderr) == (0, "")
    said = json.loads(done.stdout)
    assert (said["controller"], said["ended"]["mode"]) == ("loop", "COMPENSATING")
    truth, loop = said["truth"]["run"], said["loop"]["run"]
    assert set(loop) == {figure.name for figure in LOOP_FIGURES}
    assert truth["eta_max_pct"] < 0.05  # locked: 0.3 %; the demo's own limit is 0.1 %
    assert loop["estimated_eta_rms_pct"] < loop["cell_eta_rms_pct"]
    assert (loop["compensating_pct"], loop["skipped"], loop["frames_lost"]) == (100.0, 0.0, 0.0)
    assert truth["stroke_used_mm"] > 0.05
    assert (tmp_path / "loop.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("jolt", marks=pytest.mark.gate),
        pytest.param("uneven_rail", marks=pytest.mark.gate),
        "vertical_10mm",
        *(pytest.param(name, marks=pytest.mark.long) for name in ("mass_change", "shake_3hz", "level_runout")),
    ],
)
def test_a_scenario_we_ship_plays_without_a_trip(name: str) -> None:
    case = load(SCENARIOS / f"{name}.yaml")
    played = play(
        case.settings,
        case.tracks,
        seconds=min(case.scenario.duration_s, 10.0),
        controller=case.scenario.controller,
        target_n=case.target_n,
        settle_s=case.scenario.settle_s,
    )
    assert not played.ended.tripped
    assert figures(played, {"run": (0.0, 10.0)})["truth"]["run"]["eta_max_pct"] < 2.0  # type: ignore[index,operator]


def test_a_trip_is_a_result(tmp_path: pathlib.Path, write: Write, scenario: Command) -> None:
    fast = "- {kind: move, up_mm: -80.0, speed_mm_s: 100.0, acceleration_mm_s2: 1000.0, start_s: 0.5}"
    change = ("sets: [ideal]\ncontroller: locked", "controller: loop")
    done = scenario(
        write(change, ("disturbances:\n", f"disturbances:\n  vertical:\n    {fast}\n")), "--json", tmp_path / "x"
    )
    assert (done.returncode, done.stderr) == (1, "")
    assert "TRIPPED at 0." in done.stdout
    ended = json.loads((tmp_path / "x").read_text())["ended"]
    assert ended["mode"] == "FAULT"
    assert ended["fault"] in ("LIMIT", "TENSION_HIGH")
    assert 0.5 < ended["tripped_at_s"] < 1.0


def test_a_rig_that_cannot_reach_its_target_is_said_in_one_line(write: Write, scenario: Command) -> None:
    change = ("sets: [ideal]\ncontroller: locked", "change: {cylinder: {stroke_max_mm: 30.0}}")
    done = scenario(write(change))
    assert (done.returncode, done.stdout) == (1, "")
    assert "FAULT, fault STROKE_END" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_refused_design_says_how_to_waive_it(write: Write, scenario: Command) -> None:
    loop = "sets: [ideal]\ncontroller: locked"
    done = scenario(write((loop, "change: {design: {ms_max: 1.05}}")))
    assert (done.returncode, done.stdout) == (2, "")
    assert "design refused: Ms" in done.stderr
    assert "design: waiver" in done.stderr
    assert done.stderr.count("\n") == 1
    waived = write((loop, "change: {design: {ms_max: 1.05, waiver: a test of the waiver}}"))
    assert scenario(waived).returncode == 0


def test_bad_input_is_one_line_and_exit_2(tmp_path: pathlib.Path, write: Write, scenario: Command) -> None:
    good = write()
    (tmp_path / "noise.yaml").write_bytes(bytes(range(256)))
    cases: list[tuple[list[object], str]] = [
        ([tmp_path / "none.yaml"], "cannot be read: No such file"),
        ([tmp_path], "cannot be read: Is a directory"),
        ([tmp_path / "noise.yaml"], "not UTF-8"),
        ([good, "--json", tmp_path / "no" / "x.json"], "--json: "),
        ([good, "--plot", tmp_path], "expected a name ending in .png, .svg, .pdf"),
        ([good, "--json", tmp_path], "cannot be written: Is a directory"),
        ([good, "--plot", tmp_path / "x.gif"], "expected a name ending in .png, .svg, .pdf"),
        ([good, "--plot", "/proc/x.png"], "--plot: /proc/x.png cannot be written"),
        ([good, "--nothing"], "--nothing"),
        ([], "Missing argument 'file'"),
    ]
    for arguments, words in cases:
        done = scenario(*arguments)
        assert (done.returncode, done.stdout) == (2, ""), arguments
        assert words in done.stderr
        assert done.stderr.count("\n") == 1, done.stderr
    assert not (tmp_path / "x.gif").exists()


def test_what_is_tried_for_writing_is_not_left_behind(tmp_path: pathlib.Path, write: Write, scenario: Command) -> None:
    (tmp_path / "kept.json").write_text("old")
    done = scenario(write(), "--json", tmp_path / "kept.json", "--plot", "/proc/x.png")
    assert done.returncode == 2
    assert (tmp_path / "kept.json").read_text() == "old"
    done = scenario(write(), "--json", tmp_path / "new.json", "--plot", "/proc/x.png")
    assert done.returncode == 2
    assert not (tmp_path / "new.json").exists()


def test_a_terminal_gets_a_bar_and_a_pipe_does_not(write: Write) -> None:
    file = write(("sets: [ideal]\ncontroller: locked\nduration_s: 3.0", "duration_s: 20.0"))
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "hil", "scenario", str(file), "--json", "-"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, cwd=ROOT, env={"TERM": "xterm"})
    os.close(theirs)
    drawn = b""
    while True:
        try:
            drawn += os.read(ours, 65536)
        except OSError:  # the other end is closed
            break
    out = process.communicate(timeout=patience_s())[0]
    os.close(ours)
    assert process.returncode == 0
    assert json.loads(out)["scenario"] == "probe"
    assert b"probe" in drawn
    assert b"running" in drawn


def test_the_same_scenario_is_the_same_run(write: Write) -> None:
    case = load(write(("sets: [ideal]\ncontroller: locked\nduration_s: 3.0", "duration_s: 3.0")))
    runs = [play(case.settings, case.tracks, seconds=1.0, controller="loop", target_n=250.0) for _ in range(2)]
    assert np.array_equal(runs[0].truth, runs[1].truth)
    assert runs[0].records is not None
    assert runs[0].records["target_n"][0] == 250.0
    assert runs[0].t_s[0] == 0.0
    assert np.allclose(np.diff(runs[0].t_s), 1e-3)


def test_locked_starts_at_exactly_the_target_and_stays_without_disturbance() -> None:
    settings = config.load(ROOT / "config/paper_rig.yaml")
    played = play(settings, {}, seconds=1.0, controller="locked", target_n=300.0)
    assert len(played.truth) == 1001
    assert np.allclose(played.truth["vertical_n"], 300.0, rtol=1e-6)  # slightly below the tension: plumb to 0.07 deg


def test_figures_of_a_known_force() -> None:
    settings = config.load(ROOT / "config/paper_rig.yaml")
    lift = Track(segments=np.array([(0.0, 0.0, 1.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0, 0.0)]), end=1.0)
    played = play(settings, {layout.HEIGHT: lift}, seconds=2.0, controller="locked", target_n=300.0)
    said = figures(played, {"run": (0.0, 2.0), "up": (1.5, 2.0)})["truth"]
    assert said is not None
    loss = settings.plant.stiffness_n_mm * 1.0
    assert said["up"]["eta_mean_pct"] == pytest.approx(100.0 * loss / 300.0, rel=1e-4)
    assert said["up"]["vertical_mean_n"] == pytest.approx(300.0 - loss, rel=1e-5)
    assert said["run"]["height_max_mm"] == pytest.approx(1.0)
    assert said["run"]["vertical_first_peak_n"] is None


@pytest.mark.parametrize(
    ("values", "index"),
    [
        ([0, 1, 2, 3], None),
        ([0, 5, 4.9, 6, 5, 7], 3),
        ([3, 2, 1], None),
        ([0, 2, 1, 9], 1),
        ([1, 1, 1], None),
        ([0, 20, 19.1, 20], None),
        ([0, 20, 18.9, 20], 1),
    ],
)
def test_the_first_peak_is_the_first_that_counts(values: list[float], index: int | None) -> None:
    assert first_peak(np.array(values, dtype=float)) == index


def test_every_shipped_scenario_says_what_it_is() -> None:
    files = sorted(SCENARIOS.glob("*.yaml"))
    assert len(files) >= 8
    for file in files:
        assert file.read_text().startswith("# ")
