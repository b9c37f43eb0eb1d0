"""``python -m hil serve`` as users run it: real processes, real sockets."""

from __future__ import annotations

import pathlib
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable

import can
import canopen
import pytest

from hil.serve import COMPILING
from hil.truth import read
from tests.builders.waiting import patience_s

Start = Callable[..., "subprocess.Popen[str]"]
Finish = Callable[["subprocess.Popen[str]"], tuple[int, str, str]]
pytestmark = pytest.mark.real_time
SYNC = can.Message(arbitration_id=0x80, is_extended_id=False)
START_ALL = can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False)


def syncs_answered(bus: can.BusABC, count: int) -> int:
    """Cell TPDOs received for ``count`` SYNCs, each awaited."""
    answers = 0
    for _ in range(count):
        bus.send(SYNC)
        deadline = time.monotonic() + patience_s()
        while time.monotonic() < deadline:
            message = bus.recv(patience_s())
            if message is not None and message.arbitration_id == 0x182:
                answers += 1
                break
    return answers


def test_it_says_when_it_is_ready_and_what_it_did(
    served: subprocess.Popen[str], channel: str, rig_file: pathlib.Path, finish: Finish
) -> None:
    with can.Bus(interface="rigsim", channel=channel) as bus:
        bus.send(START_ALL)
        assert syncs_answered(bus, 20) == 20
    code, out, err = finish(served)
    assert (code, err) == (0, "")
    summary = re.fullmatch(r"served: (\d+) frames in, (\d+) out, 0 lost, 0 malformed, 1 client\n", out)
    assert summary is not None, out
    assert int(summary[1]) == 21
    assert int(summary[2]) >= 40
    assert not pathlib.Path(channel).exists()
    truth = read(rig_file.with_name("truth.bin"))
    assert len(truth) > 0
    assert set(truth["t_ns"][1:] - truth["t_ns"][:-1]) == {1_000_000}


def notes_of(served: subprocess.Popen[str]) -> str:
    """Standard error of a rig that is ended once it serves."""
    assert served.stdout is not None
    assert served.stdout.readline().startswith("serving")
    served.send_signal(2)
    return served.communicate(timeout=patience_s())[1]


def test_the_bus_can_be_joined_only_when_the_plant_is_compiled(
    start: Start, channel: str, rig_file: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    """Compiling takes longer than a daemon waits for devices (can.boot_wait_s)."""
    served = start("hil", "serve", rig_file, NUMBA_CACHE_DIR=str(tmp_path))
    while not pathlib.Path(channel).exists():
        assert served.poll() is None
        time.sleep(0.01)
    compiled = {file.name.partition("-")[0] for file in tmp_path.rglob("*.nbc")}
    assert {"kernel.run", "kernel.observe", "kernel.screw_error"} <= compiled
    first, *later = notes_of(served).splitlines()
    assert first == COMPILING
    assert all(re.fullmatch(re.escape(COMPILING) + r": [0-9]+0 s", line) for line in later)
    assert notes_of(start("hil", "serve", rig_file, NUMBA_CACHE_DIR=str(tmp_path))) == ""


def test_sigint_ends_it_as_cleanly(served: subprocess.Popen[str]) -> None:
    served.send_signal(2)
    assert served.communicate(timeout=patience_s())[1] == ""
    assert served.returncode == 0


def test_a_second_rig_on_one_socket_is_refused_and_the_first_lives_on(
    served: subprocess.Popen[str], rig_file: pathlib.Path, channel: str, start: Start
) -> None:
    second = start("hil", "serve", rig_file)
    out, err = second.communicate(timeout=patience_s())
    assert (second.returncode, out) == (1, "")
    assert err == f"{channel}: another simulated rig is being served here\n"
    assert served.poll() is None
    with can.Bus(interface="rigsim", channel=channel) as bus:
        bus.send(START_ALL)
        assert syncs_answered(bus, 3) == 3


def test_after_sigkill_the_next_one_takes_the_socket_over(
    served: subprocess.Popen[str], rig_file: pathlib.Path, channel: str, start: Start
) -> None:
    served.kill()
    served.wait()
    assert pathlib.Path(channel).is_socket()
    again = start("hil", "serve", rig_file)
    assert again.stdout is not None
    assert again.stdout.readline().startswith("serving")


@pytest.mark.parametrize(
    ("old", "new", "code", "reason"),
    [
        (r"(?s)\nsimulation:.*", "\n", 2, "simulation: found nothing"),
        (r"rate_hz: 1000", "rate_hz: 1e3", 2, "loop.rate_hz"),
        (r"channel: \S+", "channel: /nowhere/rig.sock", 1, "/nowhere/rig.sock: cannot be served"),
        (r"interface: rigsim", "interface: socketcan", 1, "rig.sock"),
        (r"interface: rigsim", "interface: nonsense", 2, "found nonsense, expected an interface of python-can"),
    ],
)
def test_what_cannot_be_served_is_one_line(
    rig_file: pathlib.Path, start: Start, old: str, new: str, code: int, reason: str
) -> None:
    text, replaced = re.subn(old, new, rig_file.read_text(), count=1)
    assert replaced == 1
    rig_file.write_text(text)
    process = start("hil", "serve", rig_file)
    out, err = process.communicate(timeout=patience_s())
    assert (process.returncode, out) == (code, "")
    assert reason in err
    assert len([line for line in err.splitlines() if not line.startswith("hil: compiling")]) == 1


def test_a_truth_log_that_cannot_be_written_is_one_line_and_leaves_no_socket(
    rig_file: pathlib.Path, channel: str, start: Start
) -> None:
    process = start("hil", "serve", rig_file, "--truth", rig_file.with_name("no") / "truth.bin")
    out, err = process.communicate(timeout=patience_s())
    assert (process.returncode, out) == (2, "")
    folder = rig_file.with_name("no")
    lines = [line for line in err.splitlines() if not line.startswith("hil: compiling")]  # in a new clone
    assert lines == [f"--truth: {folder}/truth.bin cannot be written: there is no folder {folder}"]
    assert not pathlib.Path(channel).exists()


def test_python_cans_logger_records_while_the_rig_runs(
    served: subprocess.Popen[str], channel: str, tmp_path: pathlib.Path, start: Start
) -> None:
    log = tmp_path / "rig.asc"
    with can.Bus(interface="rigsim", channel=channel) as bus:
        logger = start("can.logger", "-i", "rigsim", "-c", channel, "-f", log)
        assert logger.stdout is not None
        while "Can Logger" not in logger.stdout.readline():
            assert logger.poll() is None
        bus.send(START_ALL)
        assert syncs_answered(bus, 100) == 100
        deadline = time.monotonic() + patience_s()
        # The writer keeps the order, but writes in blocks: send until a later frame is in the file.
        while not log.exists() or "7F0" not in log.read_text():
            assert time.monotonic() < deadline
            bus.send(can.Message(arbitration_id=0x7F0, data=bytes(8), is_extended_id=False))
            time.sleep(0.001)
        logger.send_signal(2)
        logger.communicate(timeout=patience_s())
    recorded = [message.arbitration_id for message in can.LogReader(log)]
    assert [recorded.count(can_id) for can_id in (0x80, 0x182, 0x183, 0x184)] == [100, 100, 10, 100]
    assert served.poll() is None


def test_a_killed_client_and_a_stalled_one_disturb_nobody(
    served: subprocess.Popen[str], channel: str, finish: Finish
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stalled:
        stalled.connect(channel)
        client = (
            f"import can; b = can.Bus(interface='rigsim', channel={channel!r}); print(flush=True)\nwhile 1: b.recv()"
        )
        killed = subprocess.Popen([sys.executable, "-c", client], stdout=subprocess.PIPE)
        assert killed.stdout is not None
        killed.stdout.readline()
        with can.Bus(interface="rigsim", channel=channel) as bus:
            bus.send(START_ALL)
            assert syncs_answered(bus, 50) == 50
            killed.kill()
            killed.communicate()
            assert syncs_answered(bus, 5000) == 5000  # more than any socket buffer holds
    code, out, _ = finish(served)
    assert code == 0
    lost = re.search(r"(\d+) lost, 0 malformed, 3 clients", out)
    assert lost is not None, out
    assert int(lost[1]) > 0


def test_devices_go_on_when_the_last_client_has_gone(served: subprocess.Popen[str], channel: str) -> None:
    for _ in range(3):
        with can.Bus(interface="rigsim", channel=channel) as bus:
            bus.send(START_ALL)
            assert syncs_answered(bus, 3) == 3
    assert served.poll() is None


def test_canopen_notifier_and_plain_client_share_the_bus(network: canopen.Network, channel: str) -> None:
    with can.Bus(interface="rigsim", channel=channel) as bus:
        network.nmt.state = "OPERATIONAL"
        assert syncs_answered(bus, 10) == 10
        assert network[2].sdo[0x1008].raw == "Tension amplifier"
