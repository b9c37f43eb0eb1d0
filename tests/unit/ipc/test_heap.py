"""What a process freed goes back to the system, also after a large block has raised glibc's own limit for that."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import pathlib, re, sys
from rigctl.ipc import heap

def private_kib():
    return int(re.search(r"RssAnon:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text())[1])

if "limit" in sys.argv:
    heap.limit()
large = bytes(24 << 20)
del large
waiting = [bytearray(1 << 18) for _ in range(60)]
later = [bytearray(1 << 10) for _ in range(100)]
before = private_kib()
del waiting
print((before - private_kib()) // 1024)
"""


def given_back_mib(*words: str) -> int:
    answer = subprocess.run([sys.executable, "-c", SCRIPT, *words], capture_output=True, text=True, check=True)
    return int(answer.stdout)


def test_what_waited_in_memory_is_given_back() -> None:
    assert given_back_mib("limit") >= 14  # of 15


def test_without_the_limit_it_is_kept() -> None:
    """The reason for the limit: without this the module can go."""
    assert given_back_mib() <= 2
