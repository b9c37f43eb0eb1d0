"""A daemon that is to end while the motor carries a load for a brake that slips: real processes, judged by the rig."""

from __future__ import annotations

import pathlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from rigctl.cli import status
from rigctl.client.connection import Client
from rigctl.control.power.ending import TOGETHER_NS
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Flag, HeldBy
from rigctl.wire.alarms import Alarms
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until
from tests.live.system.test_daemon import Running

TARGET_N = 100.0


@pytest.fixture
def carrying(tmp_path: pathlib.Path) -> Iterator[Running]:
    """The brake lets 100 N sink by 0.5 mm/s, and the motor carries them."""
    file, log = daemons.slow_rig_file(tmp_path), tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log") as rig, daemons.daemon(file, log) as daemon:
        running = Running(file, daemon, rig, log)
        running.do("arm")
        running.do("target", f"{TARGET_N:g}")
        running.do("tension", "--wait")
        running.do("hold")
        slips = [sys.executable, "-m", "hil", "inject", str(file), "brake_slips_parking"]
        subprocess.run(slips, check=True, cwd=ROOT, capture_output=True, timeout=patience_s())
        until(lambda: daemons.rigctl("carry", "600", file=file).returncode == 0, log=log)
        until(lambda: int(newest(running, "flags")) & Flag.CARRIES, log=log)
        until(lambda: newest(running, "held_by") == HeldBy.MOTOR, log=log)
        yield running


def newest(running: Running, name: str) -> float:
    slot = Runtime.of(daemons.name_of(running.file)).records.reader().latest()
    assert slot is not None
    return float(slot[name])


def shown(client: Client) -> str:
    """What ``rigctl status --all`` prints: the command itself may take longer to start than the load is held."""
    state = client.state()
    alarms = Alarms(client.past_events()).rows(state, time.time_ns())
    return " ".join(text for _, text, _ in status.rows(state, alarms, time.time_ns()))


def delayed(running: Running) -> bool:
    return "in 10 s the motor lowers the load, then the daemon ends" in running.log.read_text()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP], ids=lambda number: number.name)
def test_a_signal_to_end_waits_and_has_the_load_lowered_first(carrying: Running, number: signal.Signals) -> None:
    carried = carrying.truth()
    with Client(daemons.endpoint(carrying.file), daemons.name_of(carrying.file)) as client:
        carrying.daemon.send_signal(number)
        until(lambda: delayed(carrying), log=carrying.log)
        words = shown(client)
    assert "THE DAEMON IS TO END: in " in words
    assert "ENDING" in words, "the alarm"
    held = [carried]
    while newest(carrying, "end_s") > 0.0:
        found = carrying.truth()
        if newest(carrying, "end_s") > 0.0:
            held.append(found)
    held_n, held_mm = held[-1]
    assert (held_n, held_mm) == (pytest.approx(carried[0], abs=2.0), pytest.approx(carried[1], abs=0.2))
    assert carrying.daemon.wait(patience_s()) == 0
    assert carrying.truth()[0] == 0.0
    said = carrying.log.read_text()
    assert (
        said.index("the daemon ends once the motor has lowered")
        < said.index("the load is lowered")
        < said.index("stopped in FAULT")
    )
    assert "Traceback" not in said


def test_a_second_signal_leaves_the_load(carrying: Running) -> None:
    carrying.daemon.send_signal(signal.SIGTERM)
    until(lambda: delayed(carrying) and newest(carrying, "end_s") < 10.0 - 2.0 * TOGETHER_NS * 1e-9, log=carrying.log)
    carrying.daemon.send_signal(signal.SIGTERM)
    assert carrying.daemon.wait(patience_s()) == 1
    said = carrying.log.read_text()
    assert "by a second signal the daemon ends and leaves" in said
    assert "lowered" not in said.partition("by a second signal")[2]
    assert "the closed brake does not hold it: support the payload from below" in said


def test_a_supervisor_that_is_killed_meanwhile_is_no_second_signal(carrying: Running) -> None:
    runtime = Runtime.of(daemons.name_of(carrying.file))
    control, records = runtime.read_json("control.json")["pid"], runtime.records.reader()
    carrying.daemon.send_signal(signal.SIGTERM)
    until(lambda: delayed(carrying) and newest(carrying, "end_s") < 10.0 - 2.0 * TOGETHER_NS * 1e-9, log=carrying.log)
    carrying.daemon.kill()
    carrying.daemon.wait()
    until(lambda: not pathlib.Path(f"/proc/{control}").exists(), log=carrying.log)
    assert carrying.truth()[0] == 0.0
    last = records.latest()
    assert last is not None
    assert last["tension_n"] < 5.0
    runtime.remove()
