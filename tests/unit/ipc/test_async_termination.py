"""An event loop and a signal that comes while it is being made."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.builders.paths import ROOT

INTERRUPTED = """
import asyncio, os, signal, sys
from rigctl.ipc.async_termination import run_until_signal

made, number = asyncio.events.new_event_loop, signal.Signals[sys.argv[1]]

def interrupted():
    os.kill(os.getpid(), number)
    return made()

async def main():
    await asyncio.sleep(3600)

asyncio.events.new_event_loop = interrupted
try:
    run_until_signal(main(), asyncio.Task.cancel)
except asyncio.CancelledError:
    print("ended")
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_while_the_loop_is_made_ends_it_in_order(name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, name], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "ended\n", "")
