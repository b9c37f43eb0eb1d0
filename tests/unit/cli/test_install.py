"""``rigctl install``: the files it writes, for any root; the services themselves: tests/live/system/test_service.py."""

from __future__ import annotations

import pathlib
import shutil
import subprocess
from collections.abc import Callable

import pytest
import yaml

from rigctl.cli import install_files
from rigctl.cli.install_files import Host, InstallError, listed, of_rig, processors, settings_files
from rigctl.config import layout, rig_file
from rigctl.config.settings import RigSettings
from tests.builders.paths import ROOT

Command = Callable[..., "subprocess.CompletedProcess[str]"]
RIG, SIMULATED = ROOT / "config/rig.yaml", ROOT / "config/paper_rig.yaml"
FOUR = Host(frozenset(range(4)))


@pytest.fixture(autouse=True)
def _four_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install_files, "host", lambda python: Host(frozenset(range(4)), python))


def files(root: pathlib.Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def changed(folder: pathlib.Path, **sections: object) -> tuple[RigSettings, pathlib.Path]:
    """The real rig's settings with changes, and their file; its device files beside it."""
    data = yaml.safe_load(RIG.read_text())
    for name, values in sections.items():
        data[name] = {**data.get(name, {}), **values} if isinstance(values, dict) else values
    shutil.copytree(ROOT / "config/eds", folder / "eds", dirs_exist_ok=True)
    file = folder / "mine.yaml"
    file.write_text(yaml.safe_dump(data))
    return rig_file.load(file), file


def test_every_file_is_said_and_a_second_time_nothing_changes(in_process: Command, tmp_path: pathlib.Path) -> None:
    first = in_process("rigctl", "install", RIG, "--root", tmp_path)
    assert first.returncode == 0, first.stderr
    written = files(tmp_path)
    assert {line.removeprefix("wrote ") for line in first.stdout.splitlines() if line.startswith("wrote ")} == {
        str(tmp_path / name) for name in written
    }
    second = in_process("rigctl", "install", RIG, "--root", tmp_path)
    assert second.stdout == "rig: installed, nothing has changed\n"
    assert files(tmp_path) == written


def test_a_dry_run_says_the_same_files_and_writes_none(in_process: Command, tmp_path: pathlib.Path) -> None:
    said = in_process("rigctl", "install", RIG, "--root", tmp_path, "--dry-run").stdout
    assert not files(tmp_path)
    in_process("rigctl", "install", RIG, "--root", tmp_path)
    assert sorted(line.split()[-1] for line in said.splitlines() if line.startswith("would write")) == sorted(
        str(tmp_path / name) for name in files(tmp_path)
    )


def test_installed_settings_are_those_of_the_rig_file_and_load(in_process: Command, tmp_path: pathlib.Path) -> None:
    in_process("rigctl", "install", SIMULATED, "--root", tmp_path)
    there = tmp_path / "etc/rigctl/paper_rig.yaml"
    assert there.read_bytes() == SIMULATED.read_bytes()
    assert rig_file.load(there).model_copy(update={"directory": ""}) == rig_file.load(SIMULATED).model_copy(
        update={"directory": ""}
    )


def test_an_upgrade_keeps_data_and_the_settings_it_replaces(in_process: Command, tmp_path: pathlib.Path) -> None:
    root = tmp_path / "root"
    in_process("rigctl", "install", SIMULATED, "--root", root)
    ledger = root / "var/lib/rigctl/calibration/paper_rig.json"
    ledger.parent.mkdir(parents=True)
    ledger.write_text("[]")
    shutil.copytree(ROOT / "config", tmp_path / "config")
    newer = tmp_path / "config/paper_rig.yaml"
    newer.write_text(newer.read_text() + "# newer\n")
    assert "kept" in in_process("rigctl", "install", newer, "--root", root).stdout
    assert (root / "etc/rigctl/paper_rig.yaml.old").read_bytes() == SIMULATED.read_bytes()
    assert (root / "etc/rigctl/paper_rig.yaml").read_bytes() == newer.read_bytes()
    assert ledger.read_text() == "[]"


def test_uninstall_leaves_settings_and_data_and_nothing_else(in_process: Command, tmp_path: pathlib.Path) -> None:
    for file in (RIG, SIMULATED):
        in_process("rigctl", "install", file, "--root", tmp_path)
    (tmp_path / "var/lib/rigctl").mkdir(parents=True)
    (tmp_path / "var/lib/rigctl/data").touch()
    assert in_process("rigctl", "uninstall", "rig", "--root", tmp_path).returncode == 0
    there = files(tmp_path)
    assert "etc/systemd/system/rigctl@paper_rig.service.d/rig.conf" in there
    assert not any("can0" in name or "@rig." in name for name in there)
    in_process("rigctl", "uninstall", "paper_rig", "--root", tmp_path)
    assert {name.split("/")[1] for name in files(tmp_path)} == {"rigctl", "lib"}


def test_an_unknown_rig_is_not_uninstalled(in_process: Command, tmp_path: pathlib.Path) -> None:
    answer = in_process("rigctl", "uninstall", "other", "--root", tmp_path)
    assert answer.returncode == 2
    assert answer.stderr == "rigctl: other: found no rig of this name among the installed: none\n"


def test_a_file_that_another_rig_uses_is_not_replaced(in_process: Command, tmp_path: pathlib.Path) -> None:
    in_process("rigctl", "install", SIMULATED, "--root", tmp_path / "root")
    _, file = changed(tmp_path)
    eds = tmp_path / "eds/cylinder_drive.eds"
    eds.write_text(eds.read_text() + "; another\n")
    answer = in_process("rigctl", "install", file, "--root", tmp_path / "root")
    assert answer.returncode == 2
    assert answer.stderr.endswith("found another content, which paper_rig may use: rename yours\n")


def test_a_link_out_of_the_rig_files_folder_is_not_copied(tmp_path: pathlib.Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes((ROOT / "config/eds/cylinder_drive.eds").read_bytes())
    folder = tmp_path / "stick"
    folder.mkdir()
    settings, file = changed(folder)
    (folder / "eds/cylinder_drive.eds").unlink()
    (folder / "eds/cylinder_drive.eds").symlink_to(secret)
    with pytest.raises(InstallError, match="expected a file in the rig file's folder or below"):
        settings_files(settings, file)


@pytest.mark.parametrize("change", [
    {"can": {"channel": "can0\n[Service]\nExecStartPre=+/bin/sh"}},
    {"telemetry": {"listen": "unixsock-stream//run/x%n"}},
    {"recording": {"folder": "/data/a b\nExecStart="}},
])  # fmt: skip
def test_a_rig_file_cannot_add_settings_to_a_unit(tmp_path: pathlib.Path, change: dict[str, object]) -> None:
    settings, _ = changed(tmp_path, **change)
    with pytest.raises(InstallError, match="expected"):
        of_rig(settings, FOUR, None)


def drop_in(settings: RigSettings) -> str:
    return of_rig(settings, FOUR, None)[install_files.rig_drop_in(settings.rig)].decode()


def test_the_daemon_reaches_only_what_its_rig_file_needs(tmp_path: pathlib.Path) -> None:
    def drop_ins(settings: RigSettings) -> dict[str, str]:
        found = of_rig(settings, FOUR, None)
        names = {name: install_files.process_drop_in(settings.rig, name) for name in ("gateway", "recorder")}
        return {name: found[path].decode() for name, path in names.items()} | {"daemon": drop_in(settings)}

    near = drop_ins(changed(tmp_path)[0])
    assert not [name for name, text in near.items() if "IPAddressAllow" in text or "ReadWritePaths" in text]
    assert all("CPUAffinity" in text for text in near.values())
    listen = {"listen": "tcp/0.0.0.0:7447", "listen_waiver": "a network of its own"}
    far = drop_ins(changed(tmp_path, telemetry=listen, recording={"folder": "/data/rig"})[0])
    assert [name for name, text in far.items() if "IPAddressAllow=any" in text] == ["gateway"]
    assert [name for name, text in far.items() if "ReadWritePaths=/data/rig\n" in text] == ["recorder"]


@pytest.mark.parametrize(("collector", "allowed"), [
    ("udp/192.0.2.7:514", "192.0.2.7"), ("tcp/[2001:db8::7]:514", "2001:db8::7"), ("tcp/logs.example:514", "any"),
])  # fmt: skip
def test_the_recorder_reaches_its_collector(tmp_path: pathlib.Path, collector: str, allowed: str) -> None:
    """Its unit has no network at all."""
    settings = changed(tmp_path, audit={"syslog": collector})[0]
    files = of_rig(settings, FOUR, None)
    lines = files[install_files.process_drop_in(settings.rig, "recorder")].decode().splitlines()
    for line in ("PrivateNetwork=no", "RestrictAddressFamilies=AF_INET AF_INET6", f"IPAddressAllow={allowed}"):
        assert line in lines
    others = (files[install_files.process_drop_in(settings.rig, name)].decode() for name in ("gateway",))
    assert not any("PrivateNetwork" in text or "IPAddressAllow" in text for text in others)


def test_folders_of_other_names_are_made_for_the_process_that_writes_them(tmp_path: pathlib.Path) -> None:
    assert install_files.tmpfiles("rig") not in of_rig(changed(tmp_path)[0], FOUR, None)
    settings = changed(tmp_path, recording={"folder": "tapes"})[0]
    made = of_rig(settings, FOUR, None)[install_files.tmpfiles(settings.rig)].decode()
    assert "d /var/lib/rigctl/tapes 0750 rigctl-recorder rigctl-recorder -\n" in made
    for section, change in (("audit", {"file": "calibration/rig.jsonl"}), ("recording", {"folder": "."})):
        with pytest.raises(InstallError, match="expected one without the ledger in it"):
            of_rig(changed(tmp_path, **{section: change})[0], FOUR, None)


def service_groups() -> dict[str, set[str]]:
    """The groups of each service's process, by its user."""
    found = {}
    for unit in (ROOT / "deploy/systemd").glob("*.service"):
        lines = dict(line.split("=", 1) for line in unit.read_text().splitlines() if "=" in line)
        found[lines["User"]] = {lines["Group"], *lines.get("SupplementaryGroups", "").split()}
    return found


def test_no_service_can_exchange_anothers_folder_and_the_recorders_are_its_own() -> None:
    """By the rules of the kernel: the owner of a folder, and a group that may write to it, renames what is in it."""
    lines = [line.split() for line in (ROOT / "deploy/tmpfiles.d/rigctl.conf").read_text().splitlines()]
    made = {pathlib.Path(line[1]): line[2:5] for line in lines if line[0] == "d"}
    parent = made[layout.STATE]
    assert parent == ["0750", "root", "rigctl"]
    groups = service_groups()
    assert {"rigctl", "rigctl-gateway", "rigctl-recorder", "rigctl-page", "rigctl-sim"} == groups.keys()
    readers = {}
    for place, (mode, owner, group) in made.items():
        if place.parent == layout.STATE:
            bits = int(mode, 8)
            assert not bits & 0o027, place  # none but the owner writes, and others do nothing
            assert parent[2] in groups[owner], f"{owner} cannot enter {layout.STATE}"
            readers[place.name] = {user for user, has in groups.items() if user == owner or group in has}
    recorders = {"rigctl-recorder", "rigctl"}  # the supervisor reads the audit log's end and the last known stroke
    assert readers == {
        "audit": recorders, "trips": recorders, "recordings": recorders,
        "calibration": {*recorders, "rigctl-gateway"},
    }  # fmt: skip


def test_the_bus_comes_up_with_bit_rate_queue_and_no_restart(tmp_path: pathlib.Path) -> None:
    found = {path.name: data.decode() for path, data in of_rig(changed(tmp_path)[0], FOUR, None).items()}
    assert {"BitRate=1000000", "RestartSec=0"} <= set(found["70-rigctl-can0.network"].splitlines())
    assert {"OriginalName=can0", "TransmitQueueLength=10"} <= set(found["70-rigctl-can0.link"].splitlines())


@pytest.mark.parametrize(("adapter", "match"), [
    ("0042", "Property=ID_SERIAL_SHORT=0042"),
    ("pci-0000:00:14.0-usb-0:2:1.0", "Path=pci-0000:00:14.0-usb-0:2:1.0*"),
])  # fmt: skip
def test_a_named_adapter_gets_the_channels_name(tmp_path: pathlib.Path, adapter: str, match: str) -> None:
    settings = changed(tmp_path, can={"channel": "rigcan"})[0]
    found = {path.name: data.decode() for path, data in of_rig(settings, FOUR, adapter).items()}
    assert {match, "Name=rigcan"} <= set(found["70-rigctl-rigcan.link"].splitlines())


def test_the_loops_processors_are_taken_from_all_others() -> None:
    found = {path.parent.name: data.decode() for path, data in processors([1, 3], FOUR).items()}
    assert set(found) == {"init.scope.d", "system.slice.d", "user.slice.d", "machine.slice.d"}
    assert all("AllowedCPUs=0,2\n" in text for text in found.values())
    assert processors([], FOUR) == {}
    assert processors([0], Host(frozenset({0}))) == {}  # a single processor is everybody's
    with pytest.raises(InstallError, match="found 7, expected one of this computer's: 0-3"):
        processors([7], FOUR)
    assert listed({0, 2, 3, 4, 7}) == "0,2-4,7"


def test_only_the_services_rig_file_has_its_data_elsewhere(tmp_path: pathlib.Path) -> None:
    settings, _ = changed(tmp_path)
    assert settings.audit_log == tmp_path / "audit/rig.jsonl"
    assert layout.run_base(settings.directory) == layout.SHARED_MEMORY
    service = settings.model_copy(update={"directory": str(layout.SETTINGS)})
    assert service.audit_log == layout.STATE / "audit/rig.jsonl"
    assert service.ledger == layout.STATE / "calibration/rig.json"
    assert service.file(service.cylinder.eds) == layout.SETTINGS / "eds/cylinder_drive.eds"
    assert layout.run_base(service.directory) == layout.RUN
