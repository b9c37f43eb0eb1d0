"""Another network namespace, joined to this one by a cable."""

from __future__ import annotations

import contextlib
import os
import pathlib
import subprocess
from collections.abc import Iterator

import pytest

from tests.builders.waiting import until

HERE, THERE = "10.213.7.1", "10.213.7.2"


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, text=True)


@contextlib.contextmanager
def cabled() -> Iterator[tuple[str, ...]]:
    """Words before a command that has it run in another network namespace, where this computer is ``HERE``."""
    other = subprocess.Popen(["unshare", "-n", "sleep", "600"])
    own, cable = pathlib.Path("/proc/self/ns/net").readlink(), f"rv{os.getpid()}"
    try:
        until(lambda: pathlib.Path(f"/proc/{other.pid}/ns/net").readlink() != own, "the namespace")
        within = ("nsenter", "-t", str(other.pid), "-n")
        try:
            _run("ip", "link", "add", cable, "type", "veth", "peer", "name", "rv", "netns", str(other.pid))
        except (OSError, subprocess.CalledProcessError):
            pytest.skip("this computer allows no cable between network namespaces")
        _run("ip", "addr", "add", f"{HERE}/30", "dev", cable)
        _run("ip", "link", "set", cable, "up")
        _run(*within, "ip", "addr", "add", f"{THERE}/30", "dev", "rv")
        _run(*within, "ip", "link", "set", "rv", "up")
        yield within
    finally:
        other.kill()
        other.wait()
        subprocess.run(["ip", "link", "del", cable], check=False, capture_output=True)
