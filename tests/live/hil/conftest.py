"""The simulated rig as a process of its own, on a socket of its own."""

from __future__ import annotations

import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator

import canopen
import pytest

from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

REPOSITORY = ROOT

Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def rig_file() -> Iterator[pathlib.Path]:
    """A copy of the paper's rig with a socket in its own folder (short: a socket's path has at most 107 characters)."""
    with tempfile.TemporaryDirectory(prefix="rig", dir="/tmp") as name:
        folder = pathlib.Path(name)
        shutil.copytree(REPOSITORY / "config/eds", folder / "eds")
        text = (REPOSITORY / "config/paper_rig.yaml").read_text()
        text, replaced = re.subn(r"channel: \S+", f"channel: {folder}/rig.sock", text)
        assert replaced == 1
        file = folder / "rig.yaml"
        file.write_text(text)
        yield file


@pytest.fixture
def channel(rig_file: pathlib.Path) -> str:
    return str(rig_file.with_name("rig.sock"))


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts ``python -m ARGUMENTS`` with its output piped; processes that still run at the end are killed."""
    running: list[subprocess.Popen[str]] = []
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it, and passes that on

    def start(*arguments: object, **variables: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", *map(str, arguments)]
        environment = {**os.environ, "PYTHONUNBUFFERED": "1", **variables}
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        running.append(process)
        return process

    yield start
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def served(rig_file: pathlib.Path, start: Start) -> subprocess.Popen[str]:
    """A ``python -m hil serve`` that is ready."""
    process = start("hil", "serve", rig_file, "--truth", rig_file.with_name("truth.bin"))
    assert process.stdout is not None
    ready = process.stdout.readline()
    assert ready.startswith("serving paper_rig on rigsim:"), ready
    return process


@pytest.fixture
def network(served: subprocess.Popen[str], channel: str) -> Iterator[canopen.Network]:
    """A canopen master on the served rig, its remote nodes described by the rig's EDS files."""
    assert served.poll() is None
    network = canopen.Network()
    network.connect(interface="rigsim", channel=channel)
    for node, name in {2: "tension_amplifier", 3: "inclinometer", 4: "cylinder_drive", 112: "simulator"}.items():
        sdo = network.add_node(node, str(REPOSITORY / f"config/eds/{name}.eds")).sdo
        sdo.RESPONSE_TIMEOUT, sdo.MAX_RETRIES = 5.0, 3
    yield network
    network.disconnect()


@pytest.fixture
def finish() -> Callable[[subprocess.Popen[str]], tuple[int, str, str]]:
    """Ends a process with SIGTERM; returns its exit code and the rest of its output."""

    def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=patience_s())
        return process.returncode, out, err

    return finish
