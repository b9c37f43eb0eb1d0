"""The folder in shared memory of a run: removed with its process, and by the next run where that was killed."""

from __future__ import annotations

import mmap
import os
import pathlib
import signal
import subprocess
import sys
from collections.abc import Callable

import pytest

from hil.branching import BranchPoint
from rigctl.ipc.memory_folder import memory_folder
from tests.builders.paths import ROOT
from tests.builders.waiting import until

PREFIX = "rigctl-lockstep-"
HOLDER = f"""
import os, pathlib, sys, time
from rigctl.ipc.memory_folder import memory_folder
with memory_folder("{PREFIX}", pathlib.Path(sys.argv[1])) as folder:
    (folder / "records").write_bytes(bytes(4096))
    print(folder, flush=True)
    {{then}}
    time.sleep(600)
"""
FORKS = """child = os.fork()
    if child:  # one writer: two at once may mix their lines
        print(child, flush=True)"""


def held(base: pathlib.Path, then: str = "pass") -> tuple[subprocess.Popen[str], pathlib.Path]:
    """A process that holds a folder below ``base``."""
    command = [sys.executable, "-c", HOLDER.format(then=then), str(base)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, pathlib.Path(process.stdout.readline().strip())


def kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()


def next_run(base: pathlib.Path) -> None:
    with memory_folder(PREFIX, base):
        pass


def test_the_folder_of_a_killed_process_is_removed_by_the_next_run(tmp_path: pathlib.Path) -> None:
    process, folder = held(tmp_path)
    next_run(tmp_path)
    assert (folder / "records").exists()  # its process lives
    kill(process)
    assert (folder / "records").exists()
    next_run(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_process_that_was_forked_keeps_the_folder_of_a_killed_one(tmp_path: pathlib.Path) -> None:
    process, folder = held(tmp_path, FORKS)
    assert process.stdout is not None
    child = int(process.stdout.readline())
    kill(process)
    next_run(tmp_path)
    assert (folder / "records").exists()
    os.kill(child, signal.SIGKILL)

    def swept() -> bool:
        next_run(tmp_path)
        return not list(tmp_path.iterdir())

    until(swept, "the folder to be removed")


def of_another_user(base: pathlib.Path) -> pathlib.Path:
    process, folder = held(base)
    kill(process)
    os.chown(folder, 4321, 4321)
    return folder


def just_being_made(base: pathlib.Path) -> pathlib.Path:
    folder = base / f"{PREFIX}new"
    folder.mkdir()
    return folder


def a_link(base: pathlib.Path) -> pathlib.Path:
    process, folder = held(base)
    kill(process)
    (base / f"{PREFIX}link").symlink_to(folder.rename(base / "kept"))
    return base / "kept/records"


def of_another_kind(base: pathlib.Path) -> pathlib.Path:
    process, folder = held(base)
    kill(process)
    return folder.rename(base / "rigctl-paper_rig")


@pytest.mark.parametrize("left", [of_another_user, just_being_made, a_link, of_another_kind])
def test_what_is_not_a_folder_of_this_user_and_kind_stays(
    tmp_path: pathlib.Path, left: Callable[[pathlib.Path], pathlib.Path]
) -> None:
    if left is of_another_user and os.geteuid():
        pytest.skip("needs root, for a folder of another user")
    kept = left(tmp_path)
    next_run(tmp_path)
    assert kept.exists()


def test_the_memory_is_free_at_the_end_also_while_a_reader_maps_it() -> None:
    with memory_folder(PREFIX) as folder:
        (folder / "records").write_bytes(b"1" * 100_000)
        with (folder / "records").open("r+b") as file:
            memory = mmap.mmap(file.fileno(), 0)
            descriptor = os.dup(file.fileno())
    assert os.fstat(descriptor).st_blocks == 0
    assert memory[:1] == b"\0"
    memory.close()
    os.close(descriptor)


def test_a_branch_neither_sweeps_nor_removes_the_folder_of_the_run(tmp_path: pathlib.Path) -> None:
    def leaves_it() -> bool:
        next_run(tmp_path)
        run.__exit__(None, None, None)
        return ring.exists()

    run = memory_folder(PREFIX, tmp_path)
    with run as folder:
        ring = folder / "records"
        ring.write_bytes(b"as it was")
        assert BranchPoint(folder).branch(leaves_it)
        next_run(tmp_path)
        assert ring.read_bytes() == b"as it was"
    assert list(tmp_path.iterdir()) == []
