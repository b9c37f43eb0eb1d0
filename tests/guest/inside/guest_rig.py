"""The guest's rig: simulated devices on vcan0, the adapter of `adapter.py` between it and the daemon's interface."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import re
import subprocess
import sys
from collections.abc import Callable
from typing import Any, Self, TypeVar

import canopen

from rigctl.client.connection import Client, NoDaemonError
from rigctl.devices import objects as od
from rigctl.model.device_states import STATUSWORD, DriveState
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

BUS = "vcan0"
TARGET_N = 100.0
# User-mode Linux: a system call costs 200 times the host's, and one processor has daemon, rig and tests to run.
GUEST: dict[str, dict[str, Any]] = {
    "loop": {"priority": 80, "cpu": 0, "lock_memory": False},
    "can": {"interface": "socketcan"},
    "preflight": {"disk_free_mib": 64},  # the guest's disk is half of its gigabyte of memory
    "recording": {"enabled": False},  # for which it has no room either
    "telemetry": {"rate_hz": 10},
}
STOPPED_TICKS = 20
CABLE_PRIORITY = 78
"""A cable is never late: ahead of the simulated rig (FIFO 70), behind the loop (80)."""
T = TypeVar("T")
_RUNNING = (od.SIMULATOR_NODE, "simulator"), (4, "cylinder_drive")


def rig_file(folder: pathlib.Path, channel: str) -> pathlib.Path:
    """A slow rig on the interface ``channel``."""
    return daemons.slow_rig_file(folder, {**GUEST, "can": {**GUEST["can"], "channel": channel}}, rig="guest")


def link(device: str, *words: str) -> None:
    """``ip link set DEVICE WORD...``."""
    subprocess.run(["/sbin/ip", "link", "set", device, *words], check=True)


def controller(device: str) -> dict[str, Any]:
    """What the kernel says of a CAN interface's controller: ``state`` and the counts of its errors."""
    shown = subprocess.run(
        ["/sbin/ip", "-j", "-d", "-s", "link", "show", device], check=True, capture_output=True, text=True
    )
    info = json.loads(shown.stdout)[0]["linkinfo"]
    return {"state": info["info_data"]["state"], **info["info_xstats"]}


def patient(ask: Callable[[], T]) -> T:
    """Ask until there is an answer: the daemon's own processes have a fraction of one slow processor."""
    answers: list[T] = []

    def asked() -> bool:
        with contextlib.suppress(NoDaemonError):
            answers.append(ask())
        return bool(answers)

    until(asked)
    return answers[0]


def kernel_workers() -> list[int]:
    """The kernel's threads that carry, among others, the bytes of a serial line."""
    names = pathlib.Path("/proc").glob("[0-9]*/comm")
    return [int(name.parent.name) for name in names if name.read_text().startswith("kworker/")]


class Cable:
    """The adapter, plugged in; its interface is up."""

    def __init__(self) -> None:
        program = str(pathlib.Path(__file__).with_name("adapter.py"))
        self._process = subprocess.Popen(
            [sys.executable, program, BUS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.interface = self._line()
        link(self.interface, "up", "txqueuelen", "10", "type", "can", "bitrate", "1000000")
        for pid in (self._process.pid, *kernel_workers()):
            with contextlib.suppress(ProcessLookupError):
                os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(CABLE_PRIORITY))

    def order(self, text: str) -> None:
        """Carried out when this returns."""
        assert self._process.stdin is not None
        self._process.stdin.write(text + "\n")
        self._process.stdin.flush()
        assert self._line() == "done"

    def unplug(self) -> None:
        """The interface vanishes."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        assert self._process.wait(patience_s()) == 0

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


class Truth:
    """The plant's and the drive's own word, asked over the devices' side of the bus."""

    def __init__(self) -> None:
        self._network = canopen.Network()
        self._network.NOTIFIER_CYCLE = 0.05
        answers = [{"can_id": 0x580 + node, "can_mask": 0x7FF, "extended": False} for node, _ in _RUNNING]
        self._network.connect(interface="socketcan", channel=BUS, can_filters=answers)
        for node, eds in _RUNNING:
            added = self._network.add_node(canopen.RemoteNode(node, str(ROOT / f"config/eds/{eds}.eds")))
            added.sdo.RESPONSE_TIMEOUT, added.sdo.MAX_RETRIES = 2.0, 3

    @property
    def vertical_n(self) -> float:
        return self._read(od.SIMULATOR_NODE, od.SIM_TRUE_VERTICAL_MN) * 1e-3

    @property
    def stroke_mm(self) -> float:
        return self._read(od.SIMULATOR_NODE, od.SIM_TRUE_STROKE_UM) * 1e-3

    @property
    def drive(self) -> DriveState:
        return od.drive_state(self._read(4, STATUSWORD))

    def close(self) -> None:
        self._network.disconnect()

    def _read(self, node: int, index: int) -> int:
        return int(self._network[node].sdo[index].raw)


class GuestRig:
    """Rig, adapter, daemon and one operator at it."""

    def __init__(self, folder: pathlib.Path) -> None:
        self._stack = contextlib.ExitStack()
        self._daemon = contextlib.ExitStack()
        for name in ("served", "run"):
            (folder / name).mkdir()
        served = rig_file(folder / "served", BUS)
        self._stack.enter_context(daemons.simulated_rig(served, folder / "rig.log"))
        self.truth = Truth()
        self._stack.callback(self.truth.close)
        self.cable = Cable()
        self.file = rig_file(folder / "run", self.cable.interface)
        self.log = folder / "daemon.log"
        self.restart()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._stack, self._daemon:
            self._stack.callback(self.cable.unplug)

    def restart(self) -> None:
        """End the daemon, if there is one, and start it."""
        self._daemon.close()
        self.log.write_bytes(b"")
        self._process = self._daemon.enter_context(daemons.daemon(self.file, self.log))
        self._client = self._daemon.enter_context(patient(self._reach))

    @property
    def state(self) -> dict[str, Any]:
        return patient(self._client.state)

    @property
    def mode(self) -> str:
        return str(self.state["mode"])

    @property
    def said(self) -> str:
        return self.log.read_text()

    def command(self, verb: str, value: float | None = None) -> dict[str, Any]:
        """The answer; the operator's lease is renewed first, for faults last longer than it."""
        assert patient(lambda: self._client.take_lease("kim"))["accepted"]
        return self._client.command(verb, "kim", value)

    def carried_out(self, verb: str, value: float | None = None) -> None:
        answers: list[dict[str, Any] | None] = []

        def answered() -> dict[str, Any] | None:
            answers.append(self._answer(verb, value))
            return answers[-1]

        answer = until(answered, log=self.log)
        before = answer.get("reason") == "already" and len(answers) > 1  # carried out, and the answer came too late
        assert answer["accepted"] or before, f"{answer['text']}\n{self.said}"

    def _answer(self, verb: str, value: float | None) -> dict[str, Any] | None:
        """The answer, None where none came in time: one processor has to start gateway and rig at once."""
        try:
            return self.command(verb, value)
        except NoDaemonError:
            return None

    def until(self, mode: str) -> None:
        until(lambda: self.mode == mode, log=self.log)

    def until_said(self, words: str, after: int = 0) -> None:
        """Wait for an event in the daemon's log, from character ``after`` on."""
        until(lambda: words in self.said[after:], log=self.log)

    def compensate(self) -> float:
        """COMPENSATING, by the operator's commands alone, the daemon running on; the true stroke then."""
        until(self._step, log=self.log)
        assert self._process.poll() is None
        return self.truth.stroke_mm

    def stopped_by_host(self, after: int) -> bool:
        """The host has stopped the whole guest for a while, since character ``after`` of the log."""
        return any(int(ticks) >= STOPPED_TICKS for ticks in re.findall(r"(\d+) ticks skipped", self.said[after:]))

    def starved_by_host(self, after: int) -> bool:
        """The same, or the rig's processes alone: they took no frame for as long as the adapter's queue holds."""
        return self.stopped_by_host(after) or "No buffer space available" in self.said[after:]

    def _reach(self) -> Client:
        return Client(daemons.endpoint(self.file), daemons.name_of(self.file))

    def _step(self) -> bool:
        mode = self.mode
        if verb := {"FAULT": "reset", "DISARMED": "arm", "HOLD": "tension"}.get(mode):
            with contextlib.suppress(NoDaemonError):  # answered too late: the mode says whether it was carried out
                if mode == "DISARMED":  # a loop that was started anew has the target of the file
                    self.command("target", TARGET_N)
                answer = self.command(verb)
                if verb == "arm" and not answer["accepted"]:
                    self.command("reset")  # the drive's own fault
        return mode == "COMPENSATING"
