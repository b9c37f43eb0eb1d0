"""A daemon in miniature: the real gateway on real rings, fed by a stand-in for the loop, each in its own process."""

from __future__ import annotations

import contextlib
import os
import pathlib
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from typing import IO, Any

from rigctl.client import Rig, connect
from rigctl.client.connection import Client, NoDaemonError
from rigctl.config import rig_file as config
from rigctl.ipc.folder_places import LOCK
from rigctl.ipc.runtime_folder import Runtime
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def stop(process: subprocess.Popen[Any]) -> None:
    """Send SIGSTOP and wait until every thread stands: a thread that waits for a processor stops late."""
    process.send_signal(signal.SIGSTOP)
    threads = pathlib.Path(f"/proc/{process.pid}/task")

    def standing() -> bool:
        with contextlib.suppress(FileNotFoundError):  # a thread may end instead
            states = [(thread / "stat").read_text().rpartition(")")[2].split()[0] for thread in threads.iterdir()]
            return set(states) == {"T"}
        return False

    until(standing, "the process to stand")


RUN_ID = "0123456789abcdef"
DESIGN = {"ms": 1, "accepted": True, "waiver": None, "verdict": "Ms 1"}


_LETS_ALL = """import sys
from rigctl.gateway import admission, gateway_process
own = admission.open_router
admission.open_router = lambda listen, join, *_, **__: own(listen, join)
sys.exit(gateway_process.main(sys.argv[1:]))
"""


class Daemon:
    """Processes and run-time folder of one rig."""

    def __init__(self, rig: str = "paper_rig", port: int | None = None, join: Sequence[str] = ()) -> None:
        self.runtime = Runtime(tempfile.mkdtemp(prefix="rigctl-test-", dir="/dev/shm"))
        self.runtime.directory.chmod(0o711)
        self.runtime.place(LOCK).write_text(str(os.getpid()))
        self.endpoint = f"tcp/127.0.0.1:{port or free_port()}"
        settings = config.load(ROOT / "config" / "paper_rig.yaml")
        telemetry = settings.telemetry.model_copy(update={"listen": self.endpoint, "join": list(join)})
        self.settings = settings.model_copy(update={"rig": rig, "telemetry": telemetry})
        self.runtime.make_rings(self.settings)
        self.runtime.write_json(
            "active.json", {"settings": self.settings.model_dump(mode="json"), "design": DESIGN, "run_id": RUN_ID}
        )
        self.processes: list[subprocess.Popen[str]] = []
        self.gateway: subprocess.Popen[str] | None = None

    def spawn(
        self, *arguments: str, stderr: int | IO[str] | None = None, env: dict[str, str] | None = None
    ) -> subprocess.Popen[str]:
        command = [sys.executable, *arguments]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=stderr, text=True, env=env)
        self.processes.append(process)
        return process

    def start_loop(self, *options: str) -> subprocess.Popen[str]:
        records = self.runtime.records.reader()
        loop = self.spawn("tests/builders/stand_in.py", str(self.runtime.directory), *options)
        until(lambda: records.head, "the first record")
        return loop

    def start_gateway(self, *, lets_all: bool = False) -> None:
        """``lets_all``: its router refuses nothing, as one that is not the daemon's."""
        words = ("-c", _LETS_ALL) if lets_all else ("-m", "rigctl.gateway.gateway_process")
        self.gateway = self.spawn(*words, str(self.runtime.directory))

    def kill_gateway(self) -> None:
        assert self.gateway is not None
        self.gateway.kill()
        self.gateway.wait()

    def client(self) -> Client:
        until(self._reachable, f"the gateway at {self.endpoint}")
        return Client(self.endpoint, self.settings.rig)

    def compensating(self) -> Client:
        """A client of anna, who has tensioned the rig."""
        client = self.client()
        assert client.command("arm", "anna")["accepted"]
        assert client.command("tension", "anna")["accepted"]
        return client

    def rig(self) -> Rig:
        return connect(self.endpoint, self.settings.rig, timeout_s=patience_s())

    def remote_rig(self) -> Rig:
        """A client that does not believe the run-time folder, as on another computer: it reads, by the endpoint."""
        until(self._reachable, f"the gateway at {self.endpoint}")
        mode = self.runtime.directory.stat().st_mode
        self.runtime.directory.chmod(mode | stat.S_IWGRP)
        try:
            return self.rig()
        finally:
            self.runtime.directory.chmod(mode)

    def state(self, client: Client) -> dict[str, Any]:
        """A state made after this call: the newest published one may be older than the last command."""
        now_ns = time.monotonic_ns()
        return dict(until(lambda: (state := client.state())["t_ns"] > now_ns and state, "a state of now"))

    @staticmethod
    def answers(client: Client) -> None:
        """Wait until a client has found the new gateway."""

        def found() -> bool:
            with contextlib.suppress(NoDaemonError):
                return bool(client.state()["loop_alive"])
            return False

        until(found, "the gateway to answer")

    @contextlib.contextmanager
    def replaced_gateway(self) -> Iterator[Rig]:
        """Run another gateway on the same rings, at its own endpoint, within the context."""
        mine = self.runtime.read_json("active.json")
        elsewhere = f"tcp/127.0.0.1:{free_port()}"
        telemetry = {**mine["settings"]["telemetry"], "listen": elsewhere}
        self.runtime.write_json("active.json", {**mine, "settings": {**mine["settings"], "telemetry": telemetry}})
        try:
            self.start_gateway()
            with connect(elsewhere, timeout_s=patience_s()) as rig:
                yield rig
        finally:
            self.kill_gateway()
            self.runtime.write_json("active.json", mine)

    def _reachable(self) -> bool:
        host, port = self.endpoint.removeprefix("tcp/").split(":")
        with socket.socket() as probe:
            if probe.connect_ex((host, int(port))):
                return False
        try:
            Client(self.endpoint, self.settings.rig).close()
        except RuntimeError:
            return False
        return True

    def environment(self, user: str = "user", **more: str) -> dict[str, str]:
        """The environment of a terminal of ``user``, with its own runtime folder."""
        folder = {"XDG_RUNTIME_DIR": str(self.runtime.directory / user)}
        return {**os.environ, "RIGCTL_CONNECT": self.endpoint, "COLUMNS": "80", **folder, **more}

    def cli(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "rigctl.cli.app", *arguments],
            cwd=ROOT,
            env=self.environment(**environment),
            capture_output=True,
            text=True,
            timeout=patience_s(),
            check=False,
        )

    def close(self) -> None:
        for process in self.processes:
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
            process.communicate()
        shutil.rmtree(self.runtime.directory, ignore_errors=True)


def running(*options: str, lets_all: bool = False) -> Iterator[Daemon]:
    found = Daemon()
    try:
        found.start_loop(*options)
        found.start_gateway(lets_all=lets_all)
        yield found
    finally:
        found.close()
