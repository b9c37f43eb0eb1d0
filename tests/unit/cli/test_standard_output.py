"""Standard output that is full, closed or left by its reader: the run goes on, and the exit code reports it."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys

import pytest

from rigctl.cli.standard_output import Outlet
from tests.builders.paths import ROOT

GOES_ON = """
import sys
from rigctl.cli import standard_output
standard_output.guard()
for number in range(20_000):  # more than any pipe or buffer holds
    print(number)
    if number > 10_000 and standard_output.nobody_reads():
        break
sys.stderr.write(f"to {number}: {standard_output.complaint()}\\n")
"""
FULL = "standard output cannot be written: No space left on device"


def shell(command: str) -> subprocess.CompletedProcess[str]:
    line = command.replace("rigctl ", f"{sys.executable} -m rigctl ").replace("hil ", f"{sys.executable} -m hil ")
    return subprocess.run(
        ["bash", "-c", line], capture_output=True, text=True, cwd=ROOT, timeout=120, check=False,
        env={**os.environ, "LC_ALL": "C.UTF-8", "GOES_ON": GOES_ON, "PYTHON": sys.executable, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("where", "said"),
    [
        (">/dev/full", f"to 19999: {FULL}"),
        ("| head -c 1", "to 10001: None"),
        (">&-", "to 19999: None"),
        (">/dev/null", "to 19999: None"),
    ],
)
def test_a_run_goes_on_and_knows(where: str, said: str) -> None:
    answer = shell(f'"$PYTHON" -c "$GOES_ON" {where}')
    assert answer.stderr == f"{said}\n"


def test_a_closed_descriptor_is_not_given_to_the_next_file() -> None:
    program = "import rigctl.cli.standard_output as s; s.guard(); import os, sys; print(1); sys.exit(os.dup(0))"
    assert shell(f'"$PYTHON" -c "{program}" <&- >&- 2>&-').returncode == 3


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("rigctl check config/paper_rig.yaml >/dev/full", 2, f"rigctl: {FULL}\n"),
        ("rigctl check --json config/paper_rig.yaml >/dev/full", 2, f"rigctl: {FULL}\n"),
        ("rigctl check config/paper_rig.yaml | head -1 >/dev/null; exit ${PIPESTATUS[0]}", 0, ""),
        ("rigctl check config/paper_rig.yaml >&-", 0, ""),
        ("rigctl check nothing.yaml 2>/dev/full", 2, ""),
        ("rigctl check nothing.yaml 2>&-", 2, ""),
        ("PYTHONIOENCODING=ascii rigctl check config/paper_rig.yaml >/dev/null", 0, ""),
        ("hil --help >/dev/full", 2, f"hil: {FULL}\n"),
        ("hil --help >&-", 0, ""),
        ("hil --help | head -1 >/dev/null; exit ${PIPESTATUS[0]}", 0, ""),
    ],
)
def test_a_command_says_so_in_one_line(command: str, code: int, said: str) -> None:
    answer = shell(command)
    assert (answer.returncode, answer.stderr) == (code, said)


def test_a_disk_that_has_room_again_is_written_again(tmp_path: pathlib.Path) -> None:
    (tmp_path / "log").touch()
    full = os.open("/dev/full", os.O_WRONLY)
    outlet = Outlet(full, "wb", closefd=False)
    assert outlet.write(b"lost") == 4
    assert isinstance(outlet.failure, OSError)
    log = os.open(tmp_path / "log", os.O_WRONLY)
    os.dup2(log, full)
    assert outlet.write(b"kept") == 4
    assert (tmp_path / "log").read_bytes() == b"kept"
    for descriptor in (log, full):
        os.close(descriptor)
