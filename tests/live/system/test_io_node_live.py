"""An emergency stop at the I/O node alone, with real processes: pressed, shown by status and doctor, and silent."""

from __future__ import annotations

import pathlib

import can
import pytest

from rigctl.devices import objects as od
from tests.builders import daemons
from tests.builders.waiting import until
from tests.live.system.test_arming import doctor, running
from tests.live.system.test_daemon import Running

IO = {"node": 6, "e_stop_input": 0, "stale_ms": 300}
RELEASED, SEEN = "emergency stop, I/O node: released", "emergency stop, I/O node: seen"


def nmt(rig: Running, command: int) -> None:
    """Another master's command to the I/O node."""
    with can.Bus(interface="rigsim", channel=str(rig.file.with_name("bus.sock"))) as bus:
        bus.send(can.Message(arbitration_id=od.NMT_COB, data=[command, IO["node"]], is_extended_id=False))


def test_it_is_latched_and_told_apart_from_the_drives_and_its_silence_bars_arming(tmp_path: pathlib.Path) -> None:
    with running(tmp_path, {"io": IO}) as rig:
        assert "I/O node 6" in (tmp_path / "rig.log").read_text()
        assert "I/O inputs" in daemons.rigctl("check", str(rig.file)).stdout
        rig.compensate(100)
        _, found = doctor(rig)
        assert found[RELEASED]["ok"] and found[SEEN]["ok"]
        daemons.simulator(rig.file).write(od.SIM_IO_E_STOP, 1)
        until(lambda: daemons.state(rig.file).get("fault") == "E_STOP", log=rig.log)
        assert rig.truth()[0] == pytest.approx(100.0, abs=3.0)
        said = until(lambda: (text := rig.do("status", "--all")) and "e-stop" in text and text, log=rig.log)
        assert "emergency stop pressed (I/O node's input)" in said
        assert "emergency stop is pressed (I/O node's input)" in said
        assert "drive's input" not in said
        code, found = doctor(rig)
        assert code == 1
        assert found[RELEASED]["severity"] == "fails"
        assert found["emergency stop: released"]["ok"]  # the drive's contact
        assert "cause still present: E_STOP" in rig.refused("reset")
        daemons.simulator(rig.file).write(od.SIM_IO_E_STOP, 0)
        until(lambda: daemons.rigctl("reset", file=rig.file).returncode == 0, log=rig.log)
        until(lambda: daemons.state(rig.file).get("held_by") == "BRAKE", log=rig.log)
        assert daemons.mode(rig.file) == "DISARMED"  # an emergency stop took the power off
        nmt(rig, 0x02)  # another master stops the node
        unseen = "emergency stop's input on the I/O node is not seen"
        until(lambda: unseen in rig.do("status", "--all"), log=rig.log)
        assert unseen in rig.refused("arm")
        assert doctor(rig)[1][SEEN]["severity"] == "fails"
        nmt(rig, 0x01)
        until(lambda: daemons.rigctl("arm", file=rig.file).returncode == 0, log=rig.log)
        assert rig.truth()[0] == pytest.approx(100.0, abs=3.0)
