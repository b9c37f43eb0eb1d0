"""``python -m hil inject`` into a rig that ``python -m hil serve`` runs."""

from __future__ import annotations

import os
import pathlib
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Callable

import can
import pytest

from hil.faults.catalogue import BY_ID
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

pytestmark = pytest.mark.real_time
SYNC = can.Message(arbitration_id=0x80, is_extended_id=False)
START_ALL = can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False)
CELL, DRIVE = 0x182, 0x184


def inject(*words: object) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "-m", "hil", "inject", *map(str, words)],
        cwd=ROOT, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


def answers(bus: can.BusABC, count: int) -> int:
    """Samples of the cell before the drive's, for ``count`` SYNCs."""
    seen = 0
    for _ in range(count):
        bus.send(SYNC)
        until = time.monotonic() + patience_s()
        while time.monotonic() < until:
            message = bus.recv(patience_s())
            seen += message is not None and message.arbitration_id == CELL
            if message is not None and message.arbitration_id == DRIVE:
                break
        else:
            raise AssertionError("the drive does not answer")
    return seen


def test_a_fault_comes_and_goes_on_the_bus(served: subprocess.Popen[str], rig_file: pathlib.Path, channel: str) -> None:
    assert served.poll() is None
    with can.Bus(interface="rigsim", channel=channel) as bus:
        bus.send(START_ALL)
        assert answers(bus, 10) == 10
        assert inject(rig_file, "cell_silent") == (0, "cell_silent: the cell's samples stop, until --end\n", "")
        assert answers(bus, 10) == 0
        assert inject(rig_file, "slope_silent")[::2] == (1, "cell_silent is still injected: end it first (--end)\n")
        assert inject(rig_file, "--end") == (0, "cell_silent has ended\n", "")
        assert answers(bus, 10) == 10
        assert inject(rig_file, "cell_silent", "--for", 0.05)[0] == 0
        until = time.monotonic() + patience_s()
        while not answers(bus, 1):
            assert time.monotonic() < until
        assert inject(rig_file, "--end") == (0, "no fault is injected\n", "")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("none_such",), "found 'none_such', expected a fault of the catalogue"),
        (("cell_silent", "--for", "-1"), "--for: found -1, expected seconds, above 0"),
        (("loop_hangs_50ms",), "it is a fault of the loop"),
    ],
)
def test_what_cannot_be_injected_is_one_line(
    served: subprocess.Popen[str], rig_file: pathlib.Path, words: tuple[str, ...], said: str
) -> None:
    assert served.poll() is None
    if words[0].startswith("loop"):
        words = (next(fault.id for fault in BY_ID.values() if fault.place == "controller"),)
    code, out, err = inject(rig_file, *words)
    assert (code, out, len(err.splitlines())) == (1, "", 1)
    assert said in err


def test_the_socket_is_its_users_takes_no_rubbish_and_goes_with_the_rig(
    served: subprocess.Popen[str], rig_file: pathlib.Path, channel: str,
    finish: Callable[[subprocess.Popen[str]], tuple[int, str, str]],
) -> None:  # fmt: skip
    path = pathlib.Path(f"{channel}.faults")
    assert (path.stat().st_uid, stat.S_IMODE(path.stat().st_mode)) == (os.geteuid(), 0o600)
    for rubbish in (
        b"\xff", b"[]", b'{"fault": 3}', b'{"fault": "cell_silent", "for_s": "x"}', b"x" * 5000,
        b'{"fault": null, "disturb": {"vertical": 3}}', b'{"fault": "cell_silent", "disturb": {}}',
        b'{"fault": null, "disturb": {"mass": [{"change_kg": null, "at_s": 0}]}}', b"x" * 70_000,
    ):  # fmt: skip
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(patience_s())
            connection.connect(str(path))
            connection.send(rubbish)
            assert b'"done":false' in connection.recv(4096)
    assert inject(rig_file, "--end") == (0, "no fault is injected\n", "")
    assert finish(served)[0] == 0
    assert not path.exists()
    code, _out, err = inject(rig_file, "cell_silent")
    assert code == 1
    assert "no simulated rig answers at" in err
