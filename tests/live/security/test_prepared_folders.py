"""A local user prepares a daemon's files beforehand: root's daemon writes through none of his links, and says so."""

from __future__ import annotations

import os
import pathlib
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator

import pytest

from rigctl.config import layout
from rigctl.config import rig_file as config
from rigctl.control.modes import command_slot
from rigctl.gateway.lease_service import IN_FORCE
from rigctl.ipc import output_file, runtime_folder, writers
from rigctl.ipc.folder_places import PUBLIC
from rigctl.ipc.runtime_folder import BASE, PUBLIC_MODE, FolderError, Runtime
from rigctl.ipc.trusted_folders import entered_folders
from rigctl.model.verbs import Verb
from rigctl.recorder.audit_log import AuditLog
from tests.builders.daemons import name_of, rig_file
from tests.builders.intruder import NOBODY
from tests.builders.miniature import Daemon
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

SETTINGS = config.load(ROOT / "config/paper_rig.yaml")
VICTIMS = ("records", "commands", "active.json", "lock", "calibration.json", "lease.json", "gateway.cursor")
OPERATORS_GROUP, VIEWERS_GROUP = 4322, 4323
PROCESSES = ("rigctl.recorder", "rigctl.control", "rigctl.gateway.gateway_process")


def as_nobody(*command: str) -> subprocess.CompletedProcess[str]:
    become = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
    return subprocess.run([*become, *command], capture_output=True, text=True, timeout=patience_s(), check=False)


@pytest.fixture
def file(tmp_path: pathlib.Path) -> Iterator[pathlib.Path]:
    """A rig file, whose folder in shared memory is deleted afterwards."""
    found = rig_file(tmp_path)
    yield found
    subprocess.run(["rm", "-rf", str(BASE / f"rigctl-{name_of(found)}")], check=True)


@pytest.mark.parametrize("mode", ["0777", "0700"])
def test_a_prepared_folder_is_refused_and_no_file_behind_its_links_is_touched(
    file: pathlib.Path, tmp_path: pathlib.Path, mode: str
) -> None:
    folder = BASE / f"rigctl-{name_of(file)}"
    victims = [tmp_path / f"root_{name}" for name in VICTIMS]
    for victim in victims:
        victim.write_text("root's")
    links = " && ".join(f"ln -s {victim} {folder}/{name}" for victim, name in zip(victims, VICTIMS, strict=True))
    made = as_nobody("sh", "-c", f"mkdir {folder} && {links} && chmod {mode} {folder}")
    assert made.returncode == 0, made.stderr
    done = subprocess.run(
        [sys.executable, "-m", "rigctl", "run", str(file)], cwd=ROOT, capture_output=True, text=True,
        timeout=patience_s(), check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert f"{folder}: found a folder of user {NOBODY}, expected a folder of user 0 with mode 0711" in done.stderr
    assert [victim.read_text() for victim in victims] == ["root's"] * len(victims)
    assert sorted(path.name for path in folder.iterdir()) == sorted(VICTIMS)


@pytest.mark.parametrize("module", PROCESSES)
def test_no_process_of_the_daemon_works_in_another_users_folder(tmp_path: pathlib.Path, module: str) -> None:
    """The folder is exchanged for his own between the supervisor's check and the start of a process."""
    his = tmp_path / "rigctl-his"
    runtime = Runtime(his)
    his.mkdir(mode=0o700)
    runtime.make_rings(SETTINGS)
    runtime.write_json("active.json", {"settings": SETTINGS.model_dump(mode="json")})
    given = runtime.commands.writer()
    given.write(*command_slot(1, 1, Verb.TENSION))
    for path in (his, *his.iterdir()):
        os.chown(path, NOBODY, NOBODY)
    for folder, said in ((his, f"found user {NOBODY} and mode 0700"), (tmp_path / "link", "cannot be entered")):
        if folder != his:
            folder.symlink_to(his)
        done = subprocess.run(
            [sys.executable, "-m", module, str(folder)], cwd=ROOT, capture_output=True, text=True,
            stdin=subprocess.DEVNULL, timeout=patience_s(), check=False,
        )  # fmt: skip
        assert done.returncode != 0
        assert said in done.stderr
        assert done.stderr.count("\n") == 1


def test_a_folder_that_is_exchanged_while_the_daemon_runs_is_not_used(own: Daemon) -> None:
    """The gateway goes on in the folder it has entered; a command ring put in its place reaches nobody."""
    with own.client() as client:
        assert client.command("arm", "anna")["accepted"]
        place, away = own.runtime.directory, own.runtime.directory.with_name(own.runtime.directory.name + "-away")
        place.rename(away)
        try:
            place.mkdir(mode=0o700)
            false = Runtime(place)
            false.make_rings(SETTINGS)
            client.command("target", "anna", 290.0)
            assert false.commands.reader().head == 0
            assert client.take_lease("anna")["accepted"]
            assert not (place / "lease.json").exists()
        finally:
            subprocess.run(["rm", "-rf", str(place)], check=True)
            away.rename(place)
        until(lambda: client.state()["loop_alive"], "the rig")


def test_another_users_folder_is_no_root_of_trust(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path)
    monkeypatch.setattr(layout, "SHARED_MEMORY", tmp_path)
    mine, his, open_to_all = (tmp_path / f"rigctl-{name}" for name in ("mine", "his", "open"))
    for folder in (mine, his, open_to_all):
        folder.mkdir(mode=0o700)
    os.chown(his, NOBODY, NOBODY)
    open_to_all.chmod(0o777)
    (tmp_path / "rigctl-link").symlink_to(mine)
    assert list(entered_folders()) == [(mine, 0)]
    assert list(entered_folders(of_others=True)) == [(his, NOBODY)]


def test_a_link_in_place_of_an_output_file_or_log_is_not_followed(tmp_path: pathlib.Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("root's")
    folder = tmp_path / "open"
    folder.mkdir()
    folder.chmod(0o777)
    part = folder / f".report.html.{os.getpid()}.part"
    assert as_nobody("ln", "-s", str(victim), str(part)).returncode == 0
    output_file.replace(folder / "report.html", "text")
    assert (folder / "report.html").read_text() == "text"
    log = folder / "audit.jsonl"
    assert as_nobody("ln", "-s", str(victim), str(log)).returncode == 0
    with pytest.raises(OSError, match="symbolic links"):
        AuditLog(log, "rig").open()
    assert victim.read_text() == "root's"


@pytest.fixture
def service(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> Runtime:
    """The folder of an installed service, as its own user has it."""
    base = tmp_path / "run"
    base.mkdir(mode=0o755)
    monkeypatch.setattr(layout, "RUN", base)
    monkeypatch.setattr(writers, "group_id", lambda _name: -1)  # the service may be installed on this computer
    runtime = Runtime.of("paper_rig", base)
    runtime.claim()
    runtime.make_rings(SETTINGS)
    return runtime


def test_the_services_folder_lets_its_group_read_and_everyone_find_the_rig(
    service: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    service.write_json("active.json", {"pid": 1})
    service.write_json(PUBLIC, {"rig": "paper_rig"}, PUBLIC_MODE)
    service.write_json(IN_FORCE, {"id": "secret"}, 0o600)
    monkeypatch.chdir(service.gateway_socket.parent)  # its path may be too long for a socket
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(service.gateway_socket.name)
    groups = {writers.OPERATORS: OPERATORS_GROUP, writers.VIEWERS: VIEWERS_GROUP}
    monkeypatch.setattr(writers, "group_number", groups.__getitem__)
    service.let_members_connect(service.gateway_socket)
    assert stat.S_IMODE(service.directory.stat().st_mode) == 0o751
    assert service.lost() == ""
    folder = service.directory
    for path in folder.rglob("*"):
        if path != service.gateway_socket:
            os.chown(path, -1, 4321)
    os.chown(folder, -1, 4321)

    def may(access: str, path: pathlib.Path, group: int) -> bool:
        become = ("setpriv", f"--reuid={NOBODY}", f"--regid={group}", "--clear-groups")
        return subprocess.run([*become, "test", f"-{access}", str(path)], check=False).returncode == 0

    rings = [ring.path for ring in (service.records, service.frames, service.events, service.commands)]
    for path in (*rings, service.place("active.json")):
        assert may("r", path, 4321)  # recorder
        assert not may("w", path, 4321)
        assert not may("r", path, NOBODY)
    assert may("r", service.place(PUBLIC), NOBODY)
    assert not may("r", service.place(IN_FORCE), 4321)
    assert may("w", service.gateway_socket, OPERATORS_GROUP)
    assert may("w", service.gateway_socket, VIEWERS_GROUP)
    for group in (4321, NOBODY):
        assert not may("w", service.gateway_socket, group)
    assert not may("r", folder, NOBODY)
    assert not may("w", folder, 4321)


def test_a_link_in_place_of_the_services_folder_is_refused(service: Runtime) -> None:
    other = service.directory.with_name("other")
    other.symlink_to(service.directory)
    with pytest.raises(FolderError, match="found a link"):
        Runtime(other).claim()
