"""``rigctl uninstall`` while the motor of the rig's daemon carries a load."""

from __future__ import annotations

import math
import os
import pathlib
import subprocess
import time
from collections.abc import Callable, Iterator

import pytest

from rigctl.cli.install_target import Target
from rigctl.config import layout, rig_file
from rigctl.ipc import writers
from rigctl.ipc.record import RECORD
from rigctl.ipc.ring import RingWriter
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.states import Flag
from tests.builders.paths import ROOT

Command = Callable[..., "subprocess.CompletedProcess[str]"]
SETTINGS = rig_file.load(ROOT / "config/paper_rig.yaml")
REFUSED = (
    "rigctl: paper_rig: the motor carries a load of 300 N that the brake may not hold: rigctl lower first, or add "
    "--leave-load: the end of the daemon lowers the load, and leaves what it cannot lower\n"
)


@pytest.fixture
def root(in_process: Command, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    """A root with the installed rig, taken for this computer's."""
    assert in_process("rigctl", "install", ROOT / "config/paper_rig.yaml", "--root", tmp_path).returncode == 0
    monkeypatch.setattr(Target, "is_live", True)
    return tmp_path


@pytest.fixture
def records(monkeypatch: pytest.MonkeyPatch) -> Iterator[RingWriter]:
    """The ring of a daemon in the service's folder; the daemon's process is this one."""
    base = layout.SHARED_MEMORY / f"rigctl-test-uninstall-{os.getpid()}"
    base.mkdir(mode=0o755)
    monkeypatch.setattr(layout, "RUN", base)
    monkeypatch.setattr(writers, "group_id", lambda _name: -1)
    runtime = Runtime.of("paper_rig", base)
    lock = runtime.claim()
    runtime.make_rings(SETTINGS)
    yield runtime.records.writer()
    runtime.remove()
    os.close(lock)
    base.rmdir()


def write(ring: RingWriter, flags: int, ago_s: float = 0.0) -> None:
    zeros = dict.fromkeys((field.name for field in RECORD.fields if field.code != "d"), 0)
    now_ns = time.monotonic_ns() - round(ago_s * 1e9)
    ring.write(*RECORD.values(**zeros | {"t_ns": now_ns, "flags": flags, "tension_n": 300.0, "end_s": math.nan}))


def uninstall(in_process: Command, root: pathlib.Path, *more: str) -> subprocess.CompletedProcess[str]:
    return in_process("rigctl", "uninstall", "paper_rig", "--root", root, "--dry-run", *more)


def test_it_is_refused_while_the_motor_carries_and_done_with_the_option(
    in_process: Command, root: pathlib.Path, records: RingWriter
) -> None:
    write(records, Flag.CARRIES | Flag.BRAKE_FAILS | Flag.DRIVE_ENABLED)
    refused = uninstall(in_process, root)
    assert (refused.returncode, refused.stdout, refused.stderr) == (1, "", REFUSED)
    done = uninstall(in_process, root, "--leave-load")
    assert done.returncode == 0
    assert "would run systemctl disable --quiet --now rigctl@paper_rig.service" in done.stdout


@pytest.mark.parametrize(("flags", "ago_s"), [(Flag.DRIVE_ENABLED, 0.0), (Flag.BRAKE_FAILS, 0.0), (Flag.CARRIES, 30.0)])
def test_a_motor_that_carries_nothing_bars_nothing(
    in_process: Command, root: pathlib.Path, records: RingWriter, flags: int, ago_s: float
) -> None:
    """Neither does a loop that has written no record for long: it commands nothing any more."""
    assert uninstall(in_process, root).returncode == 0, "no record yet"
    write(records, flags, ago_s)
    assert uninstall(in_process, root).returncode == 0


def test_without_a_daemon_nothing_bars_it(
    in_process: Command, root: pathlib.Path, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layout, "RUN", tmp_path / "none")
    assert uninstall(in_process, root).returncode == 0


def test_a_daemon_whose_records_cannot_be_read_bars_it(
    in_process: Command, root: pathlib.Path, records: RingWriter
) -> None:
    """As those of another version, which goes on after an upgrade."""
    write(records, 0)
    Runtime.of("paper_rig", layout.RUN).records.path.write_bytes(b"rigring1" + bytes(100))
    refused = uninstall(in_process, root)
    assert refused.returncode == 1
    assert "cannot be read whether the motor carries a load (records: made by another version)" in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert uninstall(in_process, root, "--leave-load").returncode == 0
