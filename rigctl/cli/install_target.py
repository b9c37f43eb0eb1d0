"""The root that ``rigctl install`` writes into: its files, and its service manager if it is the live one."""

from __future__ import annotations

import contextlib
import pathlib
import re
import subprocess
import sys
from collections.abc import Callable, Mapping

from rigctl.cli.install_files import (
    NETWORK,
    OTHERS,
    PYTHON_OF_PACKAGE,
    SETTINGS,
    UNITS,
    Files,
    InstallError,
    process_drop_in,
    rig_drop_in,
    tmpfiles,
)
from rigctl.config import rig_file
from rigctl.ipc import whole_file
from rigctl.ipc.writers import WRITERS

PACKAGED_UNIT = "usr/lib/systemd/system/rigctl@.service"
UNSEEN = ("/home/", "/root/", "/run/user/", "/tmp/", "/var/tmp/")
"""Folders that the units hide from the services (ProtectHome, PrivateTmp)."""
_RIG = re.compile(r"rigctl@([a-z][a-z0-9_]{0,31})\.service\.d")


def deploy_folder() -> pathlib.Path:
    """The folder ``deploy/``: a checkout's, or what the wheel put beside the libraries.

    Raises:
        InstallError: there is none.
    """
    places = (pathlib.Path(__file__).parents[2] / "deploy", pathlib.Path(sys.prefix) / "share/rigctl/deploy")
    for place in places:
        if (place / "systemd").is_dir():
            return place
    raise InstallError(f"found no units in {' or '.join(map(str, places))}, expected those of rigctl")


def program(live: bool) -> str:
    """The interpreter that runs this program.

    Raises:
        InstallError: services could not run it.
    """
    if not live:
        return PYTHON_OF_PACKAGE
    used = pathlib.Path(sys.executable)
    for path in (used, used.resolve()):
        if hidden := next((folder for folder in UNSEEN if str(path).startswith(folder)), None):
            raise InstallError(
                f"found rigctl run by {path}, expected it outside {hidden}, which services cannot read: "
                "install the Debian package"
            )
    return str(used)


class ServiceError(RuntimeError):
    """The service manager refused; ``str()`` is one line."""


class Target:
    """Files below a root, and its services.

    Args:
        root: ``/``, or a folder that becomes the root of another computer.
        tell: takes one line for each thing done.
        dry_run: only say what would be done.
    """

    def __init__(self, root: pathlib.Path, tell: Callable[[str], None], *, dry_run: bool) -> None:
        self.root = root
        self.dry_run = dry_run
        self.was_running = False
        self._tell = tell

    @property
    def is_live(self) -> bool:
        """Whether the services are this computer's."""
        return self.root.resolve() == pathlib.Path("/")

    @property
    def has_package(self) -> bool:
        """Whether the Debian package has brought the files that are the same for every rig."""
        return self.at(PACKAGED_UNIT).exists()

    def at(self, path: str | pathlib.PurePosixPath) -> pathlib.Path:
        """A path of the installation below the root."""
        return self.root / path

    def rigs(self, apart: str = "") -> list[str]:
        """Names of the installed rigs."""
        drop_ins = self.at(UNITS).glob("rigctl@*.service.d/rig.conf")
        found = {match[1] for path in drop_ins if (match := _RIG.fullmatch(path.parent.name))}
        return sorted(found - {apart})

    def loop_of(self, rig: str) -> int | None:
        """Processor of an installed rig's loop; None where its file is gone or refused."""
        with contextlib.suppress(rig_file.ConfigError):
            return rig_file.load(self.at(SETTINGS) / f"{rig}.yaml").loop.cpu
        return None

    def refuse_shared(self, rig: str, wanted: Files) -> None:
        """Refuse to change a file that other installed rigs may use.

        Raises:
            InstallError: its name, and theirs.
        """
        others = self.rigs(apart=rig)
        for path, data in wanted.items():
            there = self.at(path)
            if others and path.name != f"{rig}.yaml" and there.exists() and there.read_bytes() != data:
                raise InstallError(f"{there}: found another content, which {', '.join(others)} may use: rename yours")

    def keep_and_write(self, files: Files) -> int:
        """As `write`; a file that is replaced stays beside the new one as ``NAME.old``."""
        for path, data in files.items():
            there = self.at(path)
            if there.exists() and (old := there.read_bytes()) != data:
                self._put(there.with_name(f"{there.name}.old"), old, "kept")
        return self.write(files)

    def write(self, files: Files) -> int:
        """Write what differs, one line for each; returns how many."""
        changed = [(path, data) for path, data in files.items() if self._content(path) != data]
        for path, data in changed:
            self._put(self.at(path), data, "wrote")
        return len(changed)

    def _content(self, path: pathlib.PurePosixPath) -> bytes | None:
        with contextlib.suppress(OSError):
            return self.at(path).read_bytes()
        return None

    def _put(self, path: pathlib.Path, data: bytes, done: str) -> None:
        if self.dry_run:
            self._tell(f"would write {path}")
            return
        whole_file.replace(path, data, mode=0o644)
        path.chmod(0o644)  # whatever root's umask: daemon, page and simulated rig read it as other users
        for folder in path.parents:
            if folder == self.at(SETTINGS).parent or folder == self.root:
                break
            if folder.is_relative_to(self.at(SETTINGS)):
                folder.chmod(0o755)
        self._tell(f"{done} {path}")

    def remove(self, paths: Files | list[pathlib.PurePosixPath]) -> int:
        """Remove files that are there, and drop-in folders that become empty; returns how many files."""
        there = [path for path in paths if self.at(path).exists()]
        for path in there:
            if self.dry_run:
                self._tell(f"would remove {self.at(path)}")
                continue
            self.at(path).unlink()
            with contextlib.suppress(OSError):
                if path.parent.suffix == ".d" and path.parent.name not in ("sysusers.d", "tmpfiles.d", "logrotate.d"):
                    self.at(path).parent.rmdir()
            self._tell(f"removed {self.at(path)}")
        return len(there)

    def _of_rig(self, rig: str) -> list[pathlib.PurePosixPath]:
        """Files that `install` has written for a rig, apart from its settings."""
        found = [rig_drop_in(rig), UNITS / f"rigctl-page@{rig}.service.d/rig.conf", tmpfiles(rig)]
        found += [process_drop_in(rig, name) for name in WRITERS]
        with contextlib.suppress(rig_file.ConfigError):
            channel = rig_file.load(self.at(SETTINGS) / f"{rig}.yaml").can.channel
            used = [other for other in self.rigs(apart=rig) if self._channel_of(other) == channel]
            if "/" not in channel and not used:
                found += [NETWORK / f"70-rigctl-{channel}.{kind}" for kind in ("link", "network")]
        return [path for path in found if self.at(path).exists()]

    def _channel_of(self, rig: str) -> str | None:
        with contextlib.suppress(rig_file.ConfigError):
            return rig_file.load(self.at(SETTINGS) / f"{rig}.yaml").can.channel
        return None

    def drop_stale(self, rig: str, own: Files, cpus: Files) -> int:
        """Remove what an earlier installation of the rig has written and this one does not need."""
        return self.remove([path for path in self._of_rig(rig) if path not in own]) + self.drop_stale_processors(cpus)

    def drop_stale_processors(self, cpus: Files) -> int:
        """Remove limits of processors that no rig needs any more."""
        known = [UNITS / f"{unit}.d/50-rigctl.conf" for unit in OTHERS]
        return self.remove([path for path in known if path not in cpus])

    def remove_rig(self, rig: str) -> int:
        """Remove the files of a rig, apart from its settings and data."""
        return self.remove(self._of_rig(rig))

    # -- services -------------------------------------------------------------------------------------------
    def activate(self, rig: str, units: list[str], *, start: bool, members: Mapping[str, str | None]) -> None:
        """Make users and folders, load the units, enable and start them; a daemon that runs goes on as it is.

        ``members``: by group, a user who joins it.

        Raises:
            ServiceError: a step failed; the files stay, and the command may be given again.
        """
        page = f"rigctl-page@{rig}.service"
        self.was_running = _succeeds("systemctl", "--quiet", "is-active", f"rigctl@{rig}.service")
        self._do("systemd-sysusers")
        for group, user in members.items():
            if user is not None:
                self._do("usermod", "--append", "--groups", group, "--", user)
        self._do("systemd-tmpfiles", "--create", "rigctl.conf", *self._own_folders(rig))
        self.reload()
        if any("networkd" in unit for unit in units):
            self._do("udevadm", "control", "--reload")
            self._do("udevadm", "trigger", "--subsystem-match=net", "--action=add")
            if _succeeds("systemctl", "--quiet", "is-active", "systemd-networkd.service"):
                self._do("networkctl", "reload")
        if page not in units and _succeeds("systemctl", "--quiet", "is-enabled", page):
            self._do("systemctl", "disable", "--now", page)
        self._do("systemctl", "enable", "--quiet", *units)
        if start:
            self._do("systemctl", "start", *units)

    def _own_folders(self, rig: str) -> list[str]:
        return [tmpfiles(rig).name] if self.at(tmpfiles(rig)).exists() else []

    def deactivate(self, rig: str) -> None:
        """Stop and disable a rig's units: the daemon ends with the stroke held."""
        for unit in (f"rigctl-page@{rig}.service", f"rigctl@{rig}.service", f"rigctl-sim@{rig}.service"):
            self._do("systemctl", "disable", "--quiet", "--now", unit)

    def reload(self) -> None:
        """Have the service manager read its units anew."""
        self._do("systemctl", "daemon-reload")

    def _do(self, *command: str) -> None:
        if self.dry_run:
            self._tell(f"would run {' '.join(command)}")
            return
        self._tell(f"ran {' '.join(command)}")
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise ServiceError(f"{command[0]}: {error.strerror}") from None
        if done.returncode:
            said = " ".join(done.stderr.split()) or f"ended with code {done.returncode}"
            raise ServiceError(f"{' '.join(command)}: {said}")


def _succeeds(*command: str) -> bool:
    with contextlib.suppress(OSError):
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    return False
