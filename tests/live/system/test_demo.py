"""The demo in simulated and in real time: its figures, its keys, its verdict."""

from __future__ import annotations

import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import time
from typing import Any

import pytest

from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from rigctl.recorder import recording
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s
from tests.live.system.test_daemon import PATIENT

KEYS = {
    "eta_true_max_pct", "eta_true_rms_pct", "eta_cell_max_pct", "skipped_ticks", "ticks", "lateness_us", "work_us",
    "frames", "telemetry", "duration_s", "real_time", "passed",
}  # fmt: skip
SHORT: dict[str, Any] = {"angle_deg": 2.0}


def play(tmp_path: pathlib.Path, changes: dict[str, dict[str, Any]], *options: str) -> tuple[int, dict[str, Any], str]:
    figures = tmp_path / "demo.json"
    file = daemons.rig_file(tmp_path, changes)
    answer = daemons.rigctl("demo", str(file), "--json", str(figures), *options,
                            "--recordings", str(tmp_path / "recordings"))  # fmt: skip
    assert "Traceback" not in answer.stderr
    return answer.returncode, json.loads(figures.read_text()), answer.stdout


def replayed(file: str) -> tuple[int, bool]:
    """Ticks that a replay finds equal, and whether those are all ticks."""
    answer = daemons.rigctl("replay", file, "--json")
    assert answer.returncode in (0, 1), answer.stderr
    found = json.loads(answer.stdout)
    return sum(row["same"] for row in found["loops"]), found["identical"] and answer.returncode == 0


@pytest.mark.simulated_time
def test_the_papers_move_in_lockstep_is_within_the_limits(tmp_path: pathlib.Path) -> None:
    code, figures, said = play(tmp_path, {"demo": {"angle_deg": 13.0}}, "--lockstep")
    assert code == 0
    assert set(figures) >= KEYS
    assert figures["passed"] is True
    assert 0.0 < figures["eta_true_max_pct"] <= 0.10
    assert 0.0 < figures["eta_true_rms_pct"] <= 0.03
    assert figures["frames"]["lost"] == 0
    assert figures["skipped_ticks"] == 0
    assert (figures["telemetry"], figures["real_time"]) == (None, False)
    kept = recording.read(figures["recording"])
    assert figures["recording"] in said
    assert (len(kept.records), kept.complete, kept.gaps) == (figures["ticks"], True, [])
    assert replayed(figures["recording"]) == (figures["ticks"], True)
    assert "passed" in said


@pytest.mark.simulated_time
def test_limits_that_are_not_met_fail_the_demo(tmp_path: pathlib.Path) -> None:
    code, figures, said = play(tmp_path, {"demo": {**SHORT, "eta_max_pct": 0.001}}, "--lockstep")
    assert code == 1
    assert figures["passed"] is False
    assert "NOT MET" in said


@pytest.mark.alone
def test_in_real_time_every_part_runs_in_its_own_process(tmp_path: pathlib.Path) -> None:
    changes = {
        "demo": SHORT,
        "safety": {
            "stale_ms": 100,
            "bus_silent_ms": 100,
            "inclination_stale_ms": 500,
            "overrun_ticks": 900,
            "waiver": "a simulated rig on a busy machine",
        },
        "cylinder": {"command_deadline_ms": 150, "heartbeat_timeout_ms": 200},
        "telemetry": {"lease_s": 15},  # shorter than the time between two of its commands: it has to renew the lease
    }
    code, figures, said = play(tmp_path, changes)
    assert set(figures) >= KEYS
    assert figures["frames"]["lost"] == 0
    assert figures["frames"]["sent"] > 2 * figures["ticks"]
    assert figures["real_time"] is True
    assert figures["telemetry"]["produced"] > 20_000
    assert figures["telemetry"]["received"] == figures["telemetry"]["produced"]
    assert set(figures["lateness_us"]) == set(figures["work_us"]) == {"p50", "p99", "p999", "max"}
    assert figures["eta_true_max_pct"] <= 0.10
    assert (code, figures["passed"]) == (0, True), said
    kept = recording.read(*recording.parts_of(figures["recording"]))
    assert (kept.complete, kept.gaps) == (True, [])
    assert len(kept.records) >= figures["ticks"]
    assert replayed(figures["recording"]) == (len(kept.records), True)


@pytest.mark.alone
def test_beside_a_daemon_of_the_same_rig_the_demo_commands_its_own(tmp_path: pathlib.Path) -> None:
    patient = {**PATIENT, "demo": {**SHORT, "angle_deg": 0.5}}
    file, log = daemons.rig_file(tmp_path, patient), tmp_path / "daemon.log"
    before = sorted(path.name for path in tmp_path.glob("audit/*"))
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, log):
        runtime = Runtime.of(daemons.name_of(file))
        records, commands = runtime.records.reader(from_start=True), runtime.commands.reader(from_start=True)
        command = [sys.executable, "-m", "rigctl", "demo", str(file), "--recordings", str(tmp_path / "recordings")]
        with log.with_name("demo.log").open("wb") as out:
            demo = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT)
        said, modes, target = log.with_name("demo.log"), set[int](), runtime.read_json("active.json")["run_id"]
        until = time.monotonic() + patience_s()
        while "TENSIONING" not in said.read_text() and demo.poll() is None and time.monotonic() < until:
            modes |= set(records.read()["mode"].tolist())
            time.sleep(0.2)
        assert "TENSIONING" in said.read_text(), said.read_text()  # two loops may be too much for two processors to end
        demo.send_signal(signal.SIGINT)
        assert demo.wait(patience_s()) == 1
        assert "demo interrupted: its daemon held the stroke" in said.read_text()
        modes |= set(records.read()["mode"].tolist())
        given = {int(code) for code in commands.read()["verb"]}
        assert daemons.mode(file) == "DISARMED"
        assert daemons.state(file)["lease"] is None
        assert runtime.read_json("active.json")["run_id"] == target
    assert modes == {int(Mode.DISARMED)}
    assert not given & {int(verb) for verb in Verb}
    assert before == []
    assert {path.stem for path in tmp_path.glob("audit/*.jsonl")} == {daemons.name_of(file)}
    assert all(path.name.startswith("demo_") for path in (tmp_path / "recordings").glob("demo*"))


@pytest.mark.alone
def test_a_computer_that_stops_a_process_is_named_and_the_demo_ends_in_simulated_time(tmp_path: pathlib.Path) -> None:
    """The loop is stopped, then the simulated rig: both pauses are named, and the verdict is that of lockstep."""
    file, figures = daemons.rig_file(tmp_path, {"demo": SHORT}), tmp_path / "demo.json"
    command = [sys.executable, "-m", "rigctl", "demo", str(file), "--recordings", str(tmp_path / "recordings"),
               "--json", str(figures)]  # fmt: skip
    demo_rig = f"demo_{daemons.name_of(file)}"
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as demo:
        assert demo.stdout is not None
        said, stopped = "", set[int]()  # tries: the host may pause one of them before this test does
        for line in demo.stdout:
            said += line
            this_try = said.count("once more")
            if "COMPENSATING" in line and "settling" in line and this_try not in stopped:
                words = ("hil", "serve", "rigctl-demo-") if this_try else ("rigctl.control", demo_rig)
                for process in daemons.processes_with(*words):  # none where the host has ended this try already
                    os.kill(process, signal.SIGSTOP)
                    time.sleep(0.2)
                    os.kill(process, signal.SIGCONT)
                stopped.add(this_try)
        complaint = demo.stderr.read() if demo.stderr is not None else ""
    assert demo.returncode == 0, said + complaint
    assert "rigctl: demo" not in complaint
    pause = r"this computer stopped the (?:loop|simulated rig) for \d+ ms at \d+\.\d s, and the rig tripped.*; (.*)"
    assert re.findall(pause, said) == ["once more", "now in simulated time, which needs no real time"], said
    assert "s of simulated time" in said, said
    summary = json.loads(figures.read_text())
    assert (summary["real_time"], summary["passed"]) == (False, True), summary
    assert len(recording.read(summary["recording"]).records) == summary["ticks"]
