"""Standard output that is full, closed or left by its reader: the run goes on, and the exit code reports it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pathlib
import pty
import re
import subprocess
import sys

import pytest

from rigctl.ipc.standard_output import Outlet
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

GOES_ON = """
import sys
from rigctl.ipc import standard_output
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
        ["bash", "-c", line], capture_output=True, text=True, cwd=ROOT, timeout=patience_s(), check=False,
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
    program = "import rigctl.ipc.standard_output as s; s.guard(); import os, sys; print(1); sys.exit(os.dup(0))"
    assert shell(f'"$PYTHON" -c "{program}" <&- >&- 2>&-').returncode == 3


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("rigctl check config/paper_rig.yaml >/dev/full", 2, f"rigctl: {FULL}\n"),
        pytest.param(
            "rigctl check --json config/paper_rig.yaml >/dev/full", 2, f"rigctl: {FULL}\n", marks=pytest.mark.long
        ),
        pytest.param(
            "rigctl check config/paper_rig.yaml | head -1 >/dev/null; exit ${PIPESTATUS[0]}",
            0,
            "",
            marks=pytest.mark.long,
        ),
        pytest.param("rigctl check config/paper_rig.yaml >&-", 0, "", marks=pytest.mark.long),
        ("rigctl check nothing.yaml 2>/dev/full", 2, ""),
        pytest.param("rigctl check nothing.yaml 2>&-", 2, "", marks=pytest.mark.long),
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


NEVER_WAITS = """
import os, sys, time
from rigctl.ipc import standard_output
standard_output.never_wait()
for number in range(20_000):  # more than any pipe or terminal holds
    print(f"line {number}", flush=True)
    sys.stderr.write(f"line {number}\\n")
os.write(3, b"done")
sys.stdin.read()  # until the reader reads again
while os.read(4, 1) == b"x":
    print("late", flush=True)
    os.write(3, b"printed")
"""


class Unread:
    """A process whose output goes to ``descriptor``, and the pipes by which the test follows it."""

    def __init__(self, descriptor: int) -> None:
        told, tell = os.pipe()
        asked, ask = os.pipe()
        self._done, self._ask = told, ask
        words = ["bash", "-c", 'exec "$@" 3>&"$TELL" 4<&"$ASKED"', "-", sys.executable, "-c", NEVER_WAITS]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TELL": str(tell), "ASKED": str(asked)}
        self.process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=descriptor, stderr=descriptor, pass_fds=(tell, asked), env=environment
        )
        os.close(tell)
        os.close(asked)

    def is_done(self) -> bool:
        """Whether it has printed all its lines; it fails with the test's own time limit if it waits for a reader."""
        return os.read(self._done, 16) == b"done"

    def print_more(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        os.write(self._ask, b"x")
        assert os.read(self._done, 16) == b"printed"

    def end(self) -> None:
        os.close(self._ask)
        assert self.process.wait(patience_s()) == 0
        os.close(self._done)


def read_all(descriptor: int) -> str:
    os.set_blocking(descriptor, False)
    found = b""
    with contextlib.suppress(BlockingIOError, OSError):
        while part := os.read(descriptor, 1 << 20):
            found += part
    return found.decode()


def test_a_process_of_the_daemon_does_not_wait_for_a_pipe_that_is_not_read_and_counts_what_is_lost() -> None:
    reading, writing = os.pipe()
    unread = Unread(writing)
    assert unread.is_done()
    assert not fcntl.fcntl(writing, fcntl.F_GETFL) & os.O_NONBLOCK, "the flag is of the file that others share"
    first = read_all(reading)
    assert first.startswith("line 0\n")
    unread.print_more()
    unread.end()
    last = read_all(reading)
    told = re.fullmatch(r"\(rigctl: (\d+) bytes of output were lost: not read\)\nlate\n", last)
    assert told is not None, last
    assert int(told[1]) + len(first) >= len("".join(f"line {number}\n" for number in range(20_000)))
    os.close(reading)
    os.close(writing)


def test_a_process_of_the_daemon_does_not_wait_for_a_terminal_that_is_stopped() -> None:
    terminal, its_end = pty.openpty()
    os.write(terminal, b"\x13")  # Ctrl-S
    unread = Unread(its_end)
    assert unread.is_done()
    os.write(terminal, b"\x11")  # Ctrl-Q
    unread.print_more()
    unread.end()
    assert "bytes of output were lost: not read)" in read_all(terminal)
    os.close(terminal)
    os.close(its_end)
