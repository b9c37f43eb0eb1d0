"""Processes that an earlier run of this rig has left: they get a signal when their supervisor is killed, and may hang.

A gateway would keep the endpoint, a recorder would write to the audit log beside the new one, a loop would command the
drive. Only a process of this user with the command line that the supervisor gives, of this run-time folder, is one.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import signal
import time
from collections.abc import Mapping
from typing import NamedTuple

from rigctl.ipc.joining import has_ended
from rigctl.ipc.progress import main_thread
from rigctl.ipc.ring import RingError
from rigctl.ipc.runtime_folder import Runtime

ENDS_S = 5.0
"""Time in s that each has to end by the signal that it has got."""
_KILLED_S = 2.0
_POLL_S = 0.02
_STOPPED = "T"  # proc(5)


class StillRunsError(RuntimeError):
    """One cannot be ended, or must not; ``str()`` is one line."""


class _Left(NamedTuple):
    name: str
    pid: int
    process: int
    """Descriptor, by which no other process of the same number is meant later."""


def end_left(runtime: Runtime, modules: Mapping[str, str]) -> list[str]:
    """Wait for those to end that an earlier run has left, and kill who hangs; returns a line of each that was killed.

    ``modules``: of the processes, by name.

    Raises:
        StillRunsError: the loop works, as one that lowers a load; or one does not end when it is killed.
    """
    left = _find(runtime.directory, modules)
    try:
        heads = {_head(runtime)}
        until = time.monotonic() + ENDS_S
        while (waits := [one for one in left if not (has_ended(one.process) or _is_stopped(one))]) and (
            time.monotonic() < until
        ):
            heads.add(_head(runtime))
            time.sleep(_POLL_S)
        if len(heads) > 1 and (loop := next((one for one in waits if one.name == "control"), None)) is not None:
            raise StillRunsError(
                f"the loop of an earlier run (process {loop.pid}) still works, as it does while it lowers a load that "
                "the brake does not hold; the rig is left to it: start again once it has ended, after 2 min at most"
            )
        return [_killed(one) for one in left if not has_ended(one.process)]
    finally:
        for one in left:
            os.close(one.process)


def _find(directory: pathlib.Path, modules: Mapping[str, str]) -> list[_Left]:
    names, found = {module: name for name, module in modules.items()}, []
    for entry in pathlib.Path("/proc").iterdir():
        with contextlib.suppress(OSError):  # it has ended
            if not entry.name.isdecimal() or entry.stat().st_uid != os.geteuid():
                continue
            process = os.pidfd_open(int(entry.name))
            match (entry / "cmdline").read_bytes().decode(errors="replace").split("\0"):
                case [_, "-m", module, folder, *_] if module in names and folder == str(directory):
                    found.append(_Left(names[module], int(entry.name), process))
                case _:
                    os.close(process)
    return found


def _head(runtime: Runtime) -> int:
    """Records that the loop has written."""
    with contextlib.suppress(OSError, RingError):
        return runtime.records.reader().head
    return 0


def _is_stopped(one: _Left) -> bool:
    thread = main_thread(one.pid)
    return thread is not None and thread.state == _STOPPED


def _killed(one: _Left) -> str:
    with contextlib.suppress(ProcessLookupError):
        signal.pidfd_send_signal(one.process, signal.SIGKILL)
    until = time.monotonic() + _KILLED_S
    while not has_ended(one.process):
        if time.monotonic() > until:
            raise StillRunsError(
                f"the {one.name} of an earlier run (process {one.pid}) does not end when it is killed: it waits for a "
                "disk or a device; start again once it has ended, or restart the computer"
            )
        time.sleep(_POLL_S)
    return f"the {one.name} of an earlier run (process {one.pid}) hung, and was killed"
