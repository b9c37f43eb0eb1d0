"""``rigctl report``: verdict, exit codes, refusals, and the same page for the same data."""

from __future__ import annotations

import json
import pathlib
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from rigctl.model.states import Mode
from rigctl.recorder.audit_log import Item
from tests.builders.full_disk import files_of_at_most
from tests.builders.paths import ROOT
from tests.builders.synthetic import OFFSET_NS, Floats, active, compensating, mode_events, run, stay, write
from tests.conftest import Command


def small(t_s: Floats) -> Floats:
    return 0.3 * np.sin(2 * np.pi * 0.5 * t_s)


def constant(newtons: float) -> Any:
    return lambda t_s: np.full_like(t_s, newtons)


def report(in_process: Command, file: pathlib.Path, *more: object) -> tuple[int, dict[str, Any], str]:
    """Exit code, figures, standard error."""
    done = in_process("rigctl", "report", file, "--json", *more)
    return done.returncode, json.loads(done.stdout) if done.stdout else {}, done.stderr


def test_a_small_error_passes_and_the_figures_are_those_of_the_error(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    file = write(tmp_path / "good.mcap", compensating(small))
    code, figures, said = report(in_process, file)
    assert (code, figures["verdict"], said) == (0, "passed", "")
    assert figures["error"]["eta_max_pct"] == pytest.approx(0.1, rel=1e-3)  # recorded as 32-bit floats
    assert figures["error"]["eta_rms_pct"] == pytest.approx(0.1 / np.sqrt(2), rel=1e-3)
    assert figures["basis"] == "cell"
    assert figures["files"][0]["sha256"] == figures["sha256"]
    assert figures["sensor_budget_n"]["combined"] == pytest.approx(0.195, abs=0.001)


@pytest.mark.parametrize(
    ("error_n", "missed"),
    [
        (1.4, []),
        (1.6, ["rig's own limit, 1.5 N (log)"]),
        (15.2, ["largest error, requirement", "rig's own limit, 1.5 N (log)", "rig's own limit, 15 N (hold)"]),
    ],
)
def test_an_error_beyond_a_limit_fails(
    error_n: float, missed: list[str], tmp_path: pathlib.Path, in_process: Command
) -> None:
    file = write(tmp_path / "bad.mcap", compensating(constant(error_n)))
    code, figures, said = report(in_process, file)
    assert [row["name"] for row in figures["criteria"] if row["met"] is False] == missed
    assert code == (1 if missed else 0)
    assert figures["verdict"] == ("failed" if missed else "passed")
    assert said == (f"rigctl: {file}: not met: {', '.join(missed)}\n" if missed else "")


def test_a_limit_is_passed_only_after_its_persistence(tmp_path: pathlib.Path, in_process: Command) -> None:
    def burst(t_s: Floats) -> Floats:  # 1.5 N may be exceeded for 1 s
        return np.where((t_s > 5.0) & (t_s < 5.9), 2.0, 0.0)

    code, figures, _ = report(in_process, write(tmp_path / "burst.mcap", compensating(burst)))
    assert (code, figures["verdict"]) == (0, "passed")
    assert figures["error"]["eta_max_pct"] == pytest.approx(2.0 / 3.0, rel=1e-3)


def test_a_phase_that_a_trip_ended_fails_and_the_trip_has_its_dump(tmp_path: pathlib.Path, in_process: Command) -> None:
    records = run(stay(Mode.HOLD, 1.0), stay(Mode.COMPENSATING, 5.0, small), stay(Mode.FAULT, 1.0))
    t_ns = int(records["t_ns"][6000])
    wall_ns = t_ns + OFFSET_NS
    trip = Item(t_ns, wall_ns, "trip", "trip E_STOP: emergency stop pressed", "", {"severity": "error"}, "events", 9)
    code, figures, said = report(in_process, write(tmp_path / "trip.mcap", records, [*mode_events(records), trip]))
    assert code == 1
    assert "phases ended by a trip" in said
    assert [row["reason"] for row in figures["trips"]] == ["trip E_STOP: emergency stop pressed"]
    assert figures["phases"][0]["faulted"]


def test_a_recording_without_a_compensating_phase_has_nothing_to_judge(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    file, page = write(tmp_path / "idle.mcap", run(stay(Mode.HOLD, 3.0))), tmp_path / "idle.html"
    code, figures, said = report(in_process, file, "-o", page)
    assert (code, figures["verdict"], figures["error"]) == (1, "nothing to judge", None)
    assert said == f"rigctl: {file}: no compensating phase in it: nothing to judge\n"
    assert "there is no error to judge" in page.read_text()


def test_a_recording_cut_short_is_flagged(tmp_path: pathlib.Path, in_process: Command) -> None:
    file, page = write(tmp_path / "cut.mcap", compensating(small)), tmp_path / "cut.html"
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * 2 // 3])
    code, figures, _ = report(in_process, file, "-o", page)
    assert (code, figures["complete"], figures["verdict"]) == (0, False, "passed")
    assert "cut short or damaged" in figures["remarks"][0]
    assert "Recording not complete" in page.read_text()
    assert "passed, on what there is" in page.read_text()


def test_records_missing_from_the_judged_time_fail(tmp_path: pathlib.Path, in_process: Command) -> None:
    records = np.delete(compensating(small), slice(9000, 9500))
    code, figures, _ = report(in_process, write(tmp_path / "gap.mcap", records))
    assert (code, figures["verdict"]) == (1, "failed")
    assert figures["remarks"] == ["500 records are missing after 8.999 s"]


def test_settings_of_another_version_are_told_and_the_requirement_is_judged_all_the_same(
    tmp_path: pathlib.Path, in_process: Command
) -> None:
    file = write(tmp_path / "old.mcap", compensating(small), document=active(loop={"rate": "unknown"}))
    code, figures, _ = report(in_process, file, "-o", tmp_path / "old.html")
    assert code == 0
    assert "the rig's own limits are not judged" in figures["remarks"][0]
    assert (tmp_path / "old.html").exists()


@pytest.mark.study
def test_the_same_recording_gives_the_same_page_in_every_process(tmp_path: pathlib.Path) -> None:
    file = write(tmp_path / "twice.mcap", compensating(small, 6.0))
    pages = [tmp_path / "one.html", tmp_path / "two.html"]
    for page, seed in zip(pages, ("1", "2"), strict=True):
        command = [sys.executable, "-m", "rigctl", "report", str(file), "-o", str(page)]
        environment = {"PATH": "/usr/bin:/bin", "PYTHONHASHSEED": seed, "TZ": f"UTC-{seed}"}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_it_never_writes_over_its_recording(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = write(tmp_path / "own.mcap", compensating(small, 4.0))
    whole = file.read_bytes()
    other_name = tmp_path / "own.html"
    other_name.symlink_to(file)
    for output in (file, other_name):
        done = in_process("rigctl", "report", file, "-o", output)
        assert done.returncode == 2
        assert done.stderr.startswith("rigctl: --output: ")
        assert done.stderr.count("\n") == 1
    assert file.read_bytes() == whole


def test_a_page_that_cannot_be_written_leaves_the_old_one(tmp_path: pathlib.Path, in_process: Command) -> None:
    file, page = write(tmp_path / "full.mcap", compensating(small, 4.0)), tmp_path / "page.html"
    page.write_text("the old one")
    with files_of_at_most(100):
        done = in_process("rigctl", "report", file, "-o", page)
    assert (done.returncode, done.stderr) == (2, f"rigctl: {page} cannot be written: File too large\n")
    assert page.read_text() == "the old one"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full.mcap", "page.html"]


def test_a_recording_without_records_is_refused(tmp_path: pathlib.Path, in_process: Command) -> None:
    file = write(tmp_path / "bare.mcap", run(stay(Mode.HOLD, 0.0)))
    done = in_process("rigctl", "report", file, "-o", tmp_path / "x.html")
    assert done.returncode == 2
    assert done.stderr == f"rigctl: {file}: found no record, expected a recording of a loop that ran\n"


@pytest.mark.parametrize("ticks", [1, 2, 40])
def test_a_recording_of_hardly_a_tick_has_its_page(ticks: int, tmp_path: pathlib.Path, in_process: Command) -> None:
    file, page = write(tmp_path / "short.mcap", run(stay(Mode.HOLD, ticks / 1000))), tmp_path / "short.html"
    code, figures, said = report(in_process, file, "-o", page)
    assert (code, figures["timing"]["ticks"], said.count("\n")) == (1, ticks, 1)
    assert "</html>" in page.read_text()


@pytest.mark.study
def test_documents_of_another_kind_are_left_out(tmp_path: pathlib.Path, in_process: Command) -> None:
    documents: list[dict[str, Any]] = [
        {"settings": [1], "design": {"gains": 3, "margins": [1, {"ms": "x"}], "warnings": "w"}},
        {"settings": {"loop": 1, "tension": {"target_n": {"a": 1}}}, "design": []},
    ]
    for number, document in enumerate(documents):
        page = tmp_path / f"{number}.html"
        file = write(tmp_path / f"{number}.mcap", compensating(small, 4.0), document=document)
        code, figures, said = report(in_process, file, "-o", page)
        assert (code, figures["verdict"], said) == (0, "passed", "")
        assert "</html>" in page.read_text()
