"""A computer with a service manager of its own: systemd as PID 1 in namespaces, on a copy of this computer's files.

Its files are an overlay in memory, its process numbers, network (loopback), shared memory and control groups its own:
what happens in it changes nothing here. It needs root, and the kernel's unified control groups.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import shlex
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import yaml

from tests.builders.pages import PATIENT
from tests.builders.waiting import line_of, patience_s, until

_UNIFIED = (pathlib.Path("/sys/fs/cgroup/unified"), pathlib.Path("/sys/fs/cgroup"))
_BOOT = r"""
set -e
m=$1/m; mkdir -p $1/u $1/w $m
mount -t overlay -o lowerdir=/,upperdir=$1/u,workdir=$1/w o $m
mount -t proc p $m/proc; mount -t sysfs -o ro s $m/sys; mount -t cgroup2 c $m/sys/fs/cgroup
for f in run tmp dev; do mount -t tmpfs t $m/$f; done; chmod 1777 $m/tmp; chmod 755 $m/run $m/dev
for n in null zero full random urandom tty; do touch $m/dev/$n; mount --bind /dev/$n $m/dev/$n; done
mkdir $m/dev/shm $m/dev/pts; mount -t tmpfs -o mode=1777 s $m/dev/shm; ln -s /proc/self/fd $m/dev/fd
mount -t devpts -o newinstance,ptmxmode=0666 d $m/dev/pts; ln -s pts/ptmx $m/dev/ptmx
# A fresh system: only what the package and `rigctl install` enable is started.
[ -e $1/booted ] || rm -rf $m/etc/systemd/system/*.wants $m/usr/lib/systemd/system/timers.target.wants
touch $1/booted
ip link set lo up
# Not chroot: the services' own mounts need a root that is a mount.
cd $m; mkdir -p .outside; pivot_root . .outside; umount -l .outside
exec chroot . /usr/bin/env -i container=test PATH=/usr/sbin:/usr/bin:/sbin:/bin \
    /lib/systemd/systemd --unit=multi-user.target --log-target=journal --show-status=no
"""


CAP_SYS_RESOURCE, CAP_SYS_NICE, CAP_IPC_LOCK = 24, 23, 14
_LENT = """# This computer may not raise limits, so the right to real time is lent another way.
[Service]
CapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK
AmbientCapabilities=CAP_SYS_NICE CAP_IPC_LOCK
"""


def may_raise_limits() -> bool:
    """Whether this computer's root may raise limits, which the units' LimitRTPRIO and LimitMEMLOCK need."""
    words = pathlib.Path("/proc/self/status").read_text().partition("CapEff:")[2].split()
    return bool(int(words[0], 16) >> CAP_SYS_RESOURCE & 1)


class ServiceComputer:
    """One such computer. ``folder``: an empty one for its files, a mount of memory."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder
        self.log = folder / "boot.log"
        self._group = next(top for top in _UNIFIED if (top / "cgroup.procs").exists()) / f"rigctl_test_{os.getpid()}"
        self._outer: subprocess.Popen[bytes] | None = None
        self._init = 0

    def boot(self) -> None:
        """Start its service manager; returns when the start-up is over."""
        self._group.mkdir(exist_ok=True)
        script = self.folder / "boot.sh"
        script.write_text(_BOOT)
        unshare = "unshare --mount --pid --fork --net --cgroup --uts --ipc --propagation private --kill-child=SIGKILL"
        command = f"echo $$ >{self._group}/cgroup.procs && exec {unshare} sh {script} {self.folder}"
        with self.log.open("ab") as out:
            self._outer = subprocess.Popen(["sh", "-c", command], stdout=out, stderr=out, stdin=subprocess.DEVNULL)
        children = pathlib.Path(f"/proc/{self._outer.pid}/task/{self._outer.pid}/children")
        self._init = int(self.wait_for(lambda: children.read_text().split())[0])
        self.wait_for(lambda: "systemd" in pathlib.Path(f"/proc/{self._init}/comm").read_text())
        self.wait_for(lambda: self.run("systemctl", "is-system-running").stdout.strip() in ("running", "degraded"))

    def switch_off(self) -> None:
        """As by a power cut: every process is gone at once, the files stay."""
        if self._outer is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._init, signal.SIGKILL)
            self._outer.wait()
            self._outer = None
        for folder, _, _ in os.walk(self._group, topdown=False):
            with contextlib.suppress(OSError):
                pathlib.Path(folder).rmdir()

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Run a command in it, as root."""
        clean = ["env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "LANG=C.UTF-8", "USER=root", "HOME=/tmp"]
        return subprocess.run(
            ["nsenter", "--target", str(self._init), "--all", "--root", "--wd", *clean, *command],
            capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, timeout=patience_s(300.0),
        )  # fmt: skip

    def put(self, file: pathlib.Path) -> str:
        """Copy a file into it; returns where it is there."""
        shutil.copy(file, f"/proc/{self._init}/root/var/cache/{file.name}")
        return f"/var/cache/{file.name}"

    def patient(self) -> None:
        """Give its rig limits that a busy machine keeps, and start it anew with them."""
        settings = pathlib.Path(f"/proc/{self._init}/root/etc/rigctl")
        data = yaml.safe_load((settings / "paper_rig.yaml").read_text())
        for section, values in PATIENT.items():
            data[section] |= values
        there = pathlib.Path(f"/proc/{self._init}/root/var/cache/patient")
        shutil.copytree(settings, there)
        (there / "paper_rig.yaml").write_text(yaml.safe_dump(data))
        self.done("rigctl", "install", "/var/cache/patient/paper_rig.yaml")
        self.insist("systemctl", "restart", "rigctl-sim@paper_rig", "rigctl@paper_rig")

    def lend_real_time(self, *templates: str) -> None:
        """Let services have real time where this computer's root may not raise limits."""
        if may_raise_limits():
            return
        for template in templates:
            folder = pathlib.Path(f"/proc/{self._init}/root/etc/systemd/system/{template}.d")
            folder.mkdir(parents=True)
            (folder / "lent.conf").write_text(_LENT)

    def done(self, *command: str) -> str:
        """Run a command that has to succeed; returns what it printed."""
        result = self.run(*command)
        said = f"{shlex.join(command)}: {result.stdout}{result.stderr}"
        assert result.returncode == 0, f"{said}\n{self.journal()[-3000:]}"
        return result.stdout

    def insist(self, *command: str) -> None:
        """As `done`, but given again while a busy machine keeps a loop from starting, which a quiet one does not."""
        for _ in range(2):
            if self.run(*command).returncode == 0:
                return
            self.run("systemctl", "reset-failed")
        self.done(*command)

    def journal(self, unit: str = "") -> str:
        """Messages of a unit, or of all since it was switched on."""
        return self.run("journalctl", "--no-pager", "-q", "-o", "cat", *(["-u", unit] if unit else [])).stdout

    def value(self, unit: str, name: str) -> str:
        """A property of a unit."""
        return self.done("systemctl", "show", "--value", "-p", name, unit).strip()

    def processes(self, unit: str) -> dict[int, list[str]]:
        """Command lines of a unit's processes, by the process numbers in it."""
        group = self.value(unit, "ControlGroup")
        found = {}
        for pid in self.run("cat", f"/sys/fs/cgroup{group}/cgroup.procs").stdout.split():
            if line := self.run("cat", f"/proc/{pid}/cmdline").stdout:
                found[int(pid)] = line.split("\0")
        return found

    def wait_for(self, what: Callable[[], Any]) -> Any:
        """Poll until ``what()`` is true; returns it."""

        def found() -> Any:
            with contextlib.suppress(OSError):
                return what()

        try:
            return until(found, line_of(what), log=self.log, every_s=0.1)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.journal()[-6000:] if self._init else ''}") from None


@contextlib.contextmanager
def service_computer(folder: pathlib.Path) -> Iterator[ServiceComputer]:
    """A computer that is switched on, and gone after the block."""
    subprocess.run(["mount", "-t", "tmpfs", "rigctl-test", str(folder)], check=True)
    computer = ServiceComputer(folder)
    try:
        computer.boot()
        yield computer
    finally:
        computer.switch_off()
        subprocess.run(["umount", "--lazy", str(folder)], check=False)
