"""Daemon, rig and operator as real processes, in right and wrong use."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from rigctl.devices import objects as od
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import Runtime
from tests.builders import daemons
from tests.builders.host_pause import PAUSE_MS, late_wake_ups
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

# The rig PC is shared with other tests: limits of time are wide, those of function are not.
PATIENT: dict[str, dict[str, Any]] = {
    "safety": {
        "stale_ms": 100,
        "bus_silent_ms": 100,
        "inclination_stale_ms": 500,
        "overrun_ticks": 900,
        "waiver": "a simulated rig on a busy machine",
    },
    "cylinder": {"command_deadline_ms": 500, "heartbeat_timeout_ms": 500},
    "loop": {"cpu": None},
}


# A loop without real-time scheduling waits for a processor as any process does.
UNPRIVILEGED: dict[str, dict[str, Any]] = {
    "safety": {
        "stale_ms": 500,
        "bus_silent_ms": 500,
        "inclination_stale_ms": 2000,
        "overrun_ticks": 1000,
        "waiver": "a simulated rig on a busy machine",
    },
    "cylinder": {"heartbeat_timeout_ms": 1000, "command_deadline_ms": 1000},
}


@dataclass(frozen=True)
class Running:
    """A daemon on a simulated rig, DISARMED."""

    file: pathlib.Path
    daemon: subprocess.Popen[bytes]
    rig: subprocess.Popen[bytes]
    log: pathlib.Path

    def do(self, *words: str) -> str:
        answer = daemons.rigctl(*words, file=self.file)
        assert answer.returncode == 0, answer.stdout + answer.stderr + self.log.read_text()
        return answer.stdout

    def refused(self, *words: str) -> str:
        answer = daemons.rigctl(*words, file=self.file)
        assert answer.returncode == 1, answer.stdout + answer.stderr
        assert answer.stderr.count("\n") == 1
        return answer.stderr

    def compensate(self, target_n: float | None = None) -> None:
        """Arm and tension, until the target is reached."""
        self.do("arm")
        if target_n is not None:
            self.do("target", f"{target_n:g}")
        self.do("tension", "--wait")

    def truth(self) -> tuple[float, float]:
        """True vertical tension in N and stroke in mm."""
        node = daemons.simulator(self.file)
        return node.read(od.SIM_TRUE_VERTICAL_MN) * 1e-3, node.read(od.SIM_TRUE_STROKE_UM) * 1e-3


def _start(file: pathlib.Path) -> Iterator[Running]:
    folder = file.parent
    log = folder / "daemon.log"
    with daemons.simulated_rig(file, folder / "rig.log") as rig, daemons.daemon(file, log) as daemon:
        yield Running(file, daemon, rig, log)


@pytest.fixture
def running(tmp_path: pathlib.Path) -> Iterator[Running]:
    """A daemon for one test."""
    yield from _start(daemons.rig_file(tmp_path, PATIENT))


@pytest.fixture
def slow(tmp_path: pathlib.Path) -> Iterator[Running]:
    """A daemon that no pause of the host trips."""
    yield from _start(daemons.slow_rig_file(tmp_path))


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """One daemon for the tests that leave it as they found it."""
    yield from _start(daemons.rig_file(tmp_path_factory.mktemp("shared"), PATIENT))


@pytest.mark.smoke
def test_an_operators_session(slow: Running) -> None:
    assert "HOLD" in slow.do("arm")
    slow.do("target", "120")
    assert "COMPENSATING" in slow.do("tension", "--wait")
    assert slow.truth()[0] > 60.0, "the rope carries the load; how well is judged in simulated time"
    shown = slow.do("status")
    assert "COMPENSATING" in shown
    assert "120" in shown
    watching = subprocess.Popen(
        [sys.executable, "-m", "rigctl", "watch", "--connect", daemons.endpoint(slow.file)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    assert watching.stdout is not None
    assert "COMPENSATING" in watching.stdout.readline()
    watching.send_signal(signal.SIGINT)
    assert watching.communicate(timeout=patience_s())[1] == ""
    assert watching.returncode == 0
    answer = json.loads(slow.do("hold", "--json"))
    assert (answer["accepted"], answer["mode"]) == (True, "HOLD")
    assert "HOLD" in slow.do("release", "--wait")
    assert slow.truth()[0] == 0.0
    slow.do("disarm")
    assert daemons.mode(slow.file) == "DISARMED"


@pytest.mark.alone  # two loops beside it leave the rig no processor for the daemon's last SDO
def test_sigterm_in_the_closed_loop_ends_in_hold_with_the_load_carried(running: Running) -> None:
    running.compensate(100)
    before = running.truth()
    with late_wake_ups() as late_ms:
        running.daemon.send_signal(signal.SIGTERM)
        assert running.daemon.wait(patience_s()) == 0
    said = running.log.read_text()
    assert "COMPENSATING -> HOLD: daemon stopping" in said
    assert "stopped in HOLD" in said
    assert "emergency" not in said
    time.sleep(0.5)
    after = running.truth()
    assert after[0] == pytest.approx(before[0], abs=1.0)
    assert after[1] == pytest.approx(before[1], abs=0.1)
    # The daemon has switched the drive off in order: the next one finds no fault and takes the load over.
    after_it = replace(running, log=running.log.with_name("next.log"))
    with daemons.daemon(after_it.file, after_it.log):
        if max(late_ms) >= PAUSE_MS:  # a rig without a processor has missed the daemon's end, and is in a fault for it
            daemons.rigctl("reset", file=running.file)
        assert "HOLD" in after_it.do("arm")
        assert after_it.truth()[0] == pytest.approx(before[0], abs=1.0)


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs a second processor")
def test_what_runs_beside_the_loop_keeps_off_its_processor(tmp_path: pathlib.Path) -> None:
    everywhere = os.sched_getaffinity(0)
    cpu = max(everywhere)
    file, log = daemons.rig_file(tmp_path, {**PATIENT, "loop": {"cpu": cpu}}), tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, log):
        for module, cpus in (
            ("control", {cpu}),
            ("gateway.gateway_process", everywhere - {cpu}),
            ("recorder", everywhere - {cpu}),
        ):
            pid = daemons.process_with(f"rigctl.{module}", f"rigctl-{daemons.name_of(file)}")
            assert os.sched_getaffinity(pid) == cpus, module


@contextlib.contextmanager
def kept(records: RingReader) -> Iterator[list[np.ndarray[Any, Any]]]:
    """The slots written meanwhile, read before the ring overwrites them, however long anything else takes."""
    parts, ended = [records.read()], threading.Event()

    def keep() -> None:
        while not ended.wait(0.5):
            parts.append(records.read())

    keeper = threading.Thread(target=keep)
    keeper.start()
    try:
        yield parts
    finally:
        ended.set()
        keeper.join()
        parts.append(records.read())


def test_the_gateway_is_killed_and_comes_back_and_the_loop_does_not_notice(running: Running) -> None:
    running.compensate(100)
    records = Runtime.of(daemons.name_of(running.file)).records.reader()
    with kept(records) as parts:
        for _ in range(2):
            os.kill(
                daemons.process_with("rigctl.gateway.gateway_process", f"rigctl-{daemons.name_of(running.file)}"),
                signal.SIGKILL,
            )
            until(lambda: daemons.mode(running.file) == "COMPENSATING", log=running.log)
    slots = np.concatenate(parts)
    assert records.lost == 0
    assert len(slots) > 1000
    assert set(slots["mode"]) == {3}
    assert int(slots["seq"][-1] - slots["seq"][0]) == len(slots) - 1
    assert "gateway process killed by signal 9; comes back in 0.2 s; the loop is unaffected" in running.log.read_text()


def test_a_killed_control_process_comes_back_disarmed_with_the_load_carried(running: Running) -> None:
    running.compensate(100)
    before = running.truth()
    control = Runtime.of(daemons.name_of(running.file)).read_json("control.json")["pid"]
    os.kill(control, signal.SIGKILL)
    until(lambda: "comes back DISARMED" in running.log.read_text(), log=running.log)
    until(lambda: running.log.read_text().count("loop started, DISARMED") == 2, log=running.log)
    until(lambda: daemons.mode(running.file) == "DISARMED", log=running.log)
    after = running.truth()
    assert after[1] == pytest.approx(before[1], abs=1.0)
    assert after[0] == pytest.approx(before[0], abs=6.0), "1 mm at 6 N/mm: the way until the drive misses its commands"
    assert "reset clears it" in running.refused("arm")
    running.do("reset")
    until(lambda: daemons.rigctl("arm", file=running.file).returncode == 0)
    running.do("tension", "--wait")


def test_a_killed_supervisor_leaves_the_stroke_held_and_nothing_running(running: Running) -> None:
    running.compensate(100)
    before = running.truth()
    runtime = Runtime.of(daemons.name_of(running.file))
    control = runtime.read_json("control.json")["pid"]
    running.daemon.kill()
    running.daemon.wait()
    until(lambda: not pathlib.Path(f"/proc/{control}").exists())
    after = running.truth()
    assert after[1] == pytest.approx(before[1], abs=0.5)
    runtime.remove()


def test_the_service_manager_is_told_and_fed_only_while_the_loop_ticks(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = daemons.rig_file(tmp_path, PATIENT)
    with (
        daemons.simulated_rig(file, tmp_path / "rig.log"),
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager,
    ):
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(patience_s())
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))  # after the simulated rig, which notifies too
        log = tmp_path / "daemon.log"
        with daemons.daemon(file, log):
            assert manager.recv(100) == b"READY=1"
            assert manager.recv(100) == b"WATCHDOG=1"
            control = Runtime.of(daemons.name_of(file)).read_json("control.json")["pid"]
            os.kill(control, signal.SIGSTOP)
            time.sleep(1.5)
            manager.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                while manager.recv(100):
                    pass
            time.sleep(0.5)
            with pytest.raises(BlockingIOError):
                pytest.fail(f"{manager.recv(100)!r}\n{log.read_text()}")
            os.kill(control, signal.SIGCONT)
            manager.settimeout(patience_s())
            assert manager.recv(100) == b"WATCHDOG=1"
        told = []
        manager.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while said := manager.recv(100):
                told.append(said)
        assert told[-1] == b"STOPPING=1"


def test_it_says_that_it_answers_when_it_does(tmp_path: pathlib.Path) -> None:
    """The gateway may be up later than the loop."""
    file, log = daemons.rig_file(tmp_path), tmp_path / "daemon.log"
    folder = Runtime.of(daemons.name_of(file))
    with (
        daemons.simulated_rig(file, tmp_path / "rig.log"),
        daemons.process("rigctl", "run", str(file), log=log),
        contextlib.ExitStack() as stack,
    ):
        words = ("rigctl.gateway", folder.directory.name)
        gateway = until(lambda: daemons.processes_with(*words), log=log)[0]
        os.kill(gateway, signal.SIGSTOP)
        stack.callback(os.kill, gateway, signal.SIGCONT)
        until(lambda: folder.records.path.exists() and folder.records.reader().head, log=log)
        assert "answering at" not in log.read_text()
        stack.close()
        until(lambda: "answering at" in log.read_text(), log=log)
        assert daemons.rigctl("status", file=file).returncode == 0


@pytest.mark.simulated_time
def test_no_rig_is_one_clear_line(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path)
    answer = daemons.rigctl("run", str(file))
    assert answer.returncode == 1
    (line,) = [line for line in answer.stderr.splitlines() if "no simulated rig is served here" in line]
    assert line.count("bus.sock") == 1, "the channel, once"
    assert "RigSimBus" not in answer.stderr and "Traceback" not in answer.stderr
    assert "no simulated rig is served here" in on_record(file)[-1], "the cause is on record too"


@pytest.mark.simulated_time
def test_an_interface_of_python_can_that_lacks_something_is_one_line_of_check_doctor_and_run(
    tmp_path: pathlib.Path,
) -> None:
    file = daemons.rig_file(tmp_path, {"can": {"interface": "socketcand", "channel": "can0"}})
    for command in ("check", "run"):
        answer = daemons.rigctl(command, str(file))
        assert answer.returncode == 1
        (line,) = answer.stderr.splitlines()
        assert "'host'" in line and "~/.canrc" in line
    found = daemons.rigctl("doctor", str(file), "--json").stdout
    (link,) = [row for row in json.loads(found) if row["name"] == "can link"]
    assert not link["ok"] and "'host'" in link["found"]
    served = subprocess.run(
        [sys.executable, "-m", "hil", "serve", str(file)],
        capture_output=True, text=True, timeout=patience_s(), check=False, cwd=ROOT,
    )  # fmt: skip
    assert (served.returncode, served.stderr.count("\n")) == (1, 1)
    assert "'host'" in served.stderr


def on_record(file: pathlib.Path) -> list[str]:
    """The lines of the audit log of the supervisor, the newest last."""
    return daemons.rigctl("audit", "show", str(file), "--what", "daemon").stdout.splitlines()


def test_a_start_that_is_interrupted_says_no_more_than_it_has_seen(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path, PATIENT)
    log = tmp_path / "run.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log"):
        changed = tmp_path / "other.yaml"
        changed.write_text(file.read_text().replace("node: 3", "node: 33"))
        with daemons.process("rigctl", "run", str(changed), log=log) as running:
            until(lambda: "waiting for inclinometer (node 33)" in log.read_text(), log=log)
            running.terminate()
            assert running.wait(patience_s()) == 1
    assert "answering at" not in log.read_text()
    words = "the start was interrupted before the loop ran"
    assert words in log.read_text()
    assert words in on_record(changed)[-1]


def test_a_device_that_does_not_answer_is_named(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path, PATIENT)
    with daemons.simulated_rig(file, tmp_path / "rig.log"):
        changed = tmp_path / "other.yaml"
        changed.write_text(file.read_text().replace("node: 3", "node: 33"))
        answer = daemons.rigctl("run", str(changed))
    assert answer.returncode == 1
    assert "inclinometer (node 33) does not answer" in answer.stderr


def test_a_design_that_is_not_robust_is_refused(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path, {"design": {"ms_max": 1.01}})
    with daemons.simulated_rig(file, tmp_path / "rig.log"):
        answer = daemons.rigctl("run", str(file))
    assert answer.returncode == 1
    assert "design refused" in answer.stderr


@pytest.mark.skipif(os.getuid() != 0 or shutil.which("setpriv") is None, reason="needs root, to give it up")
def test_without_privileges_it_runs_and_says_what_is_missing(tmp_path: pathlib.Path) -> None:
    file = daemons.rig_file(tmp_path, {**UNPRIVILEGED, "loop": {"cpu": 1023}})
    log = tmp_path / "daemon.log"
    plain = ["setpriv", "--bounding-set", "-all", "--inh-caps", "-all", "--ambient-caps", "-all"]
    with daemons.simulated_rig(file, tmp_path / "rig.log"):
        limits = f"ulimit -l 64; ulimit -r 0; exec {' '.join(plain)} {sys.executable} -m rigctl run {file}"
        with log.open("wb") as out:
            child = subprocess.Popen(["bash", "-c", limits], stdout=out, stderr=subprocess.STDOUT, cwd=ROOT)
        try:
            until(lambda: child.poll() is not None or b": DISARMED," in log.read_bytes(), log=log)
            until(lambda: daemons.mode(file) == "DISARMED", log=log)
            said = log.read_text()
            for setting in ("scheduler", "memory", "affinity"):
                assert f"real time: {setting}" in said
            warnings = [line for line in said.splitlines() if "WARNING" in line]
            # A busy machine rightly adds skipped ticks; the rig file's waivers are listed too.
            missing = [line for line in warnings if "skipped" not in line and "waived:" not in line]
            assert len(missing) == 3, said
            assert daemons.rigctl("arm", file=file).returncode == 0
        finally:
            child.send_signal(signal.SIGTERM)
            assert child.wait(patience_s()) == 0


@pytest.mark.simulated_time
def test_check_shows_the_rig_and_refuses_a_bus_that_is_too_slow(tmp_path: pathlib.Path) -> None:
    good = daemons.rigctl("check", "config/rig.yaml")
    assert good.returncode == 0
    assert "45.4%" in good.stdout
    figures = json.loads(daemons.rigctl("check", "config/rig.yaml", "--json").stdout)
    assert figures["bus_load_pct"] == pytest.approx(45.44)
    slow = daemons.rig_file(tmp_path, {"can": {"bitrate_bit_s": 500_000}})
    answer = daemons.rigctl("check", str(slow))
    assert answer.returncode == 1
    assert "limit of 80%" in answer.stderr
    assert daemons.rigctl("run", str(slow)).returncode == 1


def test_a_second_daemon_on_the_same_rig_is_refused(shared: Running) -> None:
    answer = daemons.rigctl("run", str(shared.file))
    assert answer.returncode == 1
    assert f"another daemon (process {shared.daemon.pid}) already runs this rig" in answer.stderr
    assert daemons.mode(shared.file) == "DISARMED"


def test_a_second_daemon_under_another_name_is_refused_by_the_bus(shared: Running, tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "other"
    folder.mkdir()
    other = daemons.rig_file(folder, {"can": {"channel": str(shared.file.with_name("bus.sock"))}}, rig="impostor")
    answer = daemons.rigctl("run", str(other))
    assert answer.returncode == 1
    assert "another controller is active" in answer.stderr
    assert "Traceback" not in answer.stderr
    assert daemons.mode(shared.file) == "DISARMED"
