"""Tare, calibration and identification by an operator, on a daemon and a rig in processes of their own."""

from __future__ import annotations

import contextlib
import json
import pathlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from rigctl.client.connection import Client
from rigctl.config import rig_file as config
from rigctl.control.excitation.frequency_trial import LONGEST_S
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry
from rigctl.ipc.runtime_folder import Runtime
from tests.builders import daemons
from tests.builders.operators import KIM
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until
from tests.live.system.test_daemon import PATIENT, Running

IDENTIFICATIONS = 10  # a busy host pauses the loop in half of them
RESPONSES = 3  # each takes a minute


def check_of(file: pathlib.Path, *, zero_n: float = 0.0) -> None:
    """Put a tare and a calibration check that passed into the ledger of a rig file."""
    settings = config.load(file)
    pair: dict[str, Any] = {
        "before": {"zero_n": 0.0, "scale": 1.0},
        "after": {"zero_n": zero_n, "scale": 1.0},
        "figures": {},
    }
    for what, passed in (("tare", None), ("calibrate", True)):
        ledger.append(settings, ledger.entry(settings, what, "kim", time.time_ns(), **pair, passed=passed))


def entries(file: pathlib.Path) -> list[Entry]:
    return ledger.read(config.load(file))


def rig_file(folder: pathlib.Path, **calibration: Any) -> pathlib.Path:
    return daemons.rig_file(folder, {**PATIENT, "calibration": calibration})


@pytest.fixture
def file(tmp_path: pathlib.Path) -> pathlib.Path:
    """A rig file without waivers, a tare, and a check that passed."""
    made = rig_file(tmp_path, waiver=None)
    check_of(made)
    return made


@pytest.fixture
def running(file: pathlib.Path) -> Iterator[Running]:
    log = file.with_name("daemon.log")
    with daemons.simulated_rig(file, file.with_name("rig.log")) as rig, daemons.daemon(file, log) as daemon:
        yield Running(file, daemon, rig, log)


@contextlib.contextmanager
def moving(file: pathlib.Path) -> Iterator[Client]:
    """A client, once the stroke moves: steps of an identification last a quarter of a second."""
    with Client(daemons.endpoint(file), daemons.name_of(file)) as client:
        until(lambda: client.state()["command_mm_s"] != 0.0)
        yield client


def identified(running: Running, file: pathlib.Path) -> dict[str, Any]:
    """The reply to an identification in tension, repeated where it reports that the host stopped the loop meanwhile."""
    words = ("identify", "--in", "tension", "--json", "--file", str(file))
    for _ in range(IDENTIFICATIONS):
        answer: dict[str, Any] = json.loads(daemons.rigctl(*words, file=running.file).stdout)
        if answer["accepted"]:
            break
        assert "had the loop skip" in answer["text"]
    return answer


@pytest.mark.alone
def test_an_operator_commissions_the_rig(running: Running, tmp_path: pathlib.Path) -> None:
    file = running.file
    assert running.do("tare", "--operator", "kim").startswith("TARE: zero +0.000 -> ")
    tared = entries(file)[-1]
    assert (tared.what, tared.operator, tared.before["zero_n"]) == ("tare", KIM, 0.0)
    assert tared.figures["rms_n"] == pytest.approx(0.03, rel=0.2)
    calibration = daemons.state(file)["calibration"]
    assert calibration["zero_n"] == tared.after["zero_n"]
    assert calibration["due"] is not None
    assert "calibration" in running.do("status", "--all")
    assert "the rope is slack" in (running.do("arm") and running.refused("identify", "--in", "tension"))
    running.do("target", "100")
    running.do("tension", "--wait")
    assert "hold first" in running.refused("tare")
    running.do("hold")
    answer = identified(running, tmp_path / "found.json")
    assert answer["accepted"], answer["text"]
    found = {row["key"]: row["found"] for row in answer["entry"]["figures"]["rows"]}
    assert found["plant.cylinder_lag_s"] == pytest.approx(0.02, abs=0.002)
    # Loop and drive are not synchronised here, so a command falls anywhere in the drive's millisecond: an error of one
    # tick, which is what identification promises.
    assert found["plant.command_delay_s"] == pytest.approx(0.002, abs=0.001)
    # The drive's speed is a mean over one of its own milliseconds, which may have ended a millisecond ago.
    assert found["age of the drive's speed"] == pytest.approx(0.0011, abs=0.0009)
    assert found["stiffness"] == pytest.approx(5.964, rel=0.01)
    assert found["tension_cell.noise_n"] == pytest.approx(0.03, rel=0.2)
    assert json.loads((tmp_path / "found.json").read_text()) == answer["entry"]
    assert msgspec.to_builtins(entries(file)[-1]) == answer["entry"]
    assert "NOT within" in running.refused("calibrate", "--weight-n", "95")
    weight = str(daemons.state(file)["tension_n"])
    assert "scale 1.00000 -> " in running.do("calibrate", "--weight-n", str(float(weight) * 1.005), "--adopt")
    assert daemons.state(file)["calibration"]["scale"] == pytest.approx(1.005, abs=1.5e-3)  # 5 x 0.03 N
    assert "within 0.5 %" in running.do("calibrate", "--weight-n", str(float(weight) * 1.005))
    assert [entry.what for entry in entries(file)[2:]] == ["tare", "identify", *["calibrate"] * 3]
    assert "signs checked" in running.log.read_text()


def test_hold_cuts_an_identification_short(running: Running) -> None:
    running.do("arm")
    where = ("--connect", daemons.endpoint(running.file))
    command = [sys.executable, "-m", "rigctl", "identify", *where]
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env=daemons.environment(running.file),
    )  # fmt: skip
    with moving(running.file) as client:
        assert client.command("hold", "kim")["accepted"]
    said, complained = child.communicate(timeout=patience_s())
    assert (child.returncode, said) == (1, "")
    assert complained.startswith("rigctl: IDENTIFY refused: cut short")
    assert daemons.state(running.file)["command_mm_s"] == 0.0
    assert [entry.what for entry in entries(running.file)] == ["tare", "calibrate"]


def test_the_operator_who_interrupts_an_identification_ends_it(running: Running) -> None:
    running.do("arm")
    where = ("--connect", daemons.endpoint(running.file))
    command = [sys.executable, "-m", "rigctl", "identify", *where]
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env=daemons.environment(running.file),
    )  # fmt: skip
    with moving(running.file):
        child.send_signal(signal.SIGINT)
    said, complained = child.communicate(timeout=patience_s())
    assert (child.returncode, said) == (1, "")
    assert complained == "rigctl: interrupted; identify was ended, the stroke is held\n"
    assert daemons.state(running.file)["command_mm_s"] == 0.0
    assert [entry.what for entry in entries(running.file)] == ["tare", "calibrate"]
    assert running.do("tare").startswith("TARE: ")  # nothing of the failed trial remains


def test_a_tare_on_record_whose_gateway_was_killed_is_put_in_force_by_the_next(running: Running) -> None:
    settings = config.load(running.file)
    before: dict[str, float | None] = {"zero_n": 0.0, "scale": 1.0}
    ledger.append(
        settings,
        ledger.entry(
            settings, "tare", "kim", time.time_ns(), before=before, after={"zero_n": 1.5, "scale": 1.0}, figures={}
        ),
    )
    subprocess.run(
        ["kill", "-9", str(daemons.process_with("rigctl.gateway.gateway_process", settings.rig))], check=True
    )
    until(lambda: "the tare by kim" in running.log.read_text(), log=running.log)
    assert "left over from before, is in force" in running.log.read_text()
    until(lambda: daemons.state(running.file)["calibration"]["zero_n"] == 1.5)
    assert daemons.state(running.file)["tension_n"] == pytest.approx(-1.5, abs=0.3)
    assert [entry.what for entry in entries(running.file)] == ["tare", "calibrate", "tare"]


def test_a_failed_check_blocks_the_next_arming(running: Running) -> None:
    running.do("arm")
    assert "no weight hangs on the cell" in running.refused("calibrate")
    assert "OVERDUE" not in running.do("status", "--all"), "an empty hook ends no check"
    running.do("target", "100")
    running.do("tension", "--wait")
    running.do("hold")
    assert "NOT within 0.5 %" in running.refused("calibrate", "--weight-n", "110")
    running.do("disarm")
    assert "no calibration check has passed" in running.refused("arm")
    assert "OVERDUE: no arming" in running.do("status", "--all")


def test_what_cannot_be_written_down_is_not_done(running: Running) -> None:
    path = config.load(running.file).ledger
    assert path is not None
    path.with_name(f"{path.name}.new").mkdir()  # root may write anywhere, but cannot replace a folder by a file
    assert "cannot be written" in running.refused("tare")
    assert daemons.state(running.file)["calibration"]["zero_n"] == 0.0
    assert running.log.read_text().count("tension cell: zero") == 1


def test_the_ledger_holds_for_the_next_start_and_for_a_control_process_that_comes_back(file: pathlib.Path) -> None:
    check_of(file, zero_n=2.0)
    log = file.with_name("daemon.log")
    with daemons.simulated_rig(file, file.with_name("rig.log")), daemons.daemon(file, log):
        assert daemons.state(file)["tension_n"] == pytest.approx(-2.0, abs=0.3)
        assert daemons.rigctl("tare", file=file).returncode == 0
        assert daemons.state(file)["tension_n"] == pytest.approx(0.0, abs=0.3)
        control = Runtime.of(daemons.name_of(file)).read_json("control.json")["pid"]
        subprocess.run(["kill", "-9", str(control)], check=True)
        until(lambda: log.read_text().count("loop started") == 2, log=log)
        until(lambda: daemons.mode(file) == "DISARMED", log=log)
        assert daemons.state(file)["tension_n"] == pytest.approx(0.0, abs=0.3)


@pytest.mark.alone
@pytest.mark.long
def test_a_frequency_response_is_on_record_with_a_picture(running: Running, tmp_path: pathlib.Path) -> None:
    picture = tmp_path / "response.png"
    refused = running.refused("identify", "--response")
    assert "arm and tension first" in refused
    running.do("arm")
    assert "the rope is slack" in running.refused("identify", "--response")
    running.do("target", "100")
    running.do("tension", "--wait")
    words = ("identify", "--response", "--in", "compensating", "--plot", str(picture))
    for _ in range(RESPONSES):
        answer = daemons.rigctl(*words, file=running.file, lasts_s=LONGEST_S)
        if answer.returncode == 0:
            break
        assert "had the loop skip" in answer.stderr, answer.stderr
    else:
        pytest.skip(f"this computer stopped the loop in each of {RESPONSES} responses")
    entry = entries(running.file)[-1]
    assert (entry.what, entry.figures["mode"]) == ("response", "COMPENSATING")
    assert entry.after["stiffness_n_mm"] == pytest.approx(5.964, rel=0.02)
    assert entry.figures["margins"]["ms_input"]["value"] == pytest.approx(1.4, abs=0.25)
    assert picture.stat().st_size > 20_000
    assert daemons.state(running.file)["mode"] == "COMPENSATING"
