"""A brake that has slipped is known not to hold after the control process and the whole daemon have started anew."""

from __future__ import annotations

import json
import os
import pathlib
import signal
from dataclasses import replace

import pytest

from rigctl.config import rig_file as config
from tests.builders import daemons
from tests.builders.waiting import patience_s, until
from tests.live.system.test_daemon import Running
from tests.live.system.test_start_anew import control_pid, inject


def flagged(rig: Running) -> bool:
    return "brake_fails" in daemons.state(rig.file).get("flag_names", [])


def ended(rig: Running) -> str:
    """Its log, once the daemon has ended."""
    rig.daemon.send_signal(signal.SIGTERM)
    rig.daemon.wait(patience_s())
    return rig.log.read_text()


def test_a_slip_is_known_to_the_next_daemon_until_its_brake_test(tmp_path: pathlib.Path) -> None:
    file = daemons.slow_rig_file(tmp_path)
    kept = config.load(file).last_stroke
    with daemons.simulated_rig(file, tmp_path / "rig.log") as served:
        with daemons.daemon(file, tmp_path / "first.log") as daemon:
            rig = Running(file, daemon, served, tmp_path / "first.log")
            rig.compensate(100)
            rig.do("hold")
            until(lambda: daemons.state(file).get("held_by") == "BRAKE", log=rig.log)
            inject(rig, "brake_slips_slowly")
            until(lambda: flagged(rig), log=rig.log)
            inject(rig, "--end")
            until(lambda: kept.exists() and json.loads(kept.read_bytes()).get("brake_fails"), log=rig.log)
            former = control_pid(rig)
            os.kill(former, signal.SIGKILL)
            until(lambda: control_pid(rig) != former and daemons.mode(file) == "DISARMED", log=rig.log)
            assert flagged(rig)
            ended(rig)
        rig = replace(rig, log=tmp_path / "second.log")
        with daemons.daemon(file, rig.log) as daemon:
            rig = replace(rig, daemon=daemon)
            until(lambda: flagged(rig), log=rig.log)
            assert "the brake does not hold the load" in " ".join(rig.do("status").split())
            state = daemons.state(file)
            assert state["slipped_n"] == pytest.approx(100.0, abs=10.0)
            assert "the brake does not hold: known before this start; " in rig.log.read_text()
            until(lambda: daemons.state(file).get("held_by") == "BRAKE", log=rig.log)
            if daemons.state(file)["drive_state"] == "FAULT":  # the killed loop's heartbeat is missed
                rig.do("reset")
            until(lambda: daemons.rigctl("arm", file=file, lasts_s=15.0).returncode == 0, log=rig.log)
            assert not flagged(rig)
            assert "the brake holds: a brake test with" in ended(rig)
        assert json.loads(kept.read_bytes()).keys() == {"rig", "stroke_mm", "when"}
        kept.write_bytes(kept.read_bytes()[:20])
        rig = replace(rig, log=tmp_path / "third.log")
        with daemons.daemon(file, rig.log):
            until(lambda: flagged(rig), log=rig.log)
            (line,) = [line for line in rig.log.read_text().splitlines() if "counts as one that does not hold" in line]
    assert f"{kept.name} is damaged" in line
    assert "rigctl arm on a tight rope of 280 N at least" in line
