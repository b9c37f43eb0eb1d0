"""Runs in the guest only (see ../test_guest.py): the real daemon and rig on a real kernel's vcan."""

from __future__ import annotations

import json
import pathlib
import subprocess
from collections.abc import Iterator
from typing import Any

import can
import canopen
import pytest

from rigctl.devices import objects as od
from tests import daemons

RATE_HZ = 100
# User-mode Linux: a system call costs 200 times the host's, and one processor has daemon, rig and tests to run: limits
# in time are as wide as the settings allow. At 400 ms a busy host made it trip.
SLOW: dict[str, dict[str, Any]] = {
    "loop": {"rate_hz": RATE_HZ, "priority": 80, "cpu": 0, "spin_us": 0, "lock_memory": False},
    "can": {"interface": "socketcan", "channel": "vcan0", "heartbeat_ms": 50},
    "cylinder": {"heartbeat_timeout_ms": 1000, "command_deadline_ms": 1000},
    "inclinometer": {"rate_hz": 50},
    "safety": {
        "stale_ms": 900,
        "bus_silent_ms": 900,
        "inclination_stale_ms": 2000,
        "overrun_ticks": 90,
        "overrun_window_ms": 1000,
    },
    "estimator": {"tension_walk_n": 30.0},  # calm enough for 100 Hz
}


def link(device: str, state: str) -> None:
    subprocess.run(["/sbin/ip", "link", "set", device, state], check=True)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return daemons.rig_file(tmp_path_factory.mktemp("rig"), SLOW, rig="guest")


@pytest.fixture(scope="module")
def log(file: pathlib.Path) -> Iterator[pathlib.Path]:
    daemon_log = file.with_name("daemon.log")
    with (
        daemons.simulated_rig(file, file.with_name("rig.log")) as rig,
        daemons.daemon(file, daemon_log) as daemon,
    ):
        yield daemon_log
        assert rig.poll() is None
        assert daemon.poll() is None


def truth(index: int) -> float:
    """The plant's own word, asked over the bus on a socket of its own."""
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05
    network.connect(interface="socketcan", channel="vcan0")
    try:
        node = network.add_node(canopen.RemoteNode(od.SIMULATOR_NODE, str(daemons.ROOT / "config/eds/simulator.eds")))
        node.sdo.RESPONSE_TIMEOUT = 2.0
        return int(node.sdo[index].raw) * 1e-3
    finally:
        network.disconnect()


def vertical_n() -> float:
    return truth(od.SIM_TRUE_VERTICAL_MN)


def stroke_mm() -> float:
    return truth(od.SIM_TRUE_STROKE_UM)


def command(file: pathlib.Path, *words: str) -> str:
    answer = daemons.rigctl(*words, file=file)
    assert answer.returncode == 0, answer.stdout + answer.stderr + file.with_name("daemon.log").read_text()
    return answer.stdout


def test_a_missing_interface_is_one_clear_line(tmp_path: pathlib.Path) -> None:
    other = daemons.rig_file(tmp_path, {**SLOW, "can": {**SLOW["can"], "channel": "can9"}}, rig="missing")
    answer = daemons.rigctl("run", str(other))
    assert answer.returncode == 1
    assert "can9" in answer.stderr
    assert "No such device" in answer.stderr
    assert "Traceback" not in answer.stderr


def test_an_interface_that_is_down_is_one_clear_line(tmp_path: pathlib.Path) -> None:
    other = daemons.rig_file(tmp_path, {**SLOW, "can": {**SLOW["can"], "channel": "vcan1"}}, rig="down")
    link("vcan1", "down")
    answer = daemons.rigctl("run", str(other))
    link("vcan1", "up")
    assert answer.returncode == 1
    assert "vcan1" in answer.stderr
    assert "down" in answer.stderr
    assert "Traceback" not in answer.stderr


def test_arm_tension_hold_release(file: pathlib.Path, log: pathlib.Path) -> None:
    assert "HOLD" in command(file, "arm"), log.read_text()
    command(file, "target", "100")
    command(file, "tension", "--wait")
    assert vertical_n() == pytest.approx(100.0, abs=2.0)
    command(file, "hold")
    assert daemons.mode(file) == "HOLD"
    held = stroke_mm()
    command(file, "release", "--wait")
    assert vertical_n() == 0.0
    assert stroke_mm() < held - 10.0


def test_error_frames_are_seen_and_counted(file: pathlib.Path, log: pathlib.Path) -> None:
    before = daemons.state(file)["error_frames"]
    with can.Bus(interface="socketcan", channel="vcan0") as bus:
        bus.send(can.Message(arbitration_id=0x04, is_error_frame=True, dlc=8, data=b"\x00\x20\0\0\0\0\0\0"))
    assert daemons.wait_for(lambda: daemons.state(file)["error_frames"] == before + 1)
    assert "CAN error frame" in log.read_text()


def test_an_interface_pulled_down_while_compensating_is_held_and_recovers(
    file: pathlib.Path, log: pathlib.Path
) -> None:
    command(file, "tension", "--wait")
    before = stroke_mm()
    link("vcan0", "down")
    daemons.wait_for(lambda: daemons.mode(file) == "FAULT", log=log)
    fallen = daemons.state(file)
    assert fallen["fault"] in ("BUS_SILENT", "DRIVE_STALE", "CELL_STALE")
    assert "trip" in log.read_text()
    refused = daemons.rigctl("reset", "--json", file=file)
    assert refused.returncode == 1
    assert json.loads(refused.stdout)["accepted"] is False
    link("vcan0", "up")
    assert stroke_mm() == pytest.approx(before, abs=1.0)
    assert vertical_n() == pytest.approx(100.0, abs=6.0)
    daemons.wait_for(lambda: daemons.rigctl("reset", file=file).returncode == 0, log=log)
    assert daemons.mode(file) == "DISARMED"
    daemons.wait_for(lambda: daemons.rigctl("arm", file=file).returncode == 0, log=log)
    command(file, "tension", "--wait")
    assert vertical_n() == pytest.approx(100.0, abs=2.0)
    command(file, "release", "--wait")
    command(file, "disarm")
