"""What an earlier run has left is ended by the next one: real processes, whose modules are stand-ins that wait."""

from __future__ import annotations

import os
import pathlib
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

import pytest

from rigctl.config import rig_file as config
from rigctl.ipc.record import RECORD
from rigctl.ipc.runtime_folder import Runtime
from rigctl.supervisor import left_processes
from rigctl.supervisor.daemon import PROCESSES
from rigctl.supervisor.left_processes import StillRunsError, end_left
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

WAITS = "import signal, sys\nsignal.signal(signal.SIGTERM, lambda *_: sys.exit(0))\nprint(flush=True)\nsignal.pause()\n"
Start = Callable[[str, pathlib.Path], subprocess.Popen[bytes]]


@pytest.fixture
def runtime(tmp_path: pathlib.Path) -> Runtime:
    found = Runtime(tmp_path / "rigctl-rig")
    found.claim()
    found.make_rings(config.load(ROOT / "config/paper_rig.yaml"))
    return found


@pytest.fixture
def start(tmp_path: pathlib.Path) -> Iterator[Start]:
    """Starts a process with the command line of one of the daemon's."""
    for module in PROCESSES.values():
        file = tmp_path / f"{module.replace('.', '/')}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(WAITS)
    started: list[subprocess.Popen[bytes]] = []

    def one(name: str, folder: pathlib.Path) -> subprocess.Popen[bytes]:
        words = [sys.executable, "-m", PROCESSES[name], str(folder)]
        process = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE)
        started.append(process)
        assert process.stdout is not None
        process.stdout.readline()
        return process

    yield one
    for process in started:
        process.kill()
        process.communicate()


def test_who_is_stopped_is_killed_and_named_and_others_are_left(
    runtime: Runtime, start: Start, tmp_path: pathlib.Path
) -> None:
    hung = {name: start(name, runtime.directory) for name in PROCESSES}
    for process in hung.values():
        process.send_signal(signal.SIGSTOP)
        process.send_signal(signal.SIGTERM)  # the kernel's, as their supervisor was killed
    elsewhere = start("gateway", tmp_path / "rigctl-other")
    said = end_left(runtime, PROCESSES)
    assert sorted(said) == sorted(
        f"the {name} of an earlier run (process {process.pid}) hung, and was killed" for name, process in hung.items()
    )
    assert {process.wait(patience_s()) for process in hung.values()} == {-signal.SIGKILL}
    assert elsewhere.poll() is None
    assert end_left(runtime, PROCESSES) == []


def test_who_ends_by_himself_is_waited_for(runtime: Runtime, start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(left_processes, "ENDS_S", patience_s())
    ends = start("recorder", runtime.directory)
    threading.Timer(0.2, ends.terminate).start()
    assert end_left(runtime, PROCESSES) == []
    assert ends.wait(patience_s()) == 0


def test_a_loop_that_works_is_left_alone_and_named(
    runtime: Runtime, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(left_processes, "ENDS_S", 0.3)
    loop, over, records = start("control", runtime.directory), threading.Event(), runtime.records.writer()
    blank = [0] * (len(RECORD.fields))

    def work() -> None:
        while not over.wait(0.01):
            records.write(*blank)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        until(lambda: records.head)
        with pytest.raises(StillRunsError, match=rf"^the loop of an earlier run \(process {loop.pid}\) still works"):
            end_left(runtime, PROCESSES)
    finally:
        over.set()
        thread.join()
    assert loop.poll() is None
    (said,) = end_left(runtime, PROCESSES)  # without records it hangs
    assert said == f"the control of an earlier run (process {loop.pid}) hung, and was killed"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to be another user")
def test_a_process_of_another_user_is_none_of_ours(
    runtime: Runtime, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = start("gateway", runtime.directory)
    monkeypatch.setattr(os, "geteuid", lambda: 4321)
    assert end_left(runtime, PROCESSES) == []
    assert own.poll() is None
