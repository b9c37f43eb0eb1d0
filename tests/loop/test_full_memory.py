"""Shared memory that is too small for the rings of a simulated rig, as a container's: one line, before the rig runs."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from hil.lockstep import lockstep
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from tests.builders.paths import ROOT
from tests.builders.small_memory import with_small_memory
from tests.builders.waiting import patience_s

pytest_plugins = "pytester"
SHORT = (
    r"the rings need (7\.\d|2\d\.\d) MB, \d\.\d MB are free \(a container: start it with a larger --shm-size, .*64 MB\)"
)
SESSION = """
import pathlib
import pytest

FILE = pathlib.Path("/dev/shm/of_another")

@pytest.fixture
def filled():
    FILE.write_bytes(bytes(12_000_000))
    yield
    FILE.unlink()

def test_before(hil_rig):
    hil_rig.run(0.1)

def test_without_memory(filled, hil_rig):
    hil_rig.run(20.0)

def test_scenario_without_memory(filled, hil_scenario):
    hil_scenario("{scenario}")

def test_after(hil_rig):
    assert hil_rig.run(0.1).mode == "DISARMED"
"""
WARM_UP = """
from rigctl.config import rig_file
from rigctl.control.control_process import HoldSockets, warm_up
from rigctl.design.margins import design_and_check
from rigctl.devices.process_data import wanted

answered, answer = [], HoldSockets.answer
HoldSockets.answer = lambda self, *words: (answered.append(words), answer(self, *words))
settings = rig_file.load("config/paper_rig.yaml")
warm_up(settings, design_and_check(settings).gains, wanted(settings))
print(len(answered))
"""


def test_a_loop_is_warmed_up_without_room_in_shared_memory() -> None:
    """With its HOLD: of a tick's ways it is the one that needs a socket."""
    command = with_small_memory("4k,nr_inodes=1", sys.executable, "-c", WARM_UP)
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=patience_s(), check=False)
    assert (done.stdout, done.stderr) == ("1\n", "")


def test_a_test_without_memory_for_its_rig_fails_alone_with_one_line(pytester: pytest.Pytester) -> None:
    scenario = ROOT / "config/scenarios/jolt.yaml"
    pytester.makepyfile(SESSION.replace("{scenario}", str(scenario)))
    command = with_small_memory("16m", sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider")
    done = pytester.run(*command)
    done.assert_outcomes(passed=2, errors=1, failed=1)
    shown = [line for line in done.outlines if re.search(SHORT, line)]
    assert len([line for line in shown if line.startswith("/dev/shm/rigctl-lockstep-")]) == 2, done.outlines
    assert not any(re.search(r"Traceback|\.py:\d", line) for line in done.outlines), done.outlines


@pytest.mark.parametrize(
    "words",
    [("hil", "scenario", "config/scenarios/jolt.yaml"), ("rigctl", "demo", "--lockstep")],
    ids=lambda words: words[0],
)
def test_a_command_without_memory_for_its_rig_is_one_line(words: tuple[str, ...]) -> None:
    command = with_small_memory("4m", sys.executable, "-m", *words)
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=patience_s(), check=False)
    assert done.returncode == 1, done.stderr
    assert re.search(SHORT, done.stderr)
    assert done.stderr.count("\n") == 1


def test_a_rig_in_simulated_time_needs_8_mb_and_keeps_records_that_wait(settings: RigSettings, gains: Gains) -> None:
    with lockstep(settings, gains) as rig:
        files = [file.stat() for file in rig.runtime.directory.iterdir()]
        assert sum(found.st_blocks * 512 for found in files) >= sum(found.st_size for found in files)  # allocated
        assert sum(found.st_size for found in files) < 8_000_000
        rig.read_records()
        for _ in range(10_000):
            rig.tick()
        ticks = rig.read_records()["tick"]
    assert len(ticks) == 10_000
    assert ticks[-1] - ticks[0] == 9_999
