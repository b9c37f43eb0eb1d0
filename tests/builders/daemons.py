"""Real processes for the tests: rig files, the simulated rig, the daemon, and the operator's commands."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import pathlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import can
import yaml

from rigctl.demo.simulator_node import SimulatorNode
from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.key_folder import KeyFolder
from rigctl.identity.roles import Role
from rigctl.ipc.runtime_folder import Runtime
from rigctl.metrics.tension_error import IN_FLIGHT_TICKS
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

PAPER = ROOT / "config/paper_rig.yaml"
SLOW_HZ = 100
# A rig that a busy host does not trip: a slow loop, and each limit in time as wide as the rig file may have it. The bus
# is silent before a device is stale, so that what the fault is called does not depend on which frame came last.
SLOW: dict[str, dict[str, Any]] = {
    "loop": {"rate_hz": SLOW_HZ, "cpu": None, "spin_us": 0},
    "can": {"heartbeat_ms": 50},
    "cylinder": {"heartbeat_timeout_ms": 1000, "command_deadline_ms": 1000, "status_rate_hz": 5},
    "inclinometer": {"rate_hz": 50},
    "safety": {
        "stale_ms": 1000,
        "bus_silent_ms": 900,
        "inclination_stale_ms": 5000,
        "overrun_ticks": 1000,
        "overrun_window_ms": 60_000,
        "waiver": "a simulated rig on a busy host",
    },
    "estimator": {"tension_walk_n": 30.0},  # calm enough for 100 Hz
}


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def rig_file(folder: pathlib.Path, changes: dict[str, dict[str, Any]] | None = None, *, rig: str = "") -> pathlib.Path:
    """The paper's rig with its own bus socket, name and port, and ``changes`` by section."""
    data = yaml.load(PAPER.read_text(), Loader=yaml.CSafeLoader)
    data["rig"] = rig or f"test_{os.getpid()}_{abs(hash(str(folder))) % 10**8}"
    data["can"]["channel"] = str(folder / "bus.sock")
    data["telemetry"]["listen"] = f"tcp/127.0.0.1:{free_port()}"
    for device, eds in (("tension_cell", "tension_amplifier"), ("inclinometer",) * 2, ("cylinder", "cylinder_drive")):
        data[device]["eds"] = str(ROOT / f"config/eds/{eds}.eds")
    for section, values in (changes or {}).items():
        data.setdefault(section, {}).update(values)
    if "io" in data:
        data["io"].setdefault("eds", str(ROOT / "config/eds/io_node.eds"))
    for device in ("tension_cell", "inclinometer"):
        if dbc := data[device].get("dbc"):
            data[device]["dbc"] = {**dbc, "file": str(PAPER.parent / dbc["file"])}
    file = folder / "rig.yaml"
    file.write_text(yaml.dump(data, Dumper=yaml.CSafeDumper))
    return file


def slow_rig_file(
    folder: pathlib.Path, changes: dict[str, dict[str, Any]] | None = None, *, rig: str = ""
) -> pathlib.Path:
    """`SLOW` with ``changes``, and without the paper rig's limits, which judge a rig at 1 kHz."""
    merged = {section: dict(values) for section, values in SLOW.items()}
    for section, values in (changes or {}).items():
        merged.setdefault(section, {}).update(values)
    file = rig_file(folder, merged, rig=rig)
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), "limits": []}))
    return file


def with_certificates(file: pathlib.Path) -> None:
    """Have the daemon of a rig file listen with certificates: for kim and lee, operators, and vera, a viewer."""
    keys = KeyIssuer(file.parent / "keys", datetime.now(UTC))
    keys.init([])
    for name, role in (("kim", Role.OPERATOR), ("lee", Role.OPERATOR), ("vera", Role.VIEWER)):
        keys.add(name, role)
    data = yaml.safe_load(file.read_text())
    data["telemetry"] |= {"listen": data["telemetry"]["listen"].replace("tcp/", "tls/"), "tls": {"keys": "keys"}}
    file.write_text(yaml.safe_dump(data))


def key_of(name: str, file: pathlib.Path) -> pathlib.Path | None:
    """The key file of a person, None without certificates."""
    found = KeyFolder(file.parent.resolve() / "keys").issued(name)
    return found if found.exists() else None


def endpoint(file: pathlib.Path) -> str:
    return str(yaml.safe_load(file.read_text())["telemetry"]["listen"])


def name_of(file: pathlib.Path) -> str:
    return str(yaml.safe_load(file.read_text())["rig"])


@contextlib.contextmanager
def process(*arguments: str, log: pathlib.Path) -> Iterator[subprocess.Popen[bytes]]:
    """``python -m arguments``, as `command`."""
    with command([sys.executable, "-m", *arguments], log) as child:
        yield child


@contextlib.contextmanager
def command(words: list[str], log: pathlib.Path) -> Iterator[subprocess.Popen[bytes]]:
    """A command, its output in ``log``, ended with SIGTERM (and SIGKILL if that fails)."""
    with log.open("ab") as out:
        child = subprocess.Popen(words, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT)
    try:
        yield child
    finally:
        if child.poll() is None:
            child.send_signal(signal.SIGTERM)
        try:
            child.wait(patience_s())
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
            raise


def processes_with(*words: str) -> list[int]:
    """Processes whose command line has all ``words``."""
    found = []
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                line = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
                if all(any(word in part for part in line) for word in words):
                    found.append(int(entry.name))
    return found


def process_with(*words: str) -> int:
    """The process whose command line has all ``words``."""
    found = processes_with(*words)
    assert found, f"no process with {words}"
    return found[0]


def simulator(file: pathlib.Path) -> SimulatorNode:
    """The simulator's own node on the bus of a rig file from `rig_file`, which is served."""
    bus = str(file.with_name("bus.sock"))
    return SimulatorNode(functools.partial(can.Bus, interface="rigsim", channel=bus), time.monotonic_ns)


@contextlib.contextmanager
def simulated_rig(file: pathlib.Path, log: pathlib.Path) -> Iterator[subprocess.Popen[bytes]]:
    """``python -m hil serve FILE``, ready."""
    with process("hil", "serve", str(file), log=log) as child:
        until(lambda: child.poll() is not None or b"serving" in log.read_bytes(), log=log)
        assert child.poll() is None, log.read_text()
        yield child


@contextlib.contextmanager
def daemon(file: pathlib.Path, log: pathlib.Path) -> Iterator[subprocess.Popen[bytes]]:
    """``rigctl run FILE``, once it reports DISARMED."""
    with process("rigctl", "run", str(file), log=log) as child:
        until(lambda: child.poll() is not None or b": DISARMED," in log.read_bytes(), log=log)
        assert child.poll() is None, log.read_text()
        yield child


def environment(file: pathlib.Path | None) -> dict[str, str]:
    """Environment of an operator at one terminal: all commands share a lease."""
    own = {"RIGCTL_OPERATOR": "kim"}
    if file is not None:
        own["XDG_RUNTIME_DIR"] = str(file.parent.resolve())
        if (key := key_of("kim", file)) is not None:
            own["RIGCTL_KEY"] = str(key)
    return {**os.environ, **own}


def rigctl(*arguments: str, file: pathlib.Path | None = None, lasts_s: float = 0.0) -> subprocess.CompletedProcess[str]:
    """Run one ``rigctl`` command for the daemon of ``file``; all are one operator's, at one terminal.

    ``lasts_s``: what the command itself takes, as a measurement does.
    """
    where = ("--connect", endpoint(file), "--rig", name_of(file)) if file is not None else ()
    return subprocess.run(
        [sys.executable, "-m", "rigctl", *arguments, *where],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment(file),
        timeout=lasts_s + patience_s(),
        check=False,
        stdin=subprocess.DEVNULL,
    )


def state(file: pathlib.Path) -> dict[str, Any]:
    """The daemon's state, as ``rigctl status --json`` prints it; empty while the daemon does not answer."""
    answer = rigctl("status", "--json", file=file)
    return dict(json.loads(answer.stdout)) if answer.returncode == 0 else {}


def frames_lost(file: pathlib.Path) -> int:
    """Device frames the loop has missed so far; a frame still on its way is not lost."""
    records = Runtime.of(name_of(file)).records.reader(from_start=True).read()
    return int(records["frames_lost"][-IN_FLIGHT_TICKS:].min())


def mode(file: pathlib.Path) -> str:
    return str(state(file).get("mode"))
