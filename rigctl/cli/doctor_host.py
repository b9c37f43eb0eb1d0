"""Findings of ``rigctl doctor`` on the computer: clock, processors, kernel, memory, Python.

Everything is read from the kernel's files below ``root``; nothing is changed.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import pathlib
import platform
import sys
import sysconfig
from dataclasses import dataclass
from enum import Enum

from rigctl import __version__
from rigctl.config.settings import RigSettings
from rigctl.ipc import runtime_folder as runtime

ROOT = pathlib.Path("/")
GOOD_CLOCKS = frozenset({"tsc", "kvm-clock", "arch_sys_counter", "riscv_clocksource", "hyperv_clocksource_tsc_page"})
LEAST_MEMORY_MIB = 512
PACKAGES = ("eclipse-zenoh", "python-can", "canopen", "numpy", "pydantic", "msgspec", "control")
_MIB_PER_KIB = 1 / 1024
_STA_UNSYNC = 0x40


class Severity(Enum):
    """Severity of a finding."""

    OK = "ok"
    WARNING = "warning"
    FAILS = "fails"


@dataclass(frozen=True)
class DoctorFinding:
    """One check: what was found, what is wanted, and how to fix a difference."""

    name: str
    severity: Severity
    found: str
    wanted: str = ""
    fix: str = ""

    def as_dict(self) -> dict[str, str | bool]:
        """As JSON values."""
        ok = self.severity is Severity.OK
        return {
            "name": self.name, "ok": ok, "severity": self.severity.value, "found": self.found, "wanted": self.wanted,
            "fix": self.fix,
        }  # fmt: skip


def good(name: str, found: str) -> DoctorFinding:
    """A finding that needs no action."""
    return DoctorFinding(name, Severity.OK, found)


def warning(name: str, found: str, wanted: str, fix: str = "") -> DoctorFinding:
    """A finding that allows arming, though the rig may run worse."""
    return DoctorFinding(name, Severity.WARNING, found, wanted, fix)


def fails(name: str, found: str, wanted: str, fix: str = "") -> DoctorFinding:
    """A finding that refuses arming or the daemon's start."""
    return DoctorFinding(name, Severity.FAILS, found, wanted, fix)


def host(settings: RigSettings | None, root: pathlib.Path = ROOT, *, doubt: str = "") -> list[DoctorFinding]:
    """Findings that apply to every rig; ``settings`` give the loop's processor; ``doubt``: of the wall clock."""
    cpu = settings.loop.cpu if settings is not None else None
    locked = settings is None or settings.loop.lock_memory
    return [
        clock_source(root),
        governor(root, cpu),
        kernel(root),
        isolation(root, cpu),
        memory(root),
        swap(root, locked=locked),
        clock_sync(*_adjtimex(), doubt),
        python(),
        versions(),
    ]


def clock_source(root: pathlib.Path) -> DoctorFinding:
    """The kernel's clock source: a read from a register takes 20 ns, one over a bus some microseconds."""
    found = _read(root / "sys/devices/system/clocksource/clocksource0/current_clocksource")
    if not found:
        return warning("clock source", "not shown by the kernel", "tsc")
    if found in GOOD_CLOCKS:
        return good("clock source", found)
    return warning("clock source", found, "tsc", "see dmesg for why the kernel gave up tsc; kernel option tsc=reliable")


def governor(root: pathlib.Path, cpu: int | None) -> DoctorFinding:
    """The frequency governor: a processor that saves power wakes late."""
    base = root / "sys/devices/system/cpu"
    pattern = f"cpu{cpu}" if cpu is not None else "cpu[0-9]*"
    found = sorted({_read(file) for file in base.glob(f"{pattern}/cpufreq/scaling_governor")} - {""})
    if not found:
        return good("cpu governor", "no frequency scaling here")
    if found == ["performance"]:
        return good("cpu governor", "performance")
    return warning("cpu governor", ", ".join(found), "performance", "cpupower frequency-set -g performance")


def kernel(root: pathlib.Path) -> DoctorFinding:
    """Whether the kernel has PREEMPT_RT."""
    version = f"{platform.release()} {_read(root / 'proc/sys/kernel/version') or platform.version()}"
    if _read(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return good("kernel", f"{version} (PREEMPT_RT)")
    return warning("kernel", version, "PREEMPT_RT", "install the real-time kernel (Debian: linux-image-rt-amd64)")


def isolation(root: pathlib.Path, cpu: int | None) -> DoctorFinding:
    """Whether the loop's processor is isolated."""
    isolated = _read(root / "sys/devices/system/cpu/isolated")
    if cpu is None:
        return good("isolated cpus", f"{isolated or 'none'}; loop.cpu asks for none")
    if cpu in cpus(isolated):
        return good("isolated cpus", isolated)
    return warning(
        "isolated cpus", isolated or "none", f"cpu {cpu} (loop.cpu)", f"kernel option isolcpus=managed_irq,domain,{cpu}"
    )


def cpus(text: str) -> set[int]:
    """``1,4-6`` as a set."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if first.isdigit():
            found |= set(range(int(first), int(last if last.isdigit() else first) + 1))
    return found


def memory(root: pathlib.Path) -> DoctorFinding:
    """Memory for the daemon's processes and rings."""
    available = _meminfo(root).get("MemAvailable")
    if available is None:
        return warning("memory", "not shown by the kernel", f"{LEAST_MEMORY_MIB} MiB available")
    found = f"{available * _MIB_PER_KIB:.0f} MiB available"
    if available * _MIB_PER_KIB >= LEAST_MEMORY_MIB:
        return good("memory", found)
    return fails("memory", found, f"{LEAST_MEMORY_MIB} MiB", "end other programs, or fit more memory")


def swap(root: pathlib.Path, *, locked: bool) -> DoctorFinding:
    """Swap: a page on the disk comes back late; locked pages stay in memory."""
    figures = _meminfo(root)
    total, free = figures.get("SwapTotal", 0), figures.get("SwapFree", 0)
    if not total:
        return good("swap", "none")
    used = f"{(total - free) * _MIB_PER_KIB:.0f} of {total * _MIB_PER_KIB:.0f} MiB used"
    if locked:
        return good("swap", f"{used}; the loop's memory is locked")
    return warning("swap", used, "none, or loop.lock_memory", "swapoff -a, or lock_memory: true")


def clock_sync(synchronised: bool, error_ms: float, doubt: str) -> DoctorFinding:
    """The wall clock, which due dates and recorded times use, and the loop does not; ``doubt``: see `wall_clock`."""
    if doubt:
        found, _, fix = doubt.partition(": ")
        return warning("wall clock", found, "a time after every date on record", fix)
    if synchronised:
        return good("wall clock", f"synchronised, at most {error_ms:.0f} ms off")
    return warning("wall clock", "not synchronised", "synchronised", "start chronyd, ntpd or systemd-timesyncd")


class _Timex(ctypes.Structure):
    """First fields of ``struct timex`` of adjtimex(2), with space for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("others", ctypes.c_long * 64),
    )


def _adjtimex() -> tuple[bool, float]:
    """Whether the wall clock is synchronised, and its largest error in ms; ``modes`` 0 only reads."""
    found = _Timex()
    if ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(found)) < 0:
        return False, 0.0
    return not found.status & _STA_UNSYNC, found.maxerror * 1e-3


def python() -> DoctorFinding:
    """The Python interpreter."""
    found = f"{platform.python_implementation()} {platform.python_version()} ({platform.python_compiler()})"
    if sysconfig.get_config_var("Py_DEBUG"):
        return warning("python", f"{found}, a debug build", "a release build", "install python3, not python3-dbg")
    if sys.maxsize < 2**32:
        return fails("python", f"{found}, 32 bits", "64 bits", "install a 64 bit Python")
    return good("python", found)


def versions() -> DoctorFinding:
    """Versions of this program and its libraries."""
    known = []
    for package in PACKAGES:
        try:
            known.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            return fails("versions", f"{package} is missing", "every package of rigctl", "pip install rigctl")
    return good("versions", f"rigctl {__version__}, {', '.join(known)}")


def other_daemons(settings: RigSettings | None, base: pathlib.Path) -> DoctorFinding:
    """Daemons of other rigs on this computer, by the pid in their locks; one may use the loop's processor."""
    found, clash = [], []
    for rig, pid in runtime.daemons(base):
        if settings is not None and rig == settings.rig:
            continue
        found.append(f"{rig} (process {pid})")
        cpu = _cpu_of(base / f"rigctl-{rig}")
        if cpu is not None and settings is not None and cpu == settings.loop.cpu:
            clash.append(rig)
    if clash:
        wanted = f"cpu {settings.loop.cpu if settings else ''} for this loop alone"
        return warning(
            "other daemons", f"{', '.join(found)}; {', '.join(clash)} on the same cpu", wanted, "set loop.cpu"
        )
    return good("other daemons", ", ".join(found) or "none")


def _cpu_of(folder: pathlib.Path) -> int | None:
    import msgspec

    try:
        cpu = runtime.Runtime(folder).read_json("active.json")["settings"]["loop"]["cpu"]
    except (OSError, msgspec.MsgspecError, KeyError, TypeError):
        return None
    return cpu if isinstance(cpu, int) else None


def _meminfo(root: pathlib.Path) -> dict[str, int]:
    """/proc/meminfo in KiB."""
    found = {}
    for line in _read(root / "proc/meminfo").splitlines():
        name, _, rest = line.partition(":")
        words = rest.split()
        if words and words[0].isdigit():
            found[name] = int(words[0])
    return found


def _read(file: pathlib.Path) -> str:
    """Text of a file; empty if it cannot be read."""
    try:
        return file.read_text(errors="replace").strip()
    except OSError:
        return ""
