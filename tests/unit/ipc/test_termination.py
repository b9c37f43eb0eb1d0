"""A process ends on a termination signal, however often and whenever the signal comes."""

from __future__ import annotations

import ast
import pathlib
import signal
import subprocess
import sys
import time

import rigctl
from tests.builders.waiting import patience_s

STORM = """
import signal, time
from rigctl.ipc.termination import Termination
stop = Termination(signal.SIGTERM)
print("ready", flush=True)
while not stop.requested:
    time.sleep(0.0001)
input()
print("over", flush=True)
"""


def test_a_storm_of_signals_ends_a_process_and_never_hangs_it() -> None:
    child = subprocess.Popen([sys.executable, "-c", STORM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    for _ in range(50):
        child.send_signal(signal.SIGTERM)
        time.sleep(0)
    out, _ = child.communicate("all sent\n", timeout=patience_s())
    assert (out, child.returncode) == ("over\n", 0)


def test_no_process_of_the_daemon_sets_an_event_in_a_signal_handler() -> None:
    for file in pathlib.Path(rigctl.__file__).parent.rglob("*.py"):
        for call in ast.walk(ast.parse(file.read_text())):
            if isinstance(call, ast.Call) and ast.unparse(call.func) == "signal.signal":
                assert ".set(" not in ast.unparse(call), f"{file}:{call.lineno}"
