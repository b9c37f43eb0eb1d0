"""Shared memory that others have filled while the daemon runs: its processes come back without room of it."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
import signal
import sys
from collections.abc import Iterator

import pytest

from rigctl.ipc.runtime_folder import Runtime
from tests.builders import daemons
from tests.builders.small_memory import with_small_memory
from tests.builders.waiting import until

MODULES = ("rigctl.control", "rigctl.gateway.gateway_process", "rigctl.recorder")


def fill(memory: pathlib.Path) -> None:
    """Take all room of a memory disk, to the last page and the last file."""
    with (memory / "of_another").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
    with pytest.raises(OSError) as refused:
        for number in range(1_000_000):
            (memory / f"of_another_{number}").touch()
    assert refused.value.errno == errno.ENOSPC


@pytest.fixture
def running(tmp_path: pathlib.Path) -> Iterator[tuple[pathlib.Path, pathlib.Path, int]]:
    """A daemon on a small memory disk: its rig file, its log and its process."""
    file, log = daemons.slow_rig_file(tmp_path), tmp_path / "daemon.log"
    words = with_small_memory("32m,nr_inodes=1000", sys.executable, "-m", "rigctl", "run", str(file))
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.command(words, log) as daemon:
        until(lambda: daemon.poll() is not None or b": DISARMED," in log.read_bytes(), log=log)
        assert daemon.poll() is None, log.read_text()
        yield file, log, daemon.pid


def test_every_process_comes_back(running: tuple[pathlib.Path, pathlib.Path, int]) -> None:
    file, log, pid = running
    memory, rig = pathlib.Path(f"/proc/{pid}/root/dev/shm"), daemons.name_of(file)
    records = Runtime(memory / f"rigctl-{rig}").records.reader()
    fill(memory)
    ended = [daemons.process_with(module, rig) for module in MODULES]
    for one in ended:
        os.kill(one, signal.SIGKILL)
    last = until(lambda: records.head)
    until(lambda: log.read_text().count("loop started, DISARMED") == 2, log=log)
    until(lambda: records.head > last, log=log)
    audit = file.parent / "audit" / f"{rig}.jsonl"
    until(lambda: audit.read_text().count('"what":"recorder_started"') == 2, log=log)
    until(lambda: daemons.mode(file) == "DISARMED" if daemons.state(file) else False, log=log)
    assert "could not start" not in log.read_text()
    assert log.read_text().count("ended with code") == 0, log.read_text()
