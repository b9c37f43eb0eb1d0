"""Processes that hang, one by one and all, and output that is not read: HOLD gets through, the hung are replaced."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Mode
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until
from tests.live.system.test_daemon import PATIENT

MODULES = {
    "gateway": "rigctl.gateway.gateway_process", "recorder": "rigctl.recorder", "page": "rigctl.page",
    "control": "rigctl.control",
}  # fmt: skip
OTHERS = ("supervisor", "gateway", "recorder", "page")


class Hanging:
    """A daemon with its page, armed."""

    def __init__(self, file: pathlib.Path, supervisor: int) -> None:
        self.file, self.supervisor = file, supervisor
        self.runtime = Runtime.of(daemons.name_of(file))
        self.records = self.runtime.records.reader()

    def pid(self, name: str) -> int:
        if name == "supervisor":
            return self.supervisor
        return next(iter(daemons.processes_with(MODULES[name], f"rigctl-{self.runtime.directory.name[7:]}")), 0)

    def audited(self, what: str, process: str) -> list[dict[str, Any]]:
        log = self.file.parent / "audit" / f"{daemons.name_of(self.file)}.jsonl"
        lines = [json.loads(line) for line in log.read_text().splitlines()]
        return [line for line in lines if line["what"] == what and line["details"].get("process") == process]

    def hold(self) -> None:
        held = daemons.rigctl("hold", "--json", file=self.file)
        answer = json.loads(held.stdout)
        assert (answer["accepted"], answer["mode"], answer["via"]) == (True, "HOLD", "local socket"), held.stderr

    @contextlib.contextmanager
    def stopped(self, *names: str) -> Iterator[list[int]]:
        found = [self.pid(name) for name in names]
        for pid in found:
            os.kill(pid, signal.SIGSTOP)
        try:
            yield found
        finally:
            for pid in found:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hanging]:
    folder = tmp_path_factory.mktemp("hung")
    file = daemons.rig_file(folder, PATIENT)
    file.write_text(f'{file.read_text()}\npage: {{listen: "127.0.0.1:{daemons.free_port()}"}}\n')
    with (
        daemons.simulated_rig(file, folder / "rig.log"),
        daemons.daemon(file, folder / "daemon.log") as daemon,
    ):
        armed = daemons.rigctl("arm", file=file)
        assert armed.returncode == 0, armed.stderr
        yield Hanging(file, daemon.pid)


@pytest.mark.parametrize("names", [*((name,) for name in OTHERS), OTHERS], ids="+".join)
def test_hold_gets_through_with_each_other_process_stopped_and_with_all(rig: Hanging, names: tuple[str, ...]) -> None:
    until(lambda: all(map(rig.pid, names)))
    with rig.stopped(*names):
        for _ in range(3):
            rig.hold()
    record = rig.records.latest()
    assert record is not None
    assert record["mode"] == Mode.HOLD


@pytest.mark.parametrize(
    "name", ["gateway", *(pytest.param(one, marks=pytest.mark.long) for one in ("recorder", "page"))]
)
def test_one_that_hangs_is_reported_and_replaced(rig: Hanging, name: str) -> None:
    pid = until(lambda: rig.pid(name))
    with rig.stopped(name):
        until(lambda: rig.pid(name) not in (0, pid))
    entered = until(lambda: rig.audited("process_stalled", name))
    assert any("no progress for 1 s, stopped by a signal" in entry["text"] for entry in entered)
    ended = until(lambda: rig.audited("process_ended", name))
    assert "hung, without progress for 5 s, and was killed" in ended[-1]["text"]
    until(lambda: daemons.mode(rig.file) == "HOLD")
    rig.hold()


def test_a_supervisor_that_hangs_is_on_record_and_in_the_state(rig: Hanging) -> None:
    until(lambda: daemons.state(rig.file))
    with rig.stopped("supervisor"):
        until(lambda: rig.audited("process_stalled", "supervisor"))
        until(lambda: "supervisor process: no progress for 1 s" in daemons.state(rig.file).get("warnings", []))
    until(lambda: rig.audited("process_resumed", "supervisor"))
    until(lambda: "supervisor process" not in " ".join(daemons.state(rig.file)["warnings"]))


def test_a_loop_that_hangs_is_replaced_and_comes_back_disarmed(rig: Hanging) -> None:
    pid = rig.pid("control")
    with rig.stopped("control"):
        until(lambda: rig.pid("control") not in (0, pid))
    until(lambda: daemons.mode(rig.file) == "DISARMED")
    assert rig.audited("process_stalled", "control")


def test_what_hangs_when_the_supervisor_is_killed_is_ended_by_the_next_start(tmp_path: pathlib.Path) -> None:
    """The gateway had kept the port; the recorder, woken later, had written to the new run's audit log."""
    file, log = daemons.slow_rig_file(tmp_path), tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, tmp_path / "before.log") as before:
        rig = Hanging(file, before.pid)
        with rig.stopped("gateway", "recorder", "control") as hung:
            before.kill()
            before.wait()
            with daemons.daemon(file, log):
                for name, pid in zip(("gateway", "recorder", "control"), hung, strict=True):
                    line = f"WARNING: the {name} of an earlier run (process {pid}) hung, and was killed"
                    assert log.read_text().count(line) == 1, log.read_text()
                    assert pid not in daemons.processes_with(MODULES[name])
                assert until(lambda: daemons.state(file))["mode"] == "DISARMED"
                assert f"answering at {daemons.endpoint(file)}" in log.read_text()
    audit = tmp_path / "audit" / f"{daemons.name_of(file)}.jsonl"
    kinds = [json.loads(line)["what"] for line in audit.read_text().splitlines()]
    assert kinds.count("daemon_started") == 2
    assert "tampered" not in kinds


def test_no_process_waits_for_a_reader_of_the_daemons_output(tmp_path: pathlib.Path) -> None:
    """A full pipe from the start: the daemon comes up, replaces, records, and ends on SIGTERM."""
    file = daemons.rig_file(tmp_path, PATIENT)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b"x" * 4096)
    os.set_blocking(writing, True)
    with daemons.simulated_rig(file, tmp_path / "rig.log"):
        words = [sys.executable, "-m", "rigctl", "run", str(file)]
        daemon = subprocess.Popen(words, cwd=ROOT, stdout=writing, stderr=writing, stdin=subprocess.DEVNULL)
        try:
            until(lambda: daemons.mode(file) == "DISARMED" if daemons.state(file) else False)
            rig = Hanging(file, daemon.pid)
            before = rig.pid("gateway")
            os.kill(before, signal.SIGKILL)
            until(lambda: rig.pid("gateway") not in (0, before))
            until(lambda: rig.audited("process_ended", "gateway"))
            entries = len(list((tmp_path / "audit").glob("*.jsonl")))
            assert entries == 1
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(patience_s()) == 0
            assert rig.audited("process_started", "gateway")
        finally:
            daemon.kill()
            daemon.wait()
            os.close(reading)
            os.close(writing)
