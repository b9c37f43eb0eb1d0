"""The test rig: simulated rig and daemon with their own bus, rig name, endpoint and files, for demo, bench and tests.

A real rig's daemon may run on the same computer; nothing here reaches it. Every command carries the run id of the
daemon started here, and no other daemon accepts it.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import yaml

from rigctl.client.connection import Client, NoDaemonError
from rigctl.config.settings import RigSettings
from rigctl.ipc.runtime_folder import ACTIVE, Runtime, is_free
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb

START_LIMIT_S = 60.0
STOP_LIMIT_S = 10.0
ARM_NS, ARM_AGAIN_S = 3_000_000_000, 0.1
LONGEST_NAME = 32
_POLL_S = 0.02
_LOOK_S = 0.5


class LiveRigError(RuntimeError):
    """A process did not start or answer, or a command was refused; ``str()`` is one line."""


@dataclass
class LiveRig:
    """The running processes, and the connection to the daemon."""

    settings: RigSettings
    client: Client
    operator: str
    """Who gives the commands."""
    rig: subprocess.Popen[bytes]
    daemon: subprocess.Popen[bytes]
    _given_ns: int = 0
    """When the loop answered the last command, CLOCK_MONOTONIC."""

    def do(self, verb: Verb, *values: float) -> dict[str, Any]:
        """Give a command; returns its answer. It is repeated until a new daemon has samples of every device.

        Raises:
            LiveRigError: it was refused, or the daemon did not answer.
        """
        until_ns = time.monotonic_ns() + ARM_NS
        while True:
            try:
                answer = self.client.command(verb.name.lower(), self.operator, *values)
            except NoDaemonError as error:
                raise LiveRigError(str(error)) from None
            if answer.get("reason") != "preflight" or time.monotonic_ns() > until_ns:
                break
            time.sleep(ARM_AGAIN_S)
        if not answer["accepted"]:
            raise LiveRigError(answer["text"])
        self._given_ns = answer.get("t_ns", 0)
        return answer

    def run(self, seconds: float) -> npt.NDArray[Any]:
        """Let time pass; returns the loop's records of it, one a tick, of dtype `rigctl.ipc.record.RECORD`."""
        reader = Runtime.of(self.settings.rig).records.reader()
        until, parts = time.monotonic() + seconds, [reader.read()]
        while (left_s := until - time.monotonic()) > 0.0:
            time.sleep(min(left_s, 1.0))
            parts.append(reader.read())
        return np.concatenate(parts)

    def run_until(self, mode: Mode, limit_s: float) -> None:
        """Wait until the loop is in ``mode``; states from before the last command do not count.

        Raises:
            LiveRigError: the daemon did not answer.
            TimeoutError: the loop is in another mode after ``limit_s``, or has tripped.
        """
        until, found = time.monotonic() + limit_s, ""
        while found != mode.name:
            if found == Mode.FAULT.name or time.monotonic() > until:
                raise TimeoutError(f"not in {mode.name} within {limit_s:g} s, but in {found}")
            time.sleep(_LOOK_S)
            state = self.state()
            if state.get("t_ns", 0) >= self._given_ns:
                found = str(state.get("mode"))

    def end(self) -> None:
        """End daemon, then simulated rig, which has closed its truth log when this returns.

        Raises:
            LiveRigError: one of them did not end.
        """
        for name, child in (("the daemon", self.daemon), ("the simulated rig", self.rig)):
            child.send_signal(signal.SIGTERM)
            try:
                child.wait(STOP_LIMIT_S)
            except subprocess.TimeoutExpired:
                raise LiveRigError(f"{name} did not end within {STOP_LIMIT_S:.0f} s") from None

    def state(self) -> dict[str, Any]:
        """The daemon's state.

        Raises:
            LiveRigError: the daemon did not answer.
        """
        try:
            return self.client.state()
        except NoDaemonError as error:
            raise LiveRigError(str(error)) from None


def own(settings: RigSettings, purpose: str) -> RigSettings:
    """The rig's settings with another name and endpoint, and with their own state files and rig file.

    Args:
        settings: the rig's.
        purpose: prefix of the name; each rig has one name while that is free, so that its recordings stay limited.
    """

    def of(section: str, **changes: Any) -> Any:
        return getattr(settings, section).model_copy(update=changes)

    name = f"{purpose}_{settings.rig}"[:LONGEST_NAME]
    changes: dict[str, Any] = {}
    encoder = settings.cylinder.stroke_waiver or f"{purpose}: the simulated rig, its stroke begins at 0"
    changes["cylinder"] = of("cylinder", stroke_waiver=encoder)
    if settings.calibration is not None:
        why = settings.calibration.waiver or f"{purpose}: the simulated rig, nothing hangs there"
        changes["calibration"] = of("calibration", file=None, waiver=why)
    return settings.model_copy(
        update={
            **changes,
            "rig": name if is_free(name) else f"{purpose}_{os.getpid()}",
            "can": of("can", interface="rigsim", bitrate_bit_s=None),
            "telemetry": of("telemetry", listen=free_endpoint(), join=[]),
            "audit": of("audit", file=None, trips="trips"),
            "recording": of("recording", folder="recordings"),
            "page": None,
        }
    )


def free_endpoint() -> str:
    """A free loopback port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


@contextlib.contextmanager
def start_live_rig(
    settings: RigSettings, folder: pathlib.Path, operator: str, *options: str, quiet: bool = False
) -> Iterator[LiveRig]:
    """Run daemon and simulated rig until the block ends; the block begins once the daemon is DISARMED.

    Args:
        settings: those to run with, see `own`; the bus is replaced by a socket in ``folder``.
        folder: folder for rig file and bus socket.
        operator: who gives the commands.
        options: further options of ``python -m hil serve``.
        quiet: hide the daemon's log, but not its errors.

    Raises:
        LiveRigError: one of them could not start; its message is on standard error.
    """
    bus = settings.can.model_copy(update={"channel": str(folder / "bus.sock")})
    settings = settings.model_copy(update={"can": bus})
    file = str(rig_file(settings, folder))
    with contextlib.ExitStack() as stack:
        rig = stack.enter_context(process("hil", "serve", file, *options, stdout=subprocess.PIPE))
        assert rig.stdout is not None
        rig.stdout.readline()  # returns when the rig serves or has ended
        daemon = stack.enter_context(process("rigctl", "run", file, stdout=subprocess.DEVNULL if quiet else None))
        client = stack.enter_context(_connect(daemon, rig, settings))
        yield LiveRig(settings, client, operator, rig, daemon)


@contextlib.contextmanager
def process(*arguments: str, **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    """``python -m arguments``; at the end of the block it gets SIGTERM and, if it does not end, SIGKILL.

    It has a session of its own, so that Ctrl-C reaches only the command, which ends the daemon before the rig.
    """
    child = subprocess.Popen([sys.executable, "-m", *arguments], start_new_session=True, **options)
    try:
        yield child
    finally:
        if child.poll() is None:
            child.send_signal(signal.SIGTERM)
        try:
            child.wait(STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def run_id_of(daemon: subprocess.Popen[bytes], rig: str) -> str | None:
    """Run id of the daemon of ``rig`` started here; None until the runtime folder belongs to it."""
    with contextlib.suppress(OSError, msgspec.MsgspecError):
        written = Runtime.of(rig).read_json(ACTIVE)
        if written.get("pid") == daemon.pid and isinstance(run_id := written.get("run_id"), str):
            return run_id
    return None


def _connect(daemon: subprocess.Popen[bytes], rig: subprocess.Popen[bytes], settings: RigSettings) -> Client:
    """The operator's connection to the daemon started here, and to no other, once its loop runs."""
    limit_s = START_LIMIT_S + settings.start_up_limit_s
    until = time.monotonic() + limit_s
    while time.monotonic() < until:
        if rig.poll() is not None:
            raise LiveRigError("the simulated rig could not start (see above)")
        if daemon.poll() is not None:
            raise LiveRigError("the daemon could not start (see above)")
        if (run_id := run_id_of(daemon, settings.rig)) is None:
            time.sleep(_POLL_S)
            continue
        with contextlib.suppress(NoDaemonError):
            client = Client(settings.telemetry.listen, settings.rig, run_id)
            with contextlib.suppress(NoDaemonError):
                if client.state().get("mode") == Mode.DISARMED.name:
                    return client
            client.close()
        time.sleep(_POLL_S)
    raise LiveRigError(f"the daemon did not answer within {limit_s:.0f} s")


def rig_file(settings: RigSettings, folder: pathlib.Path) -> pathlib.Path:
    """The rig file to run with, with absolute paths of device files."""
    data = settings.model_dump(mode="json", exclude={"directory", "plain"}, exclude_none=False)
    for device in ("tension_cell", "inclinometer", "cylinder", "rail_encoder", "io", "second_force"):
        if not data[device]:
            continue
        data[device]["eds"] = str(settings.file(data[device]["eds"]))
        if data[device].get("dbc"):
            data[device]["dbc"]["file"] = str(settings.file(data[device]["dbc"]["file"]))
    if data["design"]["gains_file"] is not None:
        data["design"]["gains_file"] = str(settings.file(data["design"]["gains_file"]))
    file = folder / "rig.yaml"
    file.write_text(yaml.safe_dump(data))
    return file
