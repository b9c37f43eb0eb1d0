"""What is soaked: a daemon of the soak's own on the simulated rig, or the services of a rig that is installed here."""

from __future__ import annotations

import contextlib
import pathlib
import re
import signal
import subprocess
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from rigctl.config import layout, rig_file
from rigctl.ipc.runtime_folder import Runtime
from rigctl.supervisor.daemon import PAGE, PROCESSES
from tests.bench.recorder import PATIENT
from tests.builders import daemons
from tests.soak.load import small_disk

PARTS_MB, KEEP_MB, FREE_MIB, DISK_MIB = 16, 64, 16, 160
RIG = "simulated rig"
_MODULES = {module: name for name, module in (PROCESSES | PAGE).items()}


class SubjectError(RuntimeError):
    """There is nothing to soak; ``str()`` is one line."""


@dataclass(frozen=True)
class Subject:
    """A daemon on the simulated rig. ``pids``: its processes that run now, by name; ``end``: returns its exit code."""

    rig: str
    endpoint: str
    page: str
    runtime: Runtime
    recordings: pathlib.Path
    disk: pathlib.Path | None
    pids: Callable[[], dict[str, int]]
    end: Callable[[], int]


def _words(pid: str) -> list[str]:
    with contextlib.suppress(OSError):
        return pathlib.Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    return []


def _named(pids: Iterable[str]) -> dict[str, int]:
    """The daemon's processes among ``pids``, by the module that they run."""
    found = {}
    for pid in pids:
        if name := next((_MODULES[word] for word in _words(pid) if word in _MODULES), None):
            found[name] = int(pid)
    return found


def children(pid: int) -> dict[str, int]:
    """Names and pids of the processes that a supervisor started."""
    with contextlib.suppress(OSError):
        return _named(pathlib.Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
    return {}


@contextlib.contextmanager
def own(folder: pathlib.Path) -> Iterator[Subject]:
    """A daemon with files in ``folder``; its recordings are on a small disk, if this user may mount one."""
    with small_disk(folder / "disk", DISK_MIB, subprocess.run) as disk:
        page = f"localhost:{daemons.free_port()}"  # an address in numbers would need quotes in the rig file
        kept: dict[str, Any] = {"part_mb": PARTS_MB, "keep_mb": KEEP_MB, "free_mib": FREE_MIB}
        changes: dict[str, dict[str, Any]] = {
            **PATIENT,
            "preflight": {"disk_free_mib": 1},
            "recording": kept | ({"folder": str(disk)} if disk is not None else {}),
            "page": {"listen": page},
        }
        file, log = daemons.rig_file(folder, changes), folder / "daemon.log"
        name, endpoint = daemons.name_of(file), daemons.endpoint(file)
        with daemons.simulated_rig(file, folder / "rig.log") as rig, daemons.daemon(file, log) as daemon:

            def pids() -> dict[str, int]:
                return {"supervisor": daemon.pid, RIG: rig.pid, **children(daemon.pid)}

            def end() -> int:
                daemon.send_signal(signal.SIGTERM)
                return daemon.wait(60.0)

            recordings = disk if disk is not None else folder / "recordings"
            yield Subject(name, endpoint, page, Runtime.of(name), recordings, disk, pids, end)


def _unit(kind: str, name: str, rig: str) -> str:
    answer = subprocess.run(
        ["systemctl", "show", "--property", name, "--value", f"rigctl{kind}@{rig}.service"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return answer.stdout.strip()


@contextlib.contextmanager
def installed(rig: str) -> Iterator[Subject]:
    """The services of a rig on the simulated rig, which run; they are stopped at the end. Its disk is not filled.

    Raises:
        SubjectError: they are not there, or do not run.
    """
    file = layout.SETTINGS / f"{rig}.yaml"
    if not file.exists():
        raise SubjectError(f"found no {file}, expected an installed rig (rigctl install)")
    for kind in ("", "-sim", "-page"):
        if _unit(kind, "MainPID", rig) in ("", "0"):
            raise SubjectError(f"rigctl{kind}@{rig}.service does not run: systemctl start rigctl{kind}@{rig}")
    settings = rig_file.load(file)
    listen = re.search(r"RIGCTL_PAGE_LISTEN=(\S+)", _unit("-page", "Environment", rig))
    main = {name: int(_unit(kind, "MainPID", rig)) for name, kind in (("supervisor", ""), (RIG, "-sim"))}

    def pids() -> dict[str, int]:
        everyone = [entry.name for entry in pathlib.Path("/proc").iterdir() if entry.name.isdigit()]
        found = {**main, **_named(everyone)}
        if page := next((pid for pid in everyone if _words(pid)[2:6] == ["rigctl", "page", "--rig", rig]), None):
            found["page"] = int(page)
        return found

    def end() -> int:
        subprocess.run(["systemctl", "stop", f"rigctl@{rig}.service"], check=True)
        return int(_unit("", "ExecMainStatus", rig))

    yield Subject(
        rig, settings.telemetry.listen, listen[1] if listen else "127.0.0.1:8080",
        Runtime.of(rig, layout.RUN), settings.kept(settings.recording.folder), None, pids, end,
    )  # fmt: skip
