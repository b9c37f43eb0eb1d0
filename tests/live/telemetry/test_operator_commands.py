"""The operator's commands as processes: exit codes, one line each, JSON."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from tests.builders.miniature import Daemon, free_port, running
from tests.builders.operators import KIM, LEE
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

WAIVED = "waived: calibration, tare (simulated cell: there is no weight to hang on it)"


def test_a_session_typed(own: Daemon) -> None:
    own.client().close()
    steps = [
        (("tension",), 1, "", "rigctl: TENSION refused: tension is not possible in DISARMED: arm first\n"),
        (("arm",), 0, f"ARM: armed, HOLD, stroke 0.00 mm, tension 0.0 N; {WAIVED}\n", ""),
        (("arm",), 1, "", "rigctl: ARM refused: already HOLD\n"),
        (("target", "5"), 1, "", "rigctl: TARGET refused: target must be 50 to 350 N\n"),
        (("target", "-5"), 1, "", "rigctl: TARGET refused: target must be 50 to 350 N\n"),
        (("target", "250"), 0, "TARGET: 250 N, HOLD\n", ""),
        (("reset",), 1, "", "rigctl: RESET refused: reset is not possible in HOLD: there is no fault\n"),
    ]
    for arguments, code, said, complained in steps:
        result = own.cli(*arguments)
        assert (result.returncode, result.stdout, result.stderr) == (code, said, complained), arguments
    result = own.cli("tension", "--wait")
    assert result.returncode == 0
    first, last = result.stdout.splitlines()
    assert first == "TENSION: ramping to 250 N, TENSIONING"
    assert last.startswith("TENSION: COMPENSATING, tension 2")
    held = json.loads(own.cli("hold", "--json", "--operator", "kim").stdout)
    assert held["accepted"] is True
    assert (held["mode"], held["operator"]) == ("HOLD", KIM)
    assert own.cli("lease", "return").stdout == "LEASE: given back; the rig goes on as it is\n"
    result = own.cli("release", "--wait", "--json", RIGCTL_OPERATOR="lee")
    answer = json.loads(result.stdout)
    assert (result.returncode, answer["accepted"], answer["mode"], answer["operator"]) == (0, True, "HOLD", LEE)
    assert own.cli("disarm", "--operator", "lee").stdout == "DISARM: drive off, brake closed, DISARMED\n"
    refused = own.cli("hold", "--json")
    assert refused.returncode == 1
    assert json.loads(refused.stdout)["reason"] == "wrong_mode"


def test_wait_ends_when_the_rig_trips(slow: Daemon) -> None:
    slow.client().close()
    slow.cli("arm")
    waiting = slow.spawn("-m", "rigctl.cli.app", "tension", "--wait", stderr=subprocess.PIPE, env=slow.environment())
    assert waiting.stdout is not None
    assert waiting.stdout.readline() == "TENSION: ramping to 300 N, TENSIONING\n"
    slow.cli("target", "222")  # the stand-in trips
    said, complaint = waiting.communicate(timeout=patience_s())
    assert said == ""
    assert waiting.returncode == 1
    assert complaint == "rigctl: TENSION failed: ended in FAULT TENSION_HIGH: tension 412.0 N above 400.0 N\n"


@pytest.fixture
def slow() -> Iterator[Daemon]:
    """A daemon whose ramps never end."""
    yield from running("--slow")


@pytest.mark.parametrize("arguments", [("arm",), ("target", "300"), ("tension", "--wait")])
def test_no_daemon_is_one_line_and_exit_1(shared: Daemon, arguments: tuple[str, ...]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    result = shared.cli(*arguments, RIGCTL_CONNECT=endpoint)
    assert result.returncode == 1
    assert result.stdout == ""
    assert result.stderr == f"rigctl: no daemon answers at {endpoint} (absent, or not allowed)\n"


def test_another_rig_is_not_this_one(shared: Daemon) -> None:
    shared.client().close()
    result = shared.cli("status", "--rig", "other")
    assert result.returncode == 1
    assert result.stderr == f"rigctl: no daemon of other answers at {shared.endpoint}, only of paper_rig\n"


def test_status_fits_a_small_screen(shared: Daemon) -> None:
    shared.client().close()
    brief, whole = shared.cli("status"), shared.cli("status", "--all")
    for result, most in ((brief, 12), (whole, 24)):
        assert result.returncode == 0
        lines = result.stdout.splitlines()
        assert len(lines) <= most
        assert max(map(len, lines)) <= 80
    assert brief.stdout.endswith(" lines more: rigctl status --all\n")
    for word in ("DISARMED", "load", "next step"):
        assert word in brief.stdout
    for word in ("DISARMED", "tension", "vertical error", "target", "stroke", "inclination", "lateness", "skipped"):
        assert word in whole.stdout
    assert json.loads(shared.cli("status", "--json").stdout)["mode"] == "DISARMED"


def test_watch_prints_lines_through_a_restart(own: Daemon) -> None:
    own.client().close()
    command = [sys.executable, "-m", "rigctl.cli.app", "watch", "--connect", own.endpoint]
    watching = subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert watching.stdout is not None
    assert "DISARMED" in watching.stdout.readline()
    own.kill_gateway()
    assert any(line.startswith("no data for ") for line in watching.stdout)
    own.start_gateway()
    assert any("DISARMED" in line for line in watching.stdout)
    watching.send_signal(signal.SIGINT)
    assert watching.communicate(timeout=patience_s())[1] == ""
    assert watching.returncode == 0


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_watch_waits_for_a_daemon(options: tuple[str, ...]) -> None:
    late = Daemon()
    command = [sys.executable, "-m", "rigctl.cli.app", "watch", *options, "--connect", late.endpoint]
    watching = subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert watching.stdout is not None
        assert watching.stderr is not None
        assert watching.stderr.readline() == f"waiting for a daemon at {late.endpoint}; Ctrl-C ends\n"
        late.start_loop()
        late.start_gateway()
        assert "DISARMED" in watching.stdout.readline()
        watching.send_signal(signal.SIGINT)
        waited = watching.communicate(timeout=patience_s())[1].splitlines()
        assert waited[0].startswith("gateway: it has ended: nothing is published, no command but HOLD is taken")
        assert len(waited) == len(set(waited)) <= 2  # each was printed once; the gateway may be met as it starts
        assert watching.returncode == 0
    finally:
        watching.kill()
        watching.communicate()
        late.close()


def test_watch_stops_waiting_at_ctrl_c() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "rigctl.cli.app", "watch", "--connect", endpoint]
    watching = subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert watching.stderr is not None
        assert watching.stderr.readline() == f"waiting for a daemon at {endpoint}; Ctrl-C ends\n"
        watching.send_signal(signal.SIGINT)
        said, complaint = watching.communicate(timeout=patience_s())
        assert said == ""
        assert "Traceback" not in complaint
        assert watching.returncode == 0
    finally:
        watching.kill()
        watching.communicate()


def test_watch_json_is_one_state_per_line(shared: Daemon) -> None:
    shared.client().close()
    command = [sys.executable, "-m", "rigctl.cli.app", "watch", "--json", "--connect", shared.endpoint]
    watching = subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert watching.stdout is not None
    ticks = [json.loads(watching.stdout.readline())["tick"] for _ in range(10)]
    watching.stdout.close()  # as `| head` does
    assert watching.wait(patience_s()) == 0
    assert ticks == sorted(ticks)


def test_watch_screen_survives_a_restart_and_ends_with_ctrl_c(own: Daemon) -> None:
    own.client().close()
    master, slave = pty.openpty()
    command = [sys.executable, "-m", "rigctl.cli.app", "watch", "--connect", own.endpoint]
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    watching = subprocess.Popen(command, cwd=ROOT, env=environment, stdin=slave, stdout=slave, stderr=slave)
    os.close(slave)

    def shows(words: str) -> bool:
        end, text = time.monotonic() + patience_s(), ""
        while words not in text:
            assert time.monotonic() < end, text[-2000:]
            if select.select([master], [], [], 0.1)[0]:
                text = (text + os.read(master, 65536).decode(errors="replace"))[-20_000:]
        return True

    try:
        assert shows("D I S A R M E D")
        own.kill_gateway()
        assert shows("NO DATA FOR")
        own.start_gateway()
        assert shows("D I S A R M E D")
        watching.send_signal(signal.SIGINT)
        assert watching.wait(patience_s()) == 0
    finally:
        watching.kill()
        os.close(master)


def test_a_token_without_a_daemon_is_no_rig_to_choose_from(own: Daemon) -> None:
    with own.client() as client:
        token = client.session.liveliness().declare_token("rigctl/other_rig/live/daemon")  # any session may
        for more in ({}, {"RIGCTL_RIG": "paper_rig"}):
            result = own.cli("status", **more)
            assert (result.returncode, result.stderr) == (0, "")
            assert "paper_rig" in result.stdout
        token.undeclare()  # type: ignore[no-untyped-call]
