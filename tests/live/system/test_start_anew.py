"""The way back from the silence with real processes: the control process ends, and the supervisor starts it anew."""

from __future__ import annotations

import json
import pathlib
import subprocess
import sys

import pytest

from rigctl.ipc.runtime_folder import Runtime
from rigctl.recorder import recording
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until
from tests.live.system.test_arming import running
from tests.live.system.test_daemon import Running


def inject(rig: Running, *words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hil", "inject", str(rig.file), *words],
        cwd=ROOT, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def control_pid(rig: Running) -> int:
    return int(Runtime.of(daemons.name_of(rig.file)).known("control.json")["pid"])


def test_without_a_bus_the_reset_says_what_it_does_and_the_end_what_was_seen(tmp_path: pathlib.Path) -> None:
    patient = {"sdo_timeout_ms": 5000}
    changes = {"can": {"boot_wait_s": 60.0}} | dict.fromkeys(("tension_cell", "inclinometer", "cylinder"), patient)
    file, log = daemons.slow_rig_file(tmp_path, changes), tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log") as served, daemons.daemon(file, log) as daemon:
        rig = Running(file, daemon, served, log)
        rig.do("arm")
        rig.rig.kill()
        until(lambda: "UNCONFIRMED" in str(daemons.state(rig.file).get("power_off")), log=rig.log)
        doctor = {row["name"]: row for row in json.loads(daemons.rigctl("doctor", "--json", file=rig.file).stdout)}
        assert doctor["drive: off, brake closed"]["found"] == "not known: no fresh drive status"
        alarms = json.loads(daemons.rigctl("alarms", "--json", file=rig.file).stdout)
        failing = {row["cause"]: (row["stands"], row["count"]) for row in alarms}
        assert failing["SEND_FAILED"] == failing["RECEIVE_FAILED"] == (True, 1)
        assert "not confirmed" in rig.refused("disarm")
        assert rig.do("reset").startswith("RESET: the loop ends, and the next one starts all devices up; ")
        until(lambda: "control process could not start" in rig.log.read_text(), log=rig.log)
        rig.daemon.terminate()
        assert rig.daemon.wait(patience_s()) == 1
        last = rig.log.read_text().splitlines()[-1]
    assert "WARNING: no loop has stopped in order: the last one was in FAULT" in last
    assert "the brake was not seen to close" in last


def test_a_reset_of_the_silence_starts_all_devices_up_again(tmp_path: pathlib.Path) -> None:
    with running(tmp_path, {"recording": {"folder": "recordings"}}) as rig:
        rig.compensate(100)
        former = control_pid(rig)
        inject(rig, "sync_unheard")  # the drive goes on at its last speed, so that nothing but silence stops it
        until(lambda: daemons.state(rig.file).get("fault") in ("SYNC_LOST", "DRIVE_STALE"), log=rig.log)
        until(lambda: "UNCONFIRMED" in str(daemons.state(rig.file).get("power_off")), log=rig.log)
        assert rig.truth()[0] == pytest.approx(100.0, abs=6.0), "within 1 mm of a spring of 6 N/mm"
        inject(rig, "--end")
        until(lambda: daemons.rigctl("reset", file=rig.file).returncode == 0, log=rig.log)
        until(lambda: control_pid(rig) != former and daemons.mode(rig.file) == "DISARMED", log=rig.log)
        assert "ended to start all devices up again" in rig.log.read_text()
        assert rig.truth()[0] == pytest.approx(100.0, abs=6.0)
        if daemons.state(rig.file)["drive_state"] == "FAULT":
            rig.do("reset")
        until(lambda: daemons.rigctl("arm", file=rig.file).returncode == 0, log=rig.log)
        rig.do("tension", "--wait")
    found = recording.read(*recording.parts_of(next((tmp_path / "recordings").glob("*.mcap"))), frames=False)
    assert len(found.control_starts) == 2, "the new loop is the recording's next span"
    assert [gap for gap in found.gaps if gap.ring in ("records", "events")] == []
    assert [said.what for said in found.events].count("started") == 2
