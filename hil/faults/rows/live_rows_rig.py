"""The real daemon and the simulated rig as processes of their own, with the rig's truth log."""

from __future__ import annotations

import contextlib
import os
import pathlib
import secrets
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

import can
import numpy as np
import numpy.typing as npt

from hil.faults import wall_clock
from hil.scenario.errors import ScenarioError
from hil.truth import TRUTH_DTYPE
from rigctl.client.connection import Client, NoDaemonError
from rigctl.config.settings import RigSettings
from rigctl.demo import live_rig
from rigctl.devices import objects
from rigctl.devices.objects import AiStatus
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.faults import Fault
from rigctl.model.states import Mode

OPERATOR = "faults"
START_S = 60.0
MODE_S = 60.0
STOP_S = 20.0
POLL_S = 0.02
WAY, SPARE = 0.07, 0.5
"""Shares of the target: a moving mode's distance from its end, and the least load on the rope in every mode."""
CONTROL, GATEWAY, SUPERVISOR, RECORDER = "control", "gateway", "supervisor", "recorder"
VICTIMS = (CONTROL, GATEWAY, SUPERVISOR, RECORDER)

_MODULES = {CONTROL: b"rigctl.control", GATEWAY: b"rigctl.gateway.gateway_process", RECORDER: b"rigctl.recorder"}


class LiveError(RuntimeError):
    """The daemon or the rig does not work as it should; ``str()`` is one line."""


class Live:
    """Rig and daemon; made by `live`."""

    def __init__(self, folder: pathlib.Path, settings: RigSettings) -> None:
        self.folder = folder
        self.file = folder / "rig.yaml"
        name = f"faults_{secrets.token_hex(4)}"
        played = live_rig.own(settings, "faults").model_copy(update={"rig": name})
        bus = played.can.model_copy(update={"channel": str(folder / "bus.sock")})
        live_rig.rig_file(played.model_copy(update={"can": bus}), folder)
        self.endpoint = played.telemetry.listen
        self.log = folder / "daemon.log"
        self._environment = wall_clock.prepare(folder)
        self.rig, self.runtime = name, Runtime.of(name)
        self.target_n = settings.tension.target_n
        self._way_n, self._spare_n = WAY * self.target_n, SPARE * self.target_n
        self.daemon: subprocess.Popen[bytes] | None = None
        self._rig: subprocess.Popen[bytes] | None = None
        self._client: Client | None = None
        self._records: RingReader | None = None
        self._truth_at = 0
        self._refusal = ""  # the last one

    # -- processes ----------------------------------------------------------------------------------------------
    def start(self) -> None:
        """Start the rig, then the daemon, to DISARMED."""
        self._rig = self._spawn(
            "hil", "serve", str(self.file), "--truth", str(self.folder / "truth.bin"), log="rig.log"
        )
        self._until(lambda: b"serving" in (self.folder / "rig.log").read_bytes(), "the simulated rig")
        self.start_daemon()

    def start_daemon(self) -> None:
        """Start ``rigctl run`` and wait until its loop ticks."""
        if self.runtime.directory.exists():
            self.runtime.remove()
        self._records = None
        if self._client is not None:  # a client of the previous daemon commands no other
            self._client.close()
            self._client = None
        before = self.log.read_bytes().count(b": DISARMED,") if self.log.exists() else 0
        self.daemon = self._spawn("rigctl", "run", str(self.file), log=self.log.name)
        self._until(lambda: self.log.read_bytes().count(b": DISARMED,") > before, "the daemon")

    def close(self) -> None:
        """End rig and daemon, and remove what they left."""
        if self._client is not None:
            self._client.close()
        for process in (self.daemon, self._rig):
            if process is not None and process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.terminate()
                try:
                    process.wait(STOP_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
        with contextlib.suppress(OSError):
            self.runtime.remove()

    def pid(self, victim: str) -> int:
        """Process id of one of ``VICTIMS``."""
        assert self.daemon is not None
        if victim == SUPERVISOR:
            return self.daemon.pid
        module = _MODULES[victim]
        folder = str(self.runtime.directory).encode()
        found: list[int] = []

        def running() -> bool:
            found[:] = [pid for pid, words in _command_lines() if module in words and folder in words]
            return bool(found)

        self._until(running, f"the {victim} process")
        return found[0]

    def ticking(self) -> bool:
        """Whether the loop has written a record within the last moment."""
        slot = self.latest()
        return slot is not None and time.monotonic_ns() - int(slot["t_ns"]) < 100_000_000

    # -- the operator -------------------------------------------------------------------------------------------
    def command(self, verb: str) -> bool:
        """Give a command; returns whether it was accepted. Repeats it while the gateway restarts."""
        until = time.monotonic() + MODE_S
        while time.monotonic() < until:
            with contextlib.suppress(NoDaemonError):
                if self._client is None:
                    self._client = Client(self.endpoint, self.rig, self._run_id())
                answer = self._client.command(verb, OPERATOR)
                if not answer["accepted"]:
                    if verb != "reset":  # tried where arming was refused, and less specific
                        self._refusal = f"{verb}: {answer.get('text', '')}"
                    if str(answer.get("reason", "")).startswith("lease"):
                        self._client.take_lease(OPERATOR)  # the daemon has restarted, or was away for long
                return bool(answer["accepted"])
            time.sleep(0.1)
        raise LiveError(f"{verb}: nobody answers")

    def _run_id(self) -> str:
        """Run id of the daemon started here; no other daemon is commanded."""
        assert self.daemon is not None
        if (run_id := live_rig.run_id_of(self.daemon, self.rig)) is None:
            raise NoDaemonError("the daemon that was started here does not run")
        return run_id

    def latest(self) -> Any:
        """The newest record, or None."""
        if self._records is None:
            with contextlib.suppress(OSError, ValueError):
                self._records = self.runtime.records.reader()
        return None if self._records is None else self._records.latest()

    @property
    def mode(self) -> Mode | None:
        """The loop's mode; None while it does not tick."""
        slot = self.latest()
        return Mode(int(slot["mode"])) if slot is not None and self.ticking() else None

    @property
    def fault(self) -> str:
        """The latched fault."""
        slot = self.latest()
        return Fault(int(slot["fault"])).name if slot is not None else ""

    def enter(self, wanted: Mode) -> None:
        """Take the rig from any mode to another; TENSIONING and RELEASING with some way left.

        Raises:
            LiveError: the rig does not get there.
        """
        until = time.monotonic() + MODE_S
        while not self._there(wanted):
            mode = self.mode
            if time.monotonic() > until:
                name = "no mode" if mode is None else mode.name
                raise LiveError(
                    f"not in {wanted.name} within {MODE_S:g} s but in {name}, fault {self.fault}; {self._refusal}; "
                    f"log: {self._last_words()}"
                )
            self._towards(mode, wanted)
            time.sleep(POLL_S)

    def _there(self, wanted: Mode) -> bool:
        """Whether the mode is reached, with the load on the rope and some way left."""
        if self.mode is not wanted:
            return False
        tension_n, spare_n = float(self.latest()["tension_n"]), self._spare_n
        if wanted is Mode.TENSIONING:
            return spare_n < tension_n < self.target_n - self._way_n
        return tension_n > spare_n

    def _towards(self, mode: Mode | None, wanted: Mode) -> None:
        if mode is None:
            return
        tension_n, way_n = float(self.latest()["tension_n"]), self._way_n
        if mode is Mode.FAULT:
            self.command("reset")
        elif mode is Mode.DISARMED:
            if not self.command("arm"):
                self.command("reset")  # the drive's own fault from earlier
        elif tension_n < self._spare_n + way_n or wanted is Mode.COMPENSATING:
            self._ask(mode, Mode.TENSIONING, "tension")
        elif wanted is Mode.FAULT:
            self.invalid_sample()
        elif wanted in (Mode.HOLD, Mode.DISARMED):
            self.command("hold" if mode is not Mode.HOLD else "disarm")
        elif wanted is Mode.RELEASING or tension_n > self.target_n - 2.0 * way_n:
            self._ask(mode, Mode.RELEASING, "release")
        else:
            self._ask(mode, Mode.TENSIONING, "tension")

    def _ask(self, mode: Mode, leads_to: Mode, verb: str) -> None:
        """Give a command that is not being carried out yet."""
        if mode is not leads_to:
            self.command(verb)

    def invalid_sample(self) -> None:
        """Send one frame under the cell's identifier that is marked invalid: the rig goes to FAULT."""
        with contextlib.closing(_Bus(str(self.folder / "bus.sock"))) as bus:
            bus.send(objects.CELL_TPDO.cob_base + 2, struct.pack("<iB", 0, int(AiStatus.NOT_VALID)))

    # -- the truth ----------------------------------------------------------------------------------------------
    def truth(self, from_ns: int, to_ns: int) -> npt.NDArray[Any]:
        """Truth records of a span of CLOCK_MONOTONIC, which must begin after the previous call's span began."""
        file, size = self.folder / "truth.bin", TRUTH_DTYPE.itemsize
        until = time.monotonic() + START_S
        rows = np.empty(0, TRUTH_DTYPE)
        while not len(rows) or rows["t_ns"][-1] < to_ns:
            if time.monotonic() > until:
                raise LiveError("the simulated rig writes no truth")
            time.sleep(POLL_S)
            with file.open("rb") as stream:
                stream.seek(self._truth_at)
                data = stream.read()
            rows = np.frombuffer(data, TRUTH_DTYPE, len(data) // size)
        found = rows[(rows["t_ns"] >= from_ns) & (rows["t_ns"] <= to_ns)]
        self._truth_at += int(np.searchsorted(rows["t_ns"], from_ns)) * size
        return found

    # -- internals ----------------------------------------------------------------------------------------------
    def _spawn(self, *arguments: str, log: str) -> subprocess.Popen[bytes]:
        with (self.folder / log).open("ab") as out:
            return subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                env=self._environment,
            )

    def _until(self, what: Callable[[], bool], name: str) -> None:
        until = time.monotonic() + START_S
        while not what():
            for process in (self.daemon, self._rig):
                if process is not None and process.poll() is not None and time.monotonic() > until - START_S + STOP_S:
                    raise LiveError(f"{name}: {self._last_words()}")
            if time.monotonic() > until:
                raise LiveError(f"{name} is not there within {START_S:g} s: {self._last_words()}")
            time.sleep(POLL_S)

    def _last_words(self) -> str:
        logs = [file.read_text(errors="replace").strip() for file in self.folder.glob("*.log")]
        return " | ".join(text.rsplit("\n", 1)[-1] for text in logs if text)


class _Bus:
    """A foreign node on the bus."""

    def __init__(self, channel: str) -> None:
        self._bus = can.Bus(interface="rigsim", channel=channel)

    def send(self, can_id: int, data: bytes) -> None:
        """Send one frame."""
        self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


@contextlib.contextmanager
def live(settings: RigSettings) -> Iterator[Live]:
    """Rig and daemon, running, DISARMED; ended and removed afterwards.

    Raises:
        ScenarioError: they do not come up, or a `LiveError` within the block (1).
    """
    with tempfile.TemporaryDirectory(prefix="hil-faults-") as folder:
        subject = Live(pathlib.Path(folder), settings)
        try:
            subject.start()
            yield subject
        except LiveError as error:
            raise ScenarioError([f"faults: {error}"], exit_code=1) from None
        finally:
            subject.close()


def _command_lines() -> Iterator[tuple[int, list[bytes]]]:
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                yield int(entry.name), (entry / "cmdline").read_bytes().split(b"\0")


def alive(pid: int) -> bool:
    """Whether a process exists and is not a zombie."""
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def give(pid: int, number: signal.Signals) -> None:
    """Send a signal; a process that has just ended is no error."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)
