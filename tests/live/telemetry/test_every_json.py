"""``--json`` of every command of ``rigctl`` runs to its end and prints one JSON document, accepted or refused."""

from __future__ import annotations

import json
import pathlib
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
import typer

from rigctl.cli.typer_app import program
from rigctl.control.modes import Mode
from tests.builders import daemons
from tests.builders.miniature import Daemon, running
from tests.builders.paths import ROOT
from tests.builders.synthetic import Floats, compensating, write
from tests.builders.waiting import patience_s
from tests.conftest import Command

PAPER = "config/paper_rig.yaml"
OFFLINE = {
    "check": [PAPER],
    "tune": [PAPER],
    "keys": ["init", "--dir", "FOLDER/keys"],
    "info": ["FOLDER/some.mcap"],
    "report": ["FOLDER/some.mcap"],
    "demo": ["FOLDER/rig.yaml", "--lockstep", "--recordings", "FOLDER"],
}
COMMANDED = {
    "status": [], "alarms": [], "doctor": [PAPER], "lease": ["take"], "arm": [], "tension": [], "target": ["290"],
    "move": ["1"], "hold": [], "release": [], "disarm": [], "reset": [], "carry": ["5"], "lower": [],
    "confirm-stroke": ["0"], "tare": [], "calibrate": ["--shunt"], "identify": [], "gains": [PAPER],
}  # fmt: skip
ELSEWHERE = {
    "watch": "below, until Ctrl-C",
    "bench": "tests/live/system/test_bench.py",
    "replay": "tests/live/system/test_demo.py",
    "audit": "tests/unit/recorder/test_chain.py",
}


def with_json() -> set[str]:
    commands = typer.main.get_group(program()).commands
    return {name for name, one in commands.items() if any("--json" in option.opts for option in one.params)}


def test_every_command_with_json_is_run() -> None:
    assert with_json() == {*OFFLINE, *COMMANDED, *ELSEWHERE}
    for name, file in ELSEWHERE.items():
        if file.startswith("tests/"):
            text = (ROOT / file).read_text()
            assert f'"{name}"' in text and '"--json"' in text


def quiet(t_s: Floats) -> Floats:
    return 0.0 * t_s


@pytest.mark.parametrize("name", OFFLINE)
def test_json_of_a_command_without_a_daemon(in_process: Command, tmp_path: pathlib.Path, name: str) -> None:
    if name in ("info", "report"):
        write(tmp_path / "some.mcap", compensating(quiet))
    if name == "demo":
        daemons.rig_file(tmp_path, {"demo": {"angle_deg": 2.0}})
    words = [word.replace("FOLDER", str(tmp_path)) for word in OFFLINE[name]]
    done = in_process("rigctl", name, *words, "--json")
    assert done.returncode in (0, 1), done.stderr
    assert isinstance(json.loads(done.stdout), dict)


@pytest.fixture(scope="module")
def rig() -> Iterator[Daemon]:
    for found in running():
        found.client().close()
        yield found


def rigctl(rig: Daemon, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rigctl", *words], cwd=ROOT, env=rig.environment(), capture_output=True, text=True,
        timeout=patience_s(), check=False,
    )  # fmt: skip


@pytest.mark.parametrize("name", COMMANDED)
def test_json_of_a_command_to_a_daemon(rig: Daemon, name: str) -> None:
    done = rigctl(rig, name, *COMMANDED[name], "--json")
    assert done.returncode in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    found = json.loads(done.stdout)
    if name not in ("status", "alarms", "doctor"):
        assert found["accepted"] is (done.returncode == 0)
        assert found["text"]


def test_json_of_watch_is_a_document_in_each_line(rig: Daemon) -> None:
    words = [sys.executable, "-m", "rigctl", "watch", "--json"]
    with subprocess.Popen(words, cwd=ROOT, env=rig.environment(), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["mode"] in Mode.__members__
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=patience_s())
