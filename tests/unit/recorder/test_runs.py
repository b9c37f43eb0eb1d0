"""`rigctl runs`, and a run's name in place of a file."""

from __future__ import annotations

import json
import os
import pathlib
from typing import Any

import pytest

from rigctl.cli.recorded_runs import files_named
from rigctl.ipc import runtime_folder
from rigctl.recorder import parts
from rigctl.recorder.audit_log import moment
from rigctl.recorder.chain import ORIGIN, AuditEntry, line_of
from rigctl.recorder.runs import RecordedRun, named, recorded
from tests.builders.paths import ROOT
from tests.conftest import Command

S = 1_000_000_000
BEGAN_NS = 1_800_000_000 * S
RIG = "paper_rig"


def written(path: pathlib.Path, until_ns: int, size: int = 1000) -> pathlib.Path:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"0" * size)
    os.utime(path, ns=(until_ns, until_ns))
    return path


@pytest.fixture
def folders(tmp_path: pathlib.Path) -> tuple[pathlib.Path, pathlib.Path]:
    """Two runs of 90 s and 3 h, the first in two parts, and two dumps: within the first run, and after both."""
    recordings, trips = tmp_path / "recordings", tmp_path / "trips"
    for number, at_s in (("0001", 60), ("0002", 90)):
        written(parts.path_of(recordings, RIG, 3, BEGAN_NS, number), BEGAN_NS + at_s * S)
    written(parts.path_of(recordings, RIG, 4, BEGAN_NS + 200 * S, "0001"), BEGAN_NS + (200 + 10_800) * S)
    written(parts.path_of(recordings, "other_rig", 9, BEGAN_NS, "0001"), BEGAN_NS)
    for dump, at_s, fault in ((1, 50, "DRIVE_FAULT"), (2, 20_000, "E_STOP")):
        written(parts.path_of(trips, RIG, dump, BEGAN_NS + at_s * S, fault), BEGAN_NS + (at_s + 1) * S)
    return recordings, trips


def test_runs_have_number_duration_and_trips(folders: tuple[pathlib.Path, pathlib.Path]) -> None:
    first, second, drive, stop = recorded(*folders, RIG)
    assert [run.name for run in (first, second, drive, stop)] == ["3", "4", "trip-1", "trip-2"]
    assert (first.duration_s, second.duration_s) == (90.0, 10_800.0)
    assert (len(first.files), first.size) == (2, 2000)
    assert [run.outcome for run in (first, second, drive, stop)] == [
        "1 trip: DRIVE_FAULT", "no trip", "DRIVE_FAULT", "E_STOP",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "found"),
    [("last", "4"), ("3", "3"), ("trip", "trip-2"), ("trip-1", "trip-1"), ("9", None), ("trip-7", None)],
)
def test_a_name_finds_its_run(folders: tuple[pathlib.Path, pathlib.Path], name: str, found: str | None) -> None:
    run = named(recorded(*folders, RIG), name)
    assert (run.name if run else None) == found


def test_folders_that_are_not_there_hold_no_runs(tmp_path: pathlib.Path) -> None:
    assert recorded(None, tmp_path / "none", RIG) == []
    assert recorded(tmp_path / "none", None, RIG) == []


def test_a_run_written_under_a_clock_set_back_has_no_negative_duration(tmp_path: pathlib.Path) -> None:
    written(parts.path_of(tmp_path, RIG, 1, BEGAN_NS, "0001"), BEGAN_NS - 60 * S)
    (run,) = recorded(tmp_path, None, RIG)
    assert isinstance(run, RecordedRun)
    assert run.duration_s == 0.0


def of_daemon(monkeypatch: pytest.MonkeyPatch, *statuses: dict[str, Any]) -> None:
    monkeypatch.setattr(runtime_folder, "recorded", lambda: list(statuses))


def status(folders: tuple[pathlib.Path, pathlib.Path]) -> dict[str, Any]:
    return {"rig": RIG, "recording": {"folder": str(folders[0])}, "trips": str(folders[1]), "audit_log": "/none"}


def test_the_list_is_that_of_the_running_daemon(
    folders: tuple[pathlib.Path, pathlib.Path], in_process: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_daemon(monkeypatch, status(folders))
    done = in_process("rigctl", "runs")
    assert done.returncode == 0
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [line[0] for line in lines] == ["3", "4", "trip-1", "trip-2"]
    assert lines[1][3:] == ["3.0", "h", "1", "part,", "0.0", "MB", "no", "trip"]
    rows = json.loads(in_process("rigctl", "runs", "--json").stdout)
    assert [(row["kind"], row["number"]) for row in rows] == [("run", 3), ("run", 4), ("trip", 1), ("trip", 2)]


@pytest.mark.parametrize("words", [("info",), ("report",), ("replay",), ("export", "--to", "csv", "-o", "out")])
def test_a_run_takes_the_place_of_a_file(
    folders: tuple[pathlib.Path, pathlib.Path],
    in_process: Command,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
) -> None:
    of_daemon(monkeypatch, status(folders))
    done = in_process("rigctl", words[0], "last", *words[1:])
    assert done.returncode == 2
    assert parts.path_of(folders[0], RIG, 4, BEGAN_NS + 200 * S, "0001").name in done.stderr  # which is no recording
    done = in_process("rigctl", words[0], "77", *words[1:])
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "found '77', expected a file, or a run that rigctl runs lists" in done.stderr


@pytest.mark.parametrize(("daemons", "words"), [(0, "no daemon"), (2, "2 daemons")])
def test_without_one_daemon_a_name_is_refused(
    in_process: Command, monkeypatch: pytest.MonkeyPatch, daemons: int, words: str
) -> None:
    of_daemon(monkeypatch, *[{"rig": RIG, "recording": None, "trips": "/none", "audit_log": "/none"}] * daemons)
    done = in_process("rigctl", "runs")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert f"found {words} on this computer, expected one" in done.stderr


def test_a_file_of_that_name_is_the_file(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pathlib.Path("last").write_text("")
    assert files_named(pathlib.Path("last")) == (pathlib.Path("last"),)


def test_the_runs_of_a_rig_file_need_no_daemon(in_process: Command) -> None:
    assert in_process("rigctl", "runs", str(ROOT / "config/paper_rig.yaml")).returncode == 0


def test_notes_are_those_of_their_run(folders: tuple[pathlib.Path, pathlib.Path], tmp_path: pathlib.Path) -> None:
    log = tmp_path / "audit.jsonl"
    lines = []
    for n, (at_s, what, words) in enumerate(
        [(20, "operator_note", "new rope"), (30, "limit", "operator_note"), (300, "operator_note", "second article")], 1
    ):
        wall = moment(BEGAN_NS + at_s * S)
        entry = AuditEntry(n, RIG, wall, 1, what, "kim", words, {"reason": words}, "notes", n, {}, ORIGIN)
        lines.append(line_of(entry)[0])
    log.write_bytes(b"".join(lines) + b'{"what":"operator_note", torn')
    first, second, *_ = recorded(*folders, RIG, log)
    assert (first.notes, second.notes) == (("new rope",), ("second article",))


def test_a_folder_of_another_user_is_no_empty_one(
    folders: tuple[pathlib.Path, pathlib.Path], in_process: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)  # root may read everything
    of_daemon(monkeypatch, status(folders))
    done = in_process("rigctl", "runs")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"rigctl: {folders[0]} cannot be read: it is another user's; as root it can\n"
