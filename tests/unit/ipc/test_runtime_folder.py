"""The run-time folder: its owner, its content, and that it cannot be moved."""

from __future__ import annotations

import os
import pathlib
import stat
import subprocess
import sys
from collections.abc import Callable

import pytest

from rigctl.config import rig_file as config
from rigctl.ipc.runtime_folder import AlreadyRunningError, FolderError, Runtime, daemons, is_free, recorded
from tests.builders.paths import ROOT
from tests.builders.small_memory import with_small_memory
from tests.builders.waiting import patience_s

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")


@pytest.fixture
def runtime(tmp_path: pathlib.Path) -> Runtime:
    """A claimed run-time folder with its rings."""
    found = Runtime(tmp_path / "rigctl-rig")
    found.claim()
    found.make_rings(SETTINGS)
    return found


def test_others_enter_the_folder_and_read_nothing_in_it_but_whose_it_is(runtime: Runtime) -> None:
    os.umask(before := os.umask(0))
    assert before is not None
    runtime.write_json("active.json", {"pid": 1})
    assert stat.S_IMODE(runtime.directory.stat().st_mode) == 0o711
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in runtime.directory.iterdir()}
    assert modes.pop("lock") == 0o644
    assert set(modes.values()) == {0o600}, modes
    assert runtime.records.path.stat().st_blocks * 512 >= runtime.records.path.stat().st_size  # its memory is allocated


def _link(folder: pathlib.Path) -> None:
    (folder.parent / "elsewhere").mkdir(mode=0o700)
    folder.symlink_to(folder.parent / "elsewhere")


def _open_to_all(folder: pathlib.Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)


@pytest.mark.parametrize(
    ("prepare", "said"),
    [(_link, "found a link"), (_open_to_all, "found mode 0777"), (pathlib.Path.touch, "found no folder")],
)
def test_a_folder_that_others_could_have_prepared_is_not_used(
    tmp_path: pathlib.Path, prepare: Callable[[pathlib.Path], None], said: str
) -> None:
    folder = tmp_path / "rigctl-rig"
    prepare(folder)
    with pytest.raises(FolderError, match=said) as refused:
        Runtime(folder).claim()
    assert "\n" not in str(refused.value)
    assert not folder.is_dir() or not list(folder.iterdir())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_a_folder_of_another_user_is_not_used(tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "rigctl-rig"
    folder.mkdir(mode=0o700)
    os.chown(folder, 4321, 4321)
    with pytest.raises(FolderError, match="found a folder of user 4321"):
        Runtime(folder).claim()
    assert not is_free("rig", tmp_path)


def test_no_memory_backed_disk_is_one_line(tmp_path: pathlib.Path) -> None:
    with pytest.raises(FolderError, match="cannot be made: No such file or directory"):
        Runtime(tmp_path / "none" / "rigctl-rig").claim()


def test_links_and_pipes_in_it_are_taken_away_and_what_they_led_to_is_not_touched(tmp_path: pathlib.Path) -> None:
    folder, victim = tmp_path / "rigctl-rig", tmp_path / "victim"
    folder.mkdir(mode=0o700)
    victim.write_text("kept")
    for name in ("lock", "active.json", "records"):
        (folder / name).symlink_to(victim)
    os.mkfifo(folder / "lease.json")
    os.link(victim, folder / "recorder.json")
    (folder / "control.json").mkdir()
    (folder / "control.json" / "full").touch()
    runtime = Runtime(folder)
    runtime.claim()
    assert len(runtime.cleared) == 6
    runtime.make_rings(SETTINGS)
    runtime.write_json("active.json", {})
    assert victim.read_text() == "kept"
    assert runtime.lost() == ""
    runtime.remove()
    assert not folder.exists()


def test_a_link_that_is_put_in_later_is_not_followed(runtime: Runtime, tmp_path: pathlib.Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("kept")
    (runtime.directory / "lease.json").symlink_to(victim)
    with pytest.raises(OSError, match="symbolic links"):
        runtime.read_json("lease.json")
    runtime.write_json("lease.json", {"holder": "anna"})
    assert victim.read_text() == "kept"
    assert runtime.read_json("lease.json") == {"holder": "anna"}


def _replaced(runtime: Runtime) -> None:
    runtime.directory.rename(runtime.directory.with_name("away"))
    runtime.directory.mkdir(mode=0o700)


def _damaged(runtime: Runtime) -> None:
    with runtime.records.path.open("r+b") as file:
        file.write(b"X")


@pytest.mark.parametrize(
    ("lose", "said"),
    [
        (lambda runtime: runtime.directory.rename(runtime.directory.with_name("away")), "it has been deleted"),
        (_replaced, "it has been replaced by another"),
        (lambda runtime: runtime.commands.path.unlink(), "commands in it has been deleted"),
        (_damaged, "records in it has been replaced or damaged"),
        (lambda runtime: runtime.directory.chmod(0o755), "mode 0755"),
    ],
)
def test_a_folder_that_is_lost_is_noticed(runtime: Runtime, lose: Callable[[Runtime], None], said: str) -> None:
    assert runtime.lost() == ""
    lose(runtime)
    assert said in runtime.lost()


def test_the_folder_of_the_daemon_that_came_after_is_left_alone(runtime: Runtime) -> None:
    _replaced(runtime)
    after = Runtime(runtime.directory)
    after.claim()
    runtime.remove()
    assert after.lost() == ""
    assert (after.directory / "lock").exists()


def test_who_looks_for_daemons_waits_for_nothing_that_stands_in_a_lock_s_place(tmp_path: pathlib.Path) -> None:
    for name, make in (
        ("pipe", os.mkfifo),
        ("folder", pathlib.Path.mkdir),
        ("huge", lambda lock: lock.write_text("9" * 19)),
        ("negative", lambda lock: lock.write_text("-1")),
        ("nobody", lambda lock: lock.write_text("0")),
        ("long", lambda lock: lock.write_text("1" * 5000)),
        ("binary", lambda lock: lock.write_bytes(b"\xff\0")),
    ):
        (tmp_path / f"rigctl-{name}").mkdir()
        make(tmp_path / f"rigctl-{name}" / "lock")
    assert daemons(tmp_path) == []
    assert isinstance(recorded(), list)


def test_a_second_daemon_is_refused_and_takes_nothing_away(runtime: Runtime) -> None:
    runtime.gateway_cursor.symlink_to("nowhere")
    with pytest.raises(AlreadyRunningError, match=f"process {os.getpid()}"):
        Runtime(runtime.directory).claim()
    assert runtime.gateway_cursor.is_symlink()


FULL = """
import contextlib, errno, pathlib
from rigctl.ipc.progress import Progress, progress_of
from rigctl.ipc.runtime_folder import Runtime

runtime = Runtime(pathlib.Path("/dev/shm/rigctl-rig"))
runtime.claim()
runtime.write_json("some.json", {"text": "a" * 100})
Progress(runtime, "some").step()
with open("/dev/shm/of_another", "wb", buffering=0) as file, contextlib.suppress(OSError):
    while True:
        file.write(bytes(4096))
for value in ({"text": "b"}, {"text": "c" * 200}):
    runtime.write_json("some.json", value)
    assert runtime.read_json("some.json") == value
for name, value in (("some.json", {"text": "d" * 5000}), ("other.json", {})):
    try:
        runtime.write_json(name, value)
    except OSError as error:
        assert error.errno == errno.ENOSPC
    else:
        raise AssertionError(name)
assert runtime.read_json("some.json") == {"text": "c" * 200}
assert sorted(one.name for one in runtime.directory.iterdir()) == ["lock", "some.json", "some.progress"]
progress = Progress(runtime, "some")
assert progress_of(runtime, "some") == 0
progress.step()
assert progress_of(runtime, "some") == 1
"""


def test_a_file_is_written_over_in_memory_that_others_have_filled() -> None:
    command = with_small_memory("256k", sys.executable, "-c", FULL)
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=patience_s(), check=False)
    assert (done.returncode, done.stderr) == (0, "")
