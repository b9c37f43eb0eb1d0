"""A process that is a service of its own joins the run of a daemon, and ends with it."""

from __future__ import annotations

import os
import pathlib
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from rigctl.config import layout
from rigctl.ipc import runtime_folder
from rigctl.ipc.joining import SERVICE, Joined, Presence, UsageError, joined, presence, presence_file
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.ipc.supervision import Doing
from rigctl.ipc.termination import Termination
from rigctl.supervisor.service_process import ServiceProcess
from tests.builders.waiting import patience_s

DAEMON = """
import sys, time
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from rigctl.config import layout
import pathlib, os
layout.RUN = pathlib.Path(sys.argv[1])
runtime = Runtime.of("rig", layout.RUN)
lock = runtime.claim()
runtime.write_json(ACTIVE, {"pid": os.getpid(), "run_id": "one"})
print("up", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def base(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    monkeypatch.setattr(layout, "RUN", tmp_path)
    return tmp_path


@pytest.fixture
def daemon(base: pathlib.Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has the folder, and nothing else of a daemon."""
    made = subprocess.Popen([sys.executable, "-c", DAEMON, str(base)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                            text=True)  # fmt: skip
    assert made.stdout is not None
    assert made.stdout.readline() == "up\n"
    yield made
    made.kill()
    made.communicate()


def join(base: pathlib.Path, stop: Termination) -> Joined:
    found = joined([SERVICE, str(base / "rigctl-rig")], "gateway", stop)
    assert found is not None
    return found


def test_it_waits_for_a_daemon_and_goes_when_it_is_to_end_before_one_comes(base: pathlib.Path) -> None:
    asked: list[bool] = []
    stop = Termination()
    stop.also = lambda: asked.append(True) or len(asked) > 2  # type: ignore[func-returns-value]
    assert joined([SERVICE, str(base / "rigctl-rig")], "gateway", stop) is None


@pytest.mark.usefixtures("daemon")
def test_it_ends_when_the_daemon_calls_its_end_and_not_that_of_another(base: pathlib.Path) -> None:
    stop = Termination()
    run = join(base, stop)
    assert not stop.requested
    supervisor = Runtime(base / "rigctl-rig")
    supervisor.end("recorder")
    assert not stop.requested
    supervisor.end("gateway")
    assert stop.requested
    assert not run.is_gone()


def test_it_ends_when_the_daemon_is_killed(base: pathlib.Path, daemon: subprocess.Popen[str]) -> None:
    stop = Termination()
    run = join(base, stop)
    daemon.kill()
    daemon.wait(patience_s())
    assert stop.requested
    assert run.is_gone()


def test_it_does_not_join_a_run_that_it_was_to_leave_or_one_whose_daemon_is_gone(
    base: pathlib.Path, daemon: subprocess.Popen[str]
) -> None:
    def joins() -> bool:
        stop = Termination()
        threading.Timer(0.5, lambda: setattr(stop, "also", lambda: True)).start()
        return joined([SERVICE, str(base / "rigctl-rig")], "gateway", stop) is not None

    before = len([*pathlib.Path("/proc/self/fd").iterdir()])
    Runtime(base / "rigctl-rig").end("gateway")
    assert not joins()
    daemon.kill()
    daemon.wait(patience_s())
    assert not joins()
    assert len([*pathlib.Path("/proc/self/fd").iterdir()]) == before  # a service may wait for days


def test_the_next_daemon_takes_the_marks_of_a_killed_one_away(
    base: pathlib.Path, daemon: subprocess.Popen[str]
) -> None:
    Runtime(base / "rigctl-rig").end("gateway")
    daemon.send_signal(signal.SIGKILL)
    daemon.wait(patience_s())
    anew = Runtime.of("rig", base)
    lock = anew.claim()
    assert not anew.is_to_end("gateway")
    assert anew.cleared == []
    os.close(lock)


def test_the_supervisor_sees_it_come_and_go(base: pathlib.Path) -> None:
    runtime = Runtime.of("rig", base)
    lock = runtime.claim()
    watched = ServiceProcess(runtime, "gateway", "two")
    with subprocess.Popen(["sleep", "600"]) as process:
        runtime.write_json(presence_file("gateway"), Presence(process.pid, "one"))
        assert watched.look(1.0) is None  # of the run before
        runtime.write_json(presence_file("gateway"), Presence(process.pid, "two"))
        assert watched.look(2.0) is Doing.PROCESS_STARTED
        assert watched.look(3.0) is None
        process.kill()
        process.wait()
        assert watched.look(4.0) is Doing.PROCESS_ENDED
        assert watched.look(5.0) is None
        assert watched.end(0.0)
    os.close(lock)


def test_a_child_of_the_supervisor_joins_at_once(tmp_path: pathlib.Path) -> None:
    runtime = Runtime.of("rig", tmp_path)
    lock = runtime.claim()
    stop = Termination()
    found = joined([str(runtime.directory)], "gateway", stop)
    assert found is not None
    runtime.write_json(ACTIVE, {"run_id": "one"})
    assert presence(runtime, "gateway", "one") == 0
    found.show()
    assert presence(runtime, "gateway", "one") == os.getpid()
    assert presence(runtime, "gateway", "another") == presence(runtime, "hold", "one") == 0
    runtime.end("gateway")
    assert not stop.requested
    os.close(lock)


@pytest.mark.parametrize("words", [[], [SERVICE], ["one", "two"], [SERVICE, "one", "two"]])
def test_another_command_line_is_refused(words: list[str]) -> None:
    with pytest.raises(UsageError, match=r"\[--service\] RUNTIME_DIR"):
        joined(words, "gateway", Termination())


def test_an_exchanged_design_counts_in_its_own_run(tmp_path: pathlib.Path) -> None:
    runtime = Runtime.of("rig", tmp_path)
    lock = runtime.claim()
    runtime.write_json(ACTIVE, {"run_id": "two", "design": {"name": "first"}})
    mark = runtime.mark(ACTIVE)
    runtime.write_json(runtime_folder.DESIGN, {"run_id": "one", "design": {"name": "old"}})
    assert runtime.read_json(ACTIVE)["design"] == {"name": "first"}
    runtime.write_json(runtime_folder.DESIGN, {"run_id": "two", "design": {"name": "exchanged"}})
    assert runtime.read_json(ACTIVE)["design"] == {"name": "exchanged"}
    assert runtime.mark(ACTIVE) != mark
    os.close(lock)


def test_a_child_process_finds_an_entered_folder_by_the_same_name(tmp_path: pathlib.Path) -> None:
    runtime = Runtime.of("rig", tmp_path)
    lock = runtime.claim()
    runtime.write_json(ACTIVE, {"run_id": "two"})
    entered = Runtime.entered(runtime.directory)
    program = "import sys; from rigctl.ipc.runtime_folder import *; print(Runtime(sys.argv[1]).read_json(sys.argv[2]))"
    words = [sys.executable, "-c", program, str(entered.directory), ACTIVE]
    made = subprocess.run(words, pass_fds=entered.descriptors, capture_output=True, text=True, check=True)
    assert made.stdout == "{'run_id': 'two'}\n"
    entered.leave()
    os.close(lock)
