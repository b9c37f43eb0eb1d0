"""Every request to the operating system is read back; a refused one is a warning, and the process goes on."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from typing import Any

import pytest

REPORT = (
    "from rigctl.config.settings import LoopSettings; from rigctl.control import realtime;"
    "loop = LoopSettings(rate_hz=1000, priority={priority}, cpu={cpu}, lock_memory=True);"
    "rows = [*realtime.apply(loop), realtime.freeze_garbage_collector()];"
    'import os; policies = ["policies", True, os.sched_getscheduler(0)];'
    "realtime.leave(); policies.append(os.sched_getscheduler(0));"
    "print([(row.name, row.ok, row.in_force, row.warning) for row in rows] + [policies])"
)


def report(priority: int, cpu: int, *, privileged: bool) -> dict[str, tuple[bool, Any, Any]]:
    code = REPORT.format(priority=priority, cpu=cpu)
    drop = "ulimit -l 64 -r 0; exec setpriv --bounding-set -all --inh-caps -all " if not privileged else "exec "
    out = subprocess.run(
        ["bash", "-c", f"{drop} {sys.executable} -c '{code}'"], capture_output=True, text=True, check=True
    ).stdout
    return {name: tuple(rest) for name, *rest in ast.literal_eval(out)}


@pytest.mark.skipif(os.getuid() != 0, reason="needs root, for real time and to give it up")
def test_with_rights_every_setting_is_in_force() -> None:
    cpu = min(os.sched_getaffinity(0))
    rows = report(70, cpu, privileged=True)
    _, in_loop, afterwards = rows.pop("policies")
    assert all(ok for ok, _, _ in rows.values()), rows
    assert rows["scheduler"][1] == "SCHED_FIFO 70"
    assert rows["affinity"][1] == f"cpu {cpu}"
    assert in_loop == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    assert afterwards == os.SCHED_OTHER
    assert set(rows) == {"timer slack", "memory", "affinity", "scheduler", "garbage collector"}


@pytest.mark.skipif(os.getuid() != 0, reason="needs root, for real time and to give it up")
def test_without_rights_each_refused_setting_says_what_would_help() -> None:
    rows = report(70, 1023, privileged=False)
    assert not any(rows[name][0] for name in ("scheduler", "memory", "affinity"))
    assert "RLIMIT_RTPRIO" in rows["scheduler"][2]
    assert "RLIMIT_MEMLOCK" in rows["memory"][2]
    assert "loop.cpu" in rows["affinity"][2]
    assert rows["scheduler"][1] == "SCHED_OTHER"
    assert rows["garbage collector"][0]


LOCKED = """
import mmap
from rigctl.config.settings import LoopSettings
from rigctl.control import realtime

MIB = 1 << 20
reserve, used, small = mmap.mmap(-1, 64 * MIB), mmap.mmap(-1, 64 * MIB), mmap.mmap(-1, 4 * MIB)
used[: 16 * MIB] = bytes(16 * MIB)

def resident_mib():
    return realtime._status_kib("VmRSS") >> 10

before = resident_mib()
realtime.apply(LoopSettings(rate_hz=1000, lock_memory=True))
locked = resident_mib()
reserve[: 32 * MIB] = bytes(32 * MIB)
taken = resident_mib()
later = mmap.mmap(-1, 16 * MIB)
print(locked - before, taken - locked, resident_mib() - taken, realtime._status_kib("VmLck") >> 10)
"""


@pytest.mark.skipif(os.getuid() != 0, reason="needs root, to lock memory")
def test_all_memory_is_locked_and_in_place_but_for_what_a_library_keeps_in_reserve() -> None:
    done = subprocess.run([sys.executable, "-c", LOCKED], capture_output=True, text=True, check=True)
    in_place, taken, later, locked = map(int, done.stdout.split())
    assert in_place >= 48 + 4  # the rest of what is in use, and what is small
    assert in_place < 48 + 4 + 64  # the reserve is not
    assert taken == pytest.approx(32, abs=1)
    assert later == pytest.approx(16, abs=1)
    assert locked >= 64 + 64 + 4 + 16


MEANWHILE = """
import mmap
from rigctl.config.settings import LoopSettings
from rigctl.control import realtime

in_use, mapped = realtime._in_use, []

def and_maps():
    found = in_use()
    mapped.append(mmap.mmap(-1, 8 << 20))
    return found

realtime._in_use = and_maps
realtime.apply(LoopSettings(rate_hz=1000, lock_memory=True))
locked = realtime._status_kib("VmLck")
mapped[0].close()
print(locked - realtime._status_kib("VmLck") >> 10)
"""


@pytest.mark.skipif(os.getuid() != 0, reason="needs root, to lock memory")
def test_memory_that_is_mapped_while_the_rest_is_being_locked_is_locked_too() -> None:
    done = subprocess.run([sys.executable, "-c", MEANWHILE], capture_output=True, text=True, check=True)
    assert int(done.stdout) == 8
