"""Real-time settings of the operating system, each read back.

Each setting is optional: a refused one leaves a warning with the setting wanted, the one in force and the remedy, and
the process runs on without it.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
from collections.abc import Callable
from dataclasses import dataclass

from rigctl.config.settings import LoopSettings

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK, _PR_SET_PDEATHSIG = 29, 30, 1
_libc = ctypes.CDLL(None, use_errno=True)
_RESERVE_KIB, _UNUSED = 1 << 14, 8
"""A mapping of this size or more, of which less than an eighth is in use, is a reserve: OpenBLAS has two buffers of
32 MiB, and kernels for other processors."""


@dataclass(frozen=True)
class Applied:
    """One setting: the wanted value, the value in force, and a warning if they differ."""

    name: str
    asked: str
    in_force: str
    ok: bool
    warning: str = ""


def apply(loop: LoopSettings) -> list[Applied]:
    """Apply the rig file's settings to this process; each is read back."""
    steps: list[Callable[[], Applied]] = [_timer_slack]
    if loop.lock_memory:
        steps.append(_lock_memory)
    if loop.cpu is not None:
        steps.append(lambda: _affinity(loop.cpu or 0))
    if loop.priority:
        steps.append(lambda: _scheduler(loop.priority))
    return [step() for step in steps]


def leave() -> None:
    """Return to ordinary scheduling: the rest has no deadline and must not delay another loop."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def freeze_garbage_collector() -> Applied:
    """Collect once, freeze the remaining objects and switch the collector off, so that no tick pays for it."""
    gc.collect()
    gc.freeze()
    gc.disable()
    frozen = gc.get_freeze_count()
    return Applied("garbage collector", "frozen", f"frozen ({frozen} objects)", not gc.isenabled() and frozen > 0)


def die_with_parent(signal_number: int) -> None:
    """Have the kernel send this process ``signal_number`` when its parent ends for any reason."""
    parent = os.getppid()
    _libc.prctl(_PR_SET_PDEATHSIG, signal_number, 0, 0, 0)
    if os.getppid() != parent:  # the parent ended before this call
        raise SystemExit(0)


def _scheduler(priority: int) -> Applied:
    wanted = f"SCHED_FIFO {priority}, reset on fork"
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    policy, level = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    ok = policy == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK and level == priority
    return Applied(
        "scheduler",
        wanted,
        f"SCHED_FIFO {level}" if policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO else "SCHED_OTHER",
        ok,
        "" if ok else f"{wanted} not allowed: run as root, or raise RLIMIT_RTPRIO to {priority} (limits.conf: rtprio)",
    )


def _affinity(cpu: int) -> Applied:
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, {cpu})
    have = os.sched_getaffinity(0)
    ok = have == {cpu}
    return Applied(
        "affinity",
        f"cpu {cpu}",
        "cpu " + ",".join(map(str, sorted(have))),
        ok,
        "" if ok else f"cpu {cpu} is not available to this process; set loop.cpu to one that is",
    )


def _lock_memory() -> Applied:
    """Lock all memory, with every page in place but those of reserves, which are locked as they are taken into use."""
    failed = _libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0  # also what is mapped until the next one
    for begin, size in [] if failed else _in_use():
        _libc.mlock(ctypes.c_void_p(begin), ctypes.c_size_t(size))
    failed = failed or _libc.mlockall(_MCL_FUTURE) != 0
    locked = _status_kib("VmLck")
    ok = not failed and locked > 0
    return Applied(
        "memory",
        "locked",
        f"{locked // 1024} MiB locked",
        ok,
        "" if ok else "mlockall not allowed: run as root, or raise RLIMIT_MEMLOCK (limits.conf: memlock unlimited)",
    )


def _in_use() -> list[tuple[int, int]]:
    """Begin and size in bytes of the mappings of this process but for reserves."""
    found: list[tuple[int, int]] = []
    with open("/proc/self/smaps", encoding="utf-8") as file:  # noqa: PTH123 - procfs
        for line in file:
            first, _, rest = line.partition(" ")
            if first == "Rss:":
                begin, size = found[-1]
                if size >> 10 >= _RESERVE_KIB and int(rest.split()[0]) < (size >> 10) // _UNUSED:
                    found.pop()
            elif not first.endswith(":"):
                begin, end = (int(part, 16) for part in first.split("-"))
                found.append((begin, end - begin))
    return found


def _timer_slack() -> Applied:
    _libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    slack = _libc.prctl(_PR_GET_TIMERSLACK, 0, 0, 0, 0)
    return Applied("timer slack", "1 ns", f"{slack} ns", slack == 1, "" if slack == 1 else "timer slack not set")


def _status_kib(name: str) -> int:
    with open("/proc/self/status", encoding="ascii") as file:  # noqa: PTH123 - procfs
        for line in file:
            if line.startswith(name + ":"):
                return int(line.split()[1])
    return 0
