"""How a process joins the run that it belongs to, and when it has to end.

A child of the supervisor gets the folder of its run, and a signal to end. In the installed service gateway and
recorder are services of their own, which the supervisor can neither start nor signal, because they run as
other users. Such a process (``--service DIR``) waits until a daemon runs in the folder, and ends when that daemon calls
`Runtime.end` for it or is gone; the service manager starts it again, and it waits for the next run.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import select
import time
from collections.abc import Sequence

import msgspec

from rigctl.config.built_type import built
from rigctl.ipc.progress import Progress
from rigctl.ipc.runtime_folder import ACTIVE, PUBLIC_MODE, FolderError, Runtime, daemon_pid
from rigctl.ipc.service_manager import Watchdog
from rigctl.ipc.termination import Termination

SERVICE = "--service"
POLL_S = 0.1


class UsageError(ValueError):
    """The command line is another than ``[--service] RUNTIME_DIR``."""


class Joined:
    """The run that a process has joined."""

    def __init__(self, runtime: Runtime, name: str, supervisor: int | None) -> None:
        """``supervisor``: descriptor of its process for a service of its own, None for its child."""
        self.runtime = runtime
        self._name, self._supervisor, self._parent = name, supervisor, os.getppid()

    def is_gone(self) -> bool:
        """Whether the supervisor has ended."""
        return os.getppid() != self._parent if self._supervisor is None else has_ended(self._supervisor)

    def is_over(self) -> bool:
        """Whether a service of its own has to end."""
        return self._supervisor is not None and (self.runtime.is_to_end(self._name) or has_ended(self._supervisor))

    def show(self) -> Progress:
        """Show the supervisor that this process works; it counts its turns from now on.

        Raises:
            OSError: there is no room, or the folder is gone.
        """
        progress = Progress(self.runtime, self._name)
        shown = Presence(os.getpid(), str(self.runtime.known(ACTIVE).get("run_id", "")))
        self.runtime.write_json(presence_file(self._name), shown, PUBLIC_MODE)
        return progress


@built
class Presence(msgspec.Struct):
    """What a process shows the supervisor once it works."""

    pid: int
    run_id: str


def presence_file(name: str) -> str:
    """Name of the file that holds the `Presence` of a process."""
    return f"{name}.pid.json"


def presence(runtime: Runtime, name: str, run_id: str) -> int:
    """Process that works as ``name`` for a run; 0 while none has shown itself."""
    with contextlib.suppress(OSError, msgspec.MsgspecError):
        shown = msgspec.convert(runtime.read_json(presence_file(name)), Presence)
        return shown.pid if shown.run_id == run_id else 0
    return 0


def has_ended(process: int) -> bool:
    """Whether the process of a descriptor (pidfd_open(2)) has ended."""
    poll = select.poll()
    poll.register(process, select.POLLIN)
    return bool(poll.poll(0))


def joined(arguments: Sequence[str], name: str, stop: Termination) -> Joined | None:
    """The run to work in; for a service of its own this waits for one, and None means that ``stop`` came first.

    Raises:
        UsageError: the command line is wrong.
        FolderError: the folder cannot be entered.
    """
    match arguments:
        case [folder] if folder != SERVICE:
            return Joined(Runtime.entered(folder), name, None)
        case [word, folder] if word == SERVICE:
            return _next_run(pathlib.Path(folder), name, stop)
    raise UsageError(f"[{SERVICE}] RUNTIME_DIR")


def _next_run(folder: pathlib.Path, name: str, stop: Termination) -> Joined | None:
    watchdog = Watchdog()
    while not stop.requested:
        watchdog.feed()
        if (found := _running(folder, name)) is not None:
            stop.also = found.is_over
            return found
        time.sleep(POLL_S)
    return None


def _running(folder: pathlib.Path, name: str) -> Joined | None:
    """The run in a folder, once its rings and its active configuration are there."""
    if not (pid := daemon_pid(folder)):
        return None
    runtime, supervisor = None, -1
    with contextlib.suppress(OSError, FolderError, msgspec.MsgspecError):
        supervisor = os.pidfd_open(pid)
        runtime = Runtime.entered(folder)
        if runtime.read_json(ACTIVE).get("pid") == pid == daemon_pid(folder) and not runtime.is_to_end(name):
            return Joined(runtime, name, supervisor)
    if runtime is not None:
        runtime.leave()
    if supervisor >= 0:
        os.close(supervisor)
    return None
