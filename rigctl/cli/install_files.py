"""The files of an installed rig, as values: what ``rigctl install`` writes, from a rig file and the computer.

Units and other files that are the same for every rig are those of ``deploy/``. What depends on the rig is in drop-ins
beside them: processors, networks that may be reached, folders, the CAN interface.
"""

from __future__ import annotations

import math
import os
import pathlib
import re
from collections.abc import Iterable
from dataclasses import dataclass

from rigctl.config import layout
from rigctl.config.address import Address, is_local
from rigctl.config.settings import RigSettings
from rigctl.control.power import ending
from rigctl.ipc.writers import WRITERS

PYTHON_OF_PACKAGE = "/usr/lib/rigctl/bin/python3"
"""Interpreter that the units of ``deploy/`` name: the Debian package's."""
UNITS = pathlib.PurePosixPath("etc/systemd/system")
NETWORK = pathlib.PurePosixPath("etc/systemd/network")
TMPFILES = pathlib.PurePosixPath("etc/tmpfiles.d")
SETTINGS = pathlib.PurePosixPath(*layout.SETTINGS.parts[1:])
OTHERS = {"init.scope": "Scope", "system.slice": "Slice", "user.slice": "Slice", "machine.slice": "Slice"}
"""Units that hold everything but the rig daemons, and the section of each that limits its processors."""
TXQUEUELEN = 10  # docs/install.md: five ticks of SYNC and command; a frame that waits longer is a stale command
CARRIER_S = 30
STOP_SPARE_S = 30
"""For what ends after the loop: ``TimeoutStopSec`` is the loop's limit (`rigctl.control.power.ending`) and this."""
_PLAIN = re.compile(r"[A-Za-z0-9_./:@\[\]-]+")
_INTERFACE = re.compile(r"[A-Za-z0-9_.-]{1,15}")
_MARK = "# Written by `rigctl install`, which writes it anew; put changes into a drop-in of your own.\n"

Files = dict[pathlib.PurePosixPath, bytes]
"""Content by path, relative to the root of the installation."""


class InstallError(ValueError):
    """The rig cannot be installed; ``str()`` is one line."""


@dataclass(frozen=True)
class Host:
    """The computer: its processors, and the interpreter that runs rigctl in the units."""

    cpus: frozenset[int]
    python: str = PYTHON_OF_PACKAGE


def host(python: str) -> Host:
    """This computer, as the kernel shows it."""
    return Host(frozenset(range(os.cpu_count() or 1)), python)


def common(deploy: pathlib.Path, python: str) -> Files:
    """Files that are the same for every rig, from the folder ``deploy``."""
    found: Files = {}
    for folder, place in (("systemd", str(UNITS)), ("sysusers.d", "etc/sysusers.d"), ("tmpfiles.d", "etc/tmpfiles.d"),
                          ("logrotate.d", "etc/logrotate.d")):  # fmt: skip
        for file in sorted((deploy / folder).iterdir()):
            text = file.read_text().replace(PYTHON_OF_PACKAGE, python)
            found[pathlib.PurePosixPath(place) / file.name] = text.encode()
    return found


def settings_files(settings: RigSettings, file: pathlib.Path) -> Files:
    """The rig file under its rig's name, and the files that it names, with the same relative names.

    Raises:
        InstallError: a name leads out of the rig file's folder, or a file cannot be read.
    """
    names = {getattr(settings, device).eds for device in settings.canopen_nodes}
    devices = [getattr(settings, device) for device in ("tension_cell", "inclinometer")]
    names |= {device.dbc.file for device in devices if device.dbc is not None}
    names |= {settings.design.gains_file} if settings.design.gains_file is not None else set()
    simulator = pathlib.PurePath(settings.cylinder.eds).with_name("simulator.eds")
    names |= {str(simulator)} if settings.simulation is not None and settings.file(str(simulator)).is_file() else set()
    found: Files = {SETTINGS / f"{settings.rig}.yaml": _content(file)}
    for name in sorted(names):
        parts = pathlib.PurePosixPath(name).parts
        if pathlib.PurePosixPath(name).is_absolute():
            continue  # it stays where it is
        inside = settings.file(name).resolve().is_relative_to(file.resolve().parent)
        if ".." in parts or not inside:  # what is copied can be read by everyone, so no link may name a secret
            raise InstallError(f"{file}: found {name}, expected a file in the rig file's folder or below, to be copied")
        found[SETTINGS / name] = _content(settings.file(name))
    return found


def _content(file: pathlib.Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InstallError(f"{file}: {error.strerror}") from None


def of_rig(settings: RigSettings, computer: Host, adapter: str | None) -> Files:
    """Files of one rig beside its settings. ``adapter``: serial number or path of the CAN adapter, as udev has it.

    Raises:
        InstallError: a name would have a meaning of its own in a unit.
    """
    _refuse_unit_syntax(settings, adapter)
    _refuse_shared_folder(settings)
    found: Files = {rig_drop_in(settings.rig): _daemon(settings, computer)}
    found |= {process_drop_in(settings.rig, name): _process(name, settings, computer) for name in WRITERS}
    if lines := _kept_folders(settings):
        found[tmpfiles(settings.rig)] = _text("".join(f"{line}\n" for line in lines))
    if settings.page is not None:
        found[UNITS / f"rigctl-page@{settings.rig}.service.d/rig.conf"] = _page(settings)
    if settings.can.interface == "socketcan":
        channel = settings.can.channel
        match = f"OriginalName={channel}"
        if adapter is not None:
            by_path = re.match(r"(pci|platform|usb)-", adapter)
            match = f"Path={adapter}*" if by_path else f"Property=ID_SERIAL_SHORT={adapter}"
        name = f"Name={channel}\n" if adapter is not None else ""
        found[NETWORK / f"70-rigctl-{channel}.link"] = _text(
            f"[Match]\n{match}\n\n[Link]\n{name}TransmitQueueLength={TXQUEUELEN}\n"
        )
        rate = f"BitRate={settings.can.bitrate_bit_s}\n" if settings.can.bitrate_bit_s else ""
        found[NETWORK / f"70-rigctl-{channel}.network"] = _text(
            f"[Match]\nName={channel}\n\n[Link]\nRequiredForOnline=no\n\n"
            f"[CAN]\n{rate}# A controller that was bus-off comes back only when someone brings it up.\nRestartSec=0\n"
        )
    return found


def _refuse_unit_syntax(settings: RigSettings, adapter: str | None) -> None:
    """Refuse names that could add settings to a unit, which root's service manager would carry out."""
    values = {"telemetry.listen": settings.telemetry.listen, "--adapter": adapter or "-"}
    values |= {"page.listen": settings.page.listen} if settings.page is not None else {}
    values |= {f"folder {folder}": folder for folder in _folders_elsewhere(settings)}
    for name, value in values.items():
        if not _PLAIN.fullmatch(value):
            raise InstallError(f"{name}: found {value!r}, expected letters, digits and _ . / : @ [ ] - only")
    if settings.can.interface == "socketcan" and not _INTERFACE.fullmatch(settings.can.channel):
        raise InstallError(f"can.channel: found {settings.can.channel!r}, expected the name of a CAN interface")


def rig_drop_in(rig: str) -> pathlib.PurePosixPath:
    """The drop-in that every installed rig has."""
    return UNITS / f"rigctl@{rig}.service.d/rig.conf"


def process_drop_in(rig: str, name: str) -> pathlib.PurePosixPath:
    """The drop-in of a process of the daemon that is a service of its own."""
    return UNITS / f"rigctl-{name}@{rig}.service.d/rig.conf"


def tmpfiles(rig: str) -> pathlib.PurePosixPath:
    """The file with the folders of a rig that keeps its data elsewhere than others do."""
    return TMPFILES / f"rigctl-{rig}.conf"


def units(settings: RigSettings) -> list[str]:
    """Units to enable, in the order of their start; recorder and gateway come with the daemon."""
    simulated = [f"rigctl-sim@{settings.rig}.service"] if is_simulated(settings) else []
    network = ["systemd-networkd.service"] if settings.can.interface == "socketcan" else []
    page = [f"rigctl-page@{settings.rig}.service"] if settings.page is not None else []
    return [*network, *simulated, f"rigctl@{settings.rig}.service", *page]


def is_simulated(settings: RigSettings) -> bool:
    """Whether the rig is one that ``python -m hil serve`` serves on a bus of its own."""
    return settings.simulation is not None and settings.can.interface == "rigsim"


def processors(loops: Iterable[int], computer: Host) -> Files:
    """Drop-ins that keep everything but the rig daemons off the processors of the ``loops``; empty without any.

    Raises:
        InstallError: a processor does not exist here, or none is left for the others.
    """
    taken = set(loops)
    if not taken:
        return {}
    others = computer.cpus - taken
    if absent := taken - computer.cpus:
        raise InstallError(f"loop.cpu: found {min(absent)}, expected one of this computer's: {listed(computer.cpus)}")
    if not others:
        return {}
    return {
        UNITS / f"{unit}.d/50-rigctl.conf": _text(f"[{section}]\nAllowedCPUs={listed(others)}\n")
        for unit, section in OTHERS.items()
    }


def listed(cpus: Iterable[int]) -> str:
    """Processors as systemd and the kernel write them: ``0 2 3`` as ``0,2-3``."""
    runs: list[list[int]] = []
    for cpu in sorted(cpus):
        if runs and cpu == runs[-1][-1] + 1:
            runs[-1].append(cpu)
        else:
            runs.append([cpu])
    return ",".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def _daemon(settings: RigSettings, computer: Host) -> bytes:
    before, unit, service = [], [], []
    if is_simulated(settings):
        before.append(f"rigctl-sim@{settings.rig}.service")
    if settings.can.interface == "socketcan":
        channel = settings.can.channel
        before += ["systemd-networkd.service", f"sys-subsystem-net-devices-{_escaped(channel)}.device"]
        wait = "/lib/systemd/systemd-networkd-wait-online"
        service.append(f"ExecStartPre=-{wait} --interface={channel}:carrier --timeout={CARRIER_S}")
    if before:
        unit += [f"Wants={' '.join(before)}", f"After={' '.join(before)}"]
    if (limit_s := ending.limit_s(settings)) > ending.LIMIT_S:
        stop_s = math.ceil(limit_s) + STOP_SPARE_S
        service += ["# The longest lowering of a load takes longer than the unit has time for.",
                    f"TimeoutStopSec={stop_s}", f"TimeoutAbortSec={stop_s}"]  # fmt: skip
    service += _affinity(settings, computer)
    sections = [f"[{name}]\n" + "\n".join(lines) + "\n" for name, lines in (("Unit", unit), ("Service", service))
                if lines]  # fmt: skip
    return _text("\n".join(sections) or "[Service]\n")


def _affinity(settings: RigSettings, computer: Host) -> list[str]:
    if settings.loop.cpu is None or not (others := computer.cpus - {settings.loop.cpu}):
        return []
    return ["# Only the loop itself goes to its processor, see loop.cpu.", f"CPUAffinity={listed(others)}"]


def _process(name: str, settings: RigSettings, computer: Host) -> bytes:
    lines = _affinity(settings, computer)
    if name == "gateway" and not is_local(settings.telemetry.listen):
        lines += ["# telemetry.listen is an address that other computers reach.", "IPAddressAllow=any"]
    if name == "recorder" and settings.audit.syslog is not None:
        collector = Address.parse(settings.audit.syslog.partition("/")[2])
        allowed = collector.host if collector.is_ip else "any"
        lines += ["# audit.syslog is a collector on another computer.", "PrivateNetwork=no"]
        lines += ["RestrictAddressFamilies=AF_INET AF_INET6", f"IPAddressAllow={allowed}"]
    if folders := [str(folder) for folder in _written(settings).get(name, []) if not _is_kept_here(settings, folder)]:
        lines.append(f"ReadWritePaths={' '.join(sorted(set(folders)))}")
    return _text("[Service]\n" + "".join(f"{line}\n" for line in lines))


def _written(settings: RigSettings) -> dict[str, list[pathlib.Path]]:
    """Folders of kept data, by the process that writes to them."""
    recorder = [settings.audit_log.parent, settings.kept(settings.audit.trips)]
    recorder += [settings.kept(settings.recording.folder)]
    return {"recorder": recorder, "gateway": [settings.ledger.parent] if settings.ledger is not None else []}


def _refuse_shared_folder(settings: RigSettings) -> None:
    """Refuse data of two processes in one folder, which can belong to one user only."""
    by_gateway = set(_written(settings).get("gateway", []))
    for folder in _written(settings)["recorder"]:
        if folder in by_gateway or folder == settings.kept(""):
            raise InstallError(f"audit, recording: found the folder {folder}, expected one without the ledger in it")
    if settings.kept("") in by_gateway:
        raise InstallError(f"calibration.file: found {settings.ledger}, expected it in a folder of its own")


_READERS = {"recorder": WRITERS["recorder"].group, "gateway": "rigctl"}
"""Group of a folder of kept data, by the process that writes to it: the gateway reads nothing of the recorder's."""


def _is_kept_here(settings: RigSettings, folder: pathlib.Path) -> bool:
    return folder.is_relative_to(settings.kept(""))


def _kept_folders(settings: RigSettings) -> list[str]:
    """Lines of tmpfiles.d(5) for a rig's folders below the service's, if they have other names than by default."""
    known = {layout.STATE / name for name in ("calibration", "audit", "trips", "recordings")}
    lines: dict[pathlib.Path, str] = {}
    for name, folders in _written(settings).items():
        for folder in folders:
            place = layout.STATE / folder.relative_to(settings.kept("")) if _is_kept_here(settings, folder) else None
            if place is not None and place not in (*known, layout.STATE):
                lines[place] = f"d {place} 0750 {WRITERS[name].group} {_READERS[name]} -"
    return list(lines.values())


def _folders_elsewhere(settings: RigSettings) -> list[str]:
    """Folders that the daemon writes to and that the rig file names by an absolute path."""
    kept = [settings.audit_log.parent, settings.last_stroke.parent, settings.kept(settings.audit.trips)]
    kept += [settings.kept(settings.recording.folder)]
    named = {str(path) for path in kept if not path.is_relative_to(settings.kept(""))}
    return sorted(named - {str(layout.STATE)})


def _page(settings: RigSettings) -> bytes:
    assert settings.page is not None
    connect = f"Environment=RIGCTL_CONNECT={settings.telemetry.listen_here}"
    lines = [connect, f"Environment=RIGCTL_PAGE_LISTEN={settings.page.listen}"]
    if not settings.page.address.is_loopback:
        lines += ["# page.listen is an address that other computers reach.", "IPAddressAllow=any"]
    return _text("[Service]\n" + "\n".join(lines) + "\n")


def _escaped(channel: str) -> str:
    """A name as part of a unit's name, systemd.unit(5)."""
    return "".join(c if c.isalnum() or c in "_." else f"\\x{ord(c):02x}" for c in channel)


def _text(body: str) -> bytes:
    return (_MARK + body).encode()
