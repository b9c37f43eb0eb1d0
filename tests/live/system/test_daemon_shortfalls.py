"""The daemon without, or short of, a resource it needs: files, memory, its port, its terminal."""

from __future__ import annotations

import json
import os
import pathlib
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator

import pytest

from rigctl.ipc.runtime_folder import Runtime
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until
from tests.live.system.test_daemon import PATIENT, Running


@pytest.fixture
def running(tmp_path: pathlib.Path) -> Iterator[Running]:
    """A daemon for one test."""
    file, log = (
        daemons.rig_file(tmp_path, {**PATIENT, "page": {"listen": f"localhost:{daemons.free_port()}"}}),
        tmp_path / "daemon.log",
    )
    with daemons.simulated_rig(file, tmp_path / "rig.log") as rig, daemons.daemon(file, log) as daemon:
        yield Running(file, daemon, rig, log)


def tensioned(running: Running) -> tuple[float, float]:
    """Arm and tension; returns true vertical tension and stroke."""
    running.compensate(100)
    return running.truth()


def ended(running: Running, code: int, before: tuple[float, float]) -> str:
    """Check that the daemon ended with this code, with no process, traceback or motion left; returns its output."""
    assert running.daemon.wait(patience_s()) == code, running.log.read_text()
    said = running.log.read_text()
    assert "Traceback" not in said
    after = running.truth()
    assert after[1] == pytest.approx(before[1], abs=0.5)
    assert after[0] == pytest.approx(before[0], rel=0.03)
    return said


@pytest.mark.parametrize("killed", ["gateway", *(pytest.param(one, marks=pytest.mark.long) for one in ("", "control"))])
def test_a_runtime_folder_that_is_deleted_ends_the_daemon_with_the_stroke_held(running: Running, killed: str) -> None:
    before = tensioned(running)
    runtime = Runtime.of(daemons.name_of(running.file))
    if killed:
        module = {"gateway": "rigctl.gateway.gateway_process", "control": "rigctl.control"}[killed]
        os.kill(daemons.process_with(module, str(runtime.directory)), signal.SIGKILL)
    shutil.rmtree(runtime.directory)
    said = ended(running, 1, before)
    lost = f"the runtime folder {re.escape(str(runtime.directory))} is lost: (it|[a-z_.]+ in it) has been deleted"
    assert re.search(f"{lost}; the daemon ends", said), said  # a file is deleted before the folder is
    if killed != "control":
        assert "stopped in HOLD" in said
        assert "brake closed; ended because the runtime folder" in said
    log = (running.file.parent / f"audit/{daemons.name_of(running.file)}.jsonl").read_text()
    assert '"what":"folder_lost"' in log
    assert not runtime.directory.exists()


def test_a_port_that_another_program_has_before_the_first_start_is_an_event_and_in_the_status(
    tmp_path: pathlib.Path,
) -> None:
    file, log = daemons.slow_rig_file(tmp_path), tmp_path / "daemon.log"
    host, _, port = daemons.endpoint(file).removeprefix("tcp/").rpartition(":")
    notes: list[str] = []
    with (
        socket.create_server((host, int(port))) as taken,
        daemons.simulated_rig(file, tmp_path / "rig.log"),
        daemons.daemon(file, log),
    ):
        said = next(line for line in log.read_text().splitlines() if ": DISARMED," in line)
        assert said.endswith(f"answering on the sockets of this computer; another program has {daemons.endpoint(file)}")
        assert until(lambda: daemons.state(file), log=log)["mode"] == "DISARMED"
        assert daemons.rigctl("arm", file=file).returncode == 0
        shown = daemons.rigctl("status", "--all", file=file).stdout
        assert f"another program has {daemons.endpoint(file)}" in shown, shown
        taken.close()
        audit = file.parent / "audit" / f"{daemons.name_of(file)}.jsonl"
        until(lambda: f"{daemons.endpoint(file)} is this daemon's again" in audit.read_text(), log=log)
        notes += [line["what"] for line in map(json.loads, audit.read_text().splitlines())]
        assert until(lambda: socket.create_connection((host, int(port)), patience_s()), log=log)
    assert [one for one in notes if one.startswith("endpoint_")] == ["endpoint_taken", "endpoint_back"]


def test_an_audit_log_that_is_renamed_is_an_alarm_once(running: Running) -> None:
    log = running.file.parent / f"audit/{daemons.name_of(running.file)}.jsonl"
    log.rename(log.with_name("away.jsonl"))
    until(lambda: "AUDIT_LOG_CHANGED" in daemons.rigctl("alarms", file=running.file).stdout, log=running.log)
    running.do("arm")
    running.do("disarm")
    kinds = until(lambda: (read := log.read_text()).count('"command_accepted"') >= 2 and read, log=running.log)
    assert [kinds.count(f'"what":"{what}"') for what in ("tampered", "audit_log_changed")] == [1, 1]
    assert running.log.read_text().count("was renamed or deleted while the daemon ran") == 1


def test_sighup_ends_it_like_sigterm(running: Running) -> None:
    before = tensioned(running)
    running.daemon.send_signal(signal.SIGHUP)
    assert "COMPENSATING -> HOLD: daemon stopping" in ended(running, 0, before)
    running.rig.send_signal(signal.SIGHUP)
    assert running.rig.wait(patience_s()) == 0


def test_a_damaged_active_json_is_written_anew_for_a_process_that_comes_back(running: Running) -> None:
    runtime = Runtime.of(daemons.name_of(running.file))
    before = runtime.read_json("active.json")
    file = runtime.directory / "active.json"
    file.write_bytes(file.read_bytes().replace(b'"k_tension":', b'"k_tension":9', 1))
    os.kill(daemons.process_with("rigctl.gateway.gateway_process", str(runtime.directory)), signal.SIGKILL)
    until(lambda: daemons.state(running.file), log=running.log)
    assert "active.json in the runtime folder was damaged" in running.log.read_text()
    assert runtime.read_json("active.json") == before


def test_the_loop_is_the_last_that_the_kernel_ends_for_want_of_memory(running: Running) -> None:
    folder = str(Runtime.of(daemons.name_of(running.file)).directory)
    modules = ("rigctl.page", "rigctl.gateway.gateway_process", "rigctl.recorder", "rigctl.control")
    pids = [daemons.process_with(module, folder) for module in modules]
    scores = [int(pathlib.Path(f"/proc/{pid}/oom_score_adj").read_text()) for pid in (*pids, running.daemon.pid)]
    *beside, control, supervisor = scores
    assert beside == [800, 500, 300]
    assert control <= supervisor <= 0
    limits = [resource.prlimit(pid, resource.RLIMIT_DATA)[0] for pid in pids]
    assert limits == [1 << 30] * 3 + [resource.prlimit(running.daemon.pid, resource.RLIMIT_DATA)[0]]


@pytest.mark.simulated_time
@pytest.mark.parametrize(
    ("words", "limit"),
    [
        *((("rigctl", "run", str(daemons.PAPER)), limit) for limit in (6, 16, 48)),
        (("rigctl", "status"), 8),
        (("rigctl", "demo"), 24),
        (("rigctl", "bench", str(daemons.PAPER)), 10),
        (("hil", "serve", str(daemons.PAPER)), 48),
    ],
)
def test_a_low_limit_of_open_files_is_one_line(words: tuple[str, ...], limit: int) -> None:
    command = f"ulimit -n {limit}; exec {sys.executable} -m {' '.join(words)}"
    answer = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, timeout=patience_s(), check=False
    )
    assert answer.returncode == 1
    assert f"found a limit of {limit} open files, expected 64 or more" in answer.stderr
    assert answer.stderr.count("\n") == 1


@pytest.mark.simulated_time
@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, for a mount of its own")
@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        (
            "mount -t tmpfs -o size=1m tmpfs /dev/shm",
            "No space left on device: the rings need 26.3 MB, 1.0 MB are free",
        ),
        ("mount -t tmpfs -o ro tmpfs /dev/shm", "Read-only file system"),
        ("mount -t tmpfs tmpfs /dev && mknod -m 666 /dev/null c 1 3", "No such file or directory"),
        ("mkdir /dev/shm/rigctl-NAME && chmod 777 /dev/shm/rigctl-NAME", "found mode 0777, expected"),
        ("mkdir /dev/shm/rigctl-NAME && chown 4321 /dev/shm/rigctl-NAME", "found a folder of user 4321"),
        ("ln -s /tmp /dev/shm/rigctl-NAME", "found a link, expected"),
    ],
)
def test_a_runtime_folder_that_cannot_be_had_is_one_line(tmp_path: pathlib.Path, prepare: str, said: str) -> None:
    file = daemons.rig_file(tmp_path)
    prepare = prepare.replace("NAME", daemons.name_of(file))
    command = f"mount -t tmpfs tmpfs /dev/shm; {prepare}; exec {sys.executable} -m rigctl run {file}"
    command_line = ["unshare", "-m", "bash", "-c", command]
    answer = subprocess.run(command_line, capture_output=True, text=True, cwd=ROOT, timeout=patience_s(), check=False)
    assert answer.returncode == 1, answer.stderr
    assert said in answer.stderr
    assert answer.stderr.count("\n") == 1


@pytest.mark.simulated_time
def test_without_a_home_or_a_runtime_folder_of_the_user_commands_are_as_ever() -> None:
    for words, code in ((("check", str(daemons.PAPER)), 0), (("status", "--connect", "tcp/127.0.0.1:1"), 1)):
        command = ["env", "-i", sys.executable, "-m", "rigctl", *words]
        answer = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=patience_s(), check=False)
        assert answer.returncode == code, answer.stderr
        assert answer.stderr == ""
        assert "Traceback" not in answer.stdout
        assert ("nothing listens at tcp/127.0.0.1:1" in answer.stdout) is (code == 1)
