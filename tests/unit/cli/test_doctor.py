"""rigctl doctor: each finding from the kernel's files, no line too long, and the conditions of exit code 1."""

from __future__ import annotations

import json
import os
import pathlib
import re
import socket
from collections.abc import Callable
from typing import Any

import pytest

from rigctl.cli import doctor, doctor_can, doctor_daemon, doctor_host
from rigctl.cli.doctor_host import DoctorFinding, Severity
from rigctl.config import rig_file as config
from rigctl.config.can_section import CanSettings
from rigctl.ipc.runtime_folder import Runtime
from rigctl.model.checks import Check
from tests.builders.paths import ROOT
from tests.conftest import Command

RIG = config.load(ROOT / "config/rig.yaml")
OK, WARNING, FAILS = Severity

KERNEL = {
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "powersave",
    "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "performance",
    "sys/devices/system/cpu/isolated": "1,3-5",
    "sys/kernel/realtime": "1",
    "proc/meminfo": "MemTotal: 4000000 kB\nMemAvailable: 3000000 kB\nSwapTotal: 1024000 kB\nSwapFree: 512000 kB",
}


def computer(folder: pathlib.Path, **changes: str) -> pathlib.Path:
    """A kernel's files; ``changes`` by the end of their names."""
    for name, text in KERNEL.items():
        said = next((new for end, new in changes.items() if name.endswith(end)), text)
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(said + "\n")
    return folder


Look = Callable[[pathlib.Path], DoctorFinding]


@pytest.mark.parametrize(
    ("look", "changes", "severity", "word"),
    [
        (doctor_host.clock_source, {}, OK, "tsc"),
        (doctor_host.clock_source, {"current_clocksource": "hpet"}, WARNING, "hpet"),
        (doctor_host.clock_source, {"current_clocksource": ""}, WARNING, "not shown"),
        (lambda root: doctor_host.governor(root, 1), {}, OK, "performance"),
        (lambda root: doctor_host.governor(root, 0), {}, WARNING, "powersave"),
        (lambda root: doctor_host.governor(root, None), {}, WARNING, "performance, powersave"),
        (lambda root: doctor_host.governor(root, 9), {}, OK, "no frequency scaling"),
        (doctor_host.kernel, {}, OK, "PREEMPT_RT"),
        (doctor_host.kernel, {"realtime": "0"}, WARNING, "#"),
        (lambda root: doctor_host.isolation(root, 4), {}, OK, "1,3-5"),
        (lambda root: doctor_host.isolation(root, 2), {}, WARNING, "1,3-5"),
        (lambda root: doctor_host.isolation(root, 2), {"isolated": ""}, WARNING, "none"),
        (lambda root: doctor_host.isolation(root, None), {}, OK, "asks for none"),
        (doctor_host.memory, {}, OK, "2930 MiB"),
        (doctor_host.memory, {"meminfo": "MemAvailable: 100000 kB"}, FAILS, "98 MiB"),
        (doctor_host.memory, {"meminfo": ""}, WARNING, "not shown"),
        (lambda root: doctor_host.swap(root, locked=True), {}, OK, "500 of 1000 MiB"),
        (lambda root: doctor_host.swap(root, locked=False), {}, WARNING, "500 of 1000 MiB"),
        (lambda root: doctor_host.swap(root, locked=False), {"meminfo": "MemAvailable: 1 kB"}, OK, "none"),
    ],
)
def test_what_the_kernel_shows(
    tmp_path: pathlib.Path, look: Look, changes: dict[str, str], severity: Severity, word: str
) -> None:
    found = look(computer(tmp_path, **changes))
    assert (found.severity, word in found.found) == (severity, True), found
    assert (found.severity is OK) == (not found.wanted)


def test_cpu_lists_are_sets() -> None:
    assert doctor_host.cpus("1,3-5") == {1, 3, 4, 5}
    assert doctor_host.cpus("") == doctor_host.cpus("x,-") == set()


def test_the_wall_clock_is_asked_of_the_kernel() -> None:
    assert doctor_host.clock_sync(True, 12.4, "").found == "synchronised, at most 12 ms off"
    assert doctor_host.clock_sync(False, 0.0, "").severity is WARNING
    wrong = doctor_host.clock_sync(True, 12.4, "the computer's clock reads 1970-01-01: set the clock")
    assert (wrong.severity, wrong.found, wrong.fix) == (
        WARNING, "the computer's clock reads 1970-01-01", "set the clock",
    )  # fmt: skip
    synchronised, error_ms = doctor_host._adjtimex()
    assert isinstance(synchronised, bool)
    assert 0.0 <= error_ms <= 1e9


def test_other_daemons_are_told_and_one_on_the_same_processor_is_a_warning(tmp_path: pathlib.Path) -> None:
    def lock(rig: str, pid: int, cpu: int) -> None:
        folder = tmp_path / f"rigctl-{rig}"
        folder.mkdir()
        (folder / "lock").write_text(f"{pid}\n")
        Runtime(folder).write_json("active.json", {"settings": {"loop": {"cpu": cpu}}})

    assert doctor_host.other_daemons(RIG, tmp_path).found == "none"
    lock(RIG.rig, os.getpid(), 1)
    lock("gone", 2**22 + 1, 1)  # no such process
    assert doctor_host.other_daemons(RIG, tmp_path).found == "none"
    lock("beside", os.getpid(), 0)
    found = doctor_host.other_daemons(RIG, tmp_path)
    assert (found.severity, found.found) == (OK, f"beside (process {os.getpid()})")
    lock("rival", os.getpid(), 1)
    assert doctor_host.other_daemons(RIG, tmp_path).severity is WARNING
    assert doctor_host.other_daemons(None, tmp_path).severity is OK


# Output of `ip -details -json link show` of iproute2 6.
LINK: dict[str, Any] = {
    "ifname": "can0", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "operstate": "UP", "txqlen": 10,
    "link_type": "can",
    "linkinfo": {
        "info_kind": "can",
        "info_data": {
            "state": "ERROR-ACTIVE", "berr_counter": {"tx": 0, "rx": 0}, "restart_ms": 0,
            "bittiming": {"bitrate": 1000000, "sample_point": "0.750"}, "clock": 80000000,
        },
        "info_xstats": {
            "restarts": 0, "bus_error": 0, "arbitration_lost": 3, "error_warning": 0, "error_passive": 0, "bus_off": 0,
        },
    },
}  # fmt: skip


def shown(
    data: dict[str, Any] | None = None, counted: dict[str, int] | None = None, **changes: Any
) -> list[DoctorFinding]:
    about = LINK["linkinfo"]
    info = {
        **about,
        "info_data": {**about["info_data"], **(data or {})},
        "info_xstats": {**about["info_xstats"], **(counted or {})},
    }
    return doctor_can.judge(RIG.can, json.dumps([{**LINK, "linkinfo": info, **changes}]))


def test_a_link_in_order_is_ok_in_every_line() -> None:
    found = shown()
    assert {finding.severity for finding in found} == {OK}
    assert [finding.name for finding in found] == [
        "can link", "can bit rate", "can state", "can restart-ms", "can counters", "can queue",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("found", "name", "severity", "word"),
    [
        (shown(flags=["NOARP"]), "can link", FAILS, "can0 is down"),
        (shown(link_type="ether"), "can link", FAILS, "no CAN interface"),
        (shown({"bittiming": {"bitrate": 500000}}), "can bit rate", FAILS, "500000 bit/s"),
        (shown({"bittiming": {}}), "can bit rate", WARNING, "not shown"),
        (shown({"state": "ERROR-WARNING", "berr_counter": {"tx": 100, "rx": 0}}), "can state", WARNING, "sent 100"),
        (shown({"state": "ERROR-PASSIVE"}), "can state", FAILS, "ERROR-PASSIVE"),
        (shown({"state": "BUS-OFF"}), "can state", FAILS, "BUS-OFF"),
        (shown({"restart_ms": 100}), "can restart-ms", WARNING, "100"),
        (shown(None, {"bus_off": 2}), "can counters", WARNING, "bus off 2"),
        (shown(txqlen=1000), "can queue", WARNING, "1000"),
        (shown(txqlen=3), "can queue", WARNING, "3"),
        (doctor_can.judge(RIG.can, ""), "can link", FAILS, "no interface can0"),
        (doctor_can.judge(RIG.can, "[{}]"), "can link", FAILS, "no CAN interface"),
    ],
)
def test_a_link_out_of_order(found: list[DoctorFinding], name: str, severity: Severity, word: str) -> None:
    (bad,) = [finding for finding in found if finding.severity is not OK]
    assert (bad.name, bad.severity, word in bad.found) == (name, severity, True), bad
    assert bad.wanted


def test_a_virtual_interface_has_no_bit_timing() -> None:
    found = shown(linkinfo={"info_kind": "vcan"})
    assert [finding.name for finding in found if finding.severity is WARNING] == ["can bit rate"]


def test_without_a_kernel_can_it_says_so(tmp_path: pathlib.Path) -> None:
    can = CanSettings(interface="rigsim", channel=str(tmp_path / "bus.sock"), bitrate_bit_s=None)
    (found,) = doctor_can.link(can)
    assert (found.severity, "no kernel CAN" in found.found) == (WARNING, True)
    (absent,) = doctor_can.link(RIG.can.model_copy(update={"channel": "can_not_there"}))
    assert absent.severity in (FAILS, WARNING)  # without iproute2 its state is unknown


def test_a_simulated_rig_that_was_killed_is_none_though_its_sockets_file_is_left(tmp_path: pathlib.Path) -> None:
    can = CanSettings(interface="rigsim", channel=str(tmp_path / "bus.sock"), bitrate_bit_s=None)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as rig:
        rig.bind(can.channel)
        rig.listen(1)
        for _ in range(3):  # more than it has room for
            assert [finding.severity for finding in doctor_can.link(can)] == [OK]
    assert [finding.severity for finding in doctor_can.link(can)] == [WARNING]


# -- the preflight ----------------------------------------------------------------------------------------------


def test_every_check_of_the_preflight_has_a_line() -> None:
    assert set(doctor_daemon.TITLES) == set(Check)


def test_a_running_daemons_preflight_is_shown_line_by_line() -> None:
    told = {"failing": {"DISK": "/data has 1 MiB free: make room, 512"}, "waived": {"REALTIME": "a toy"}}
    state = {"loop_alive": True, "mode": "DISARMED", "lateness_us": None, "preflight": told}
    active = {"version": "0", "settings": {**RIG.model_dump(mode="json"), "safety": {}}}
    found = {finding.name: finding for finding in doctor_daemon.running(state, active, RIG)}
    disk = found[doctor_daemon.TITLES[Check.DISK]]
    assert (disk.severity, disk.found, disk.fix) == (FAILS, "/data has 1 MiB free", "make room, 512")
    assert found[doctor_daemon.TITLES[Check.REALTIME]].severity is WARNING
    assert found["daemon"].severity is WARNING  # of another version
    assert found["rig file"].found == "differs from what runs in safety"
    others = [finding for name, finding in found.items() if name in doctor_daemon.TITLES.values()]
    io = {Check.E_STOP_IO, Check.E_STOP_IO_UNSEEN, Check.ENABLE_IGNORED}
    not_fitted = {*io, Check.SECOND_FORCE, Check.FORCES_DISAGREE}
    assert sum(finding.severity is OK for finding in others) == len(set(Check) - not_fitted) - 2


def test_what_a_silent_device_would_show_is_not_known() -> None:
    """Without a drive status nobody has seen that the drive is off, or that it has no fault."""
    names = ("CELL_STALE", "INCLINATION_STALE", "DRIVE_STALE", "NODE_NOT_OPERATIONAL", "E_STOP_UNSEEN")
    state = {"loop_alive": True, "mode": "DISARMED", "preflight": {"failing": {n: Check[n].words for n in names}}}
    active = {"version": "0", "settings": RIG.model_dump(mode="json")}
    found = {finding.name: finding for finding in doctor_daemon.running(state, active, RIG)}
    for title in (
        "drive: off, brake closed", "drive: no fault", "stroke: stands still", "cell: plausible", "inclination: valid",
        "tension: below its limit", "devices: no emergency", "emergency stop: released",
    ):  # fmt: skip
        assert (found[title].severity, found[title].found.partition(": ")[0]) == (WARNING, "not known"), title
    assert found["drive: off, brake closed"].found == "not known: no fresh drive status"
    assert found["disk: room to write"].severity is OK


def test_a_rigs_io_node_has_lines_of_its_own_and_only_where_one_is_fitted() -> None:
    words = Check.E_STOP_IO_UNSEEN.words
    state = {"loop_alive": True, "mode": "DISARMED", "preflight": {"failing": {"E_STOP_IO_UNSEEN": words}}}
    plain = RIG.model_dump(mode="json")
    titles = [doctor_daemon.TITLES[check] for check in (Check.E_STOP_IO, Check.E_STOP_IO_UNSEEN)]
    for io, shown in ((None, []), ({"e_stop_input": 0}, titles)):
        active = {"version": "0", "settings": {**plain, "io": io}}
        found = {finding.name: finding for finding in doctor_daemon.running(state, active, None)}
        assert [name for name in found if name in titles] == shown
    released, seen = (found[title] for title in titles)
    assert (released.severity, released.found) == (WARNING, f"not known: {seen.found}")
    assert (seen.severity, seen.found) == (FAILS, "emergency stop's input on the I/O node is not seen")
    assert seen.fix == "check the node's power and cable"
    silent = doctor_daemon.running({"loop_alive": False}, active, None)
    assert [finding.name for finding in silent if finding.severity is FAILS] == ["loop", "preflight"]


def test_without_a_daemon_the_files_are_judged_and_the_system_is_tried(tmp_path: pathlib.Path) -> None:
    assert RIG.calibration is not None
    settings = RIG.model_copy(update={"directory": str(tmp_path)})
    found = {finding.name: finding for finding in doctor_daemon.without(settings)}
    assert found["tare: in force"].severity is FAILS
    assert found["margins: accepted"].severity is OK
    assert found["real time: timer slack"].found == "1 ns"
    assert os.sched_getscheduler(0) == os.SCHED_OTHER  # tried in a process of its own


@pytest.mark.parametrize("width", [80, 100])
def test_no_line_is_too_long_and_none_is_lost(width: int) -> None:
    words = " ".join(f"word{i}" for i in range(40))
    finding = DoctorFinding("name", FAILS, words, "wanted thing", words)
    said = doctor.lines(finding, width)
    assert max(map(len, said)) <= width
    assert said[0].startswith("FAILS    name - word0")
    assert " ".join(" ".join(said).split()).count("word39") == 2
    assert doctor.lines(DoctorFinding("name", OK, "fine"), width) == ["ok       name - fine"]
    assert doctor.summary([finding, DoctorFinding("a", OK, "b")]) == "1 ok, 0 warnings, 1 failing"


def test_the_command_without_a_daemon(in_process: Command, tmp_path: pathlib.Path) -> None:
    file = tmp_path / "rig.yaml"
    text = (ROOT / "config/paper_rig.yaml").read_text().replace("rig: paper_rig", "rig: nobody_runs_it")
    text = text.replace("tcp/127.0.0.1:7447", "tcp/127.0.0.1:9").replace("lock_memory: true", "lock_memory: false")
    for name in ("tension_amplifier", "inclinometer", "cylinder_drive"):
        (tmp_path / "eds").mkdir(exist_ok=True)
        (tmp_path / f"eds/{name}.eds").write_bytes((ROOT / f"config/eds/{name}.eds").read_bytes())
    file.write_text(text)
    found = in_process("rigctl", "doctor", file, "--json")
    listed = json.loads(found.stdout)
    assert all(set(row) == {"name", "ok", "severity", "found", "wanted", "fix"} for row in listed)
    assert found.returncode == any(row["severity"] == "fails" for row in listed)
    (daemon,) = [row for row in listed if row["name"] == "daemon"]
    assert (daemon["severity"], "only what needs no daemon" in daemon["found"]) == ("warning", True)
    said = in_process("rigctl", "doctor", "--connect", "tcp/127.0.0.1:9")
    assert said.returncode == 1  # --connect demands a daemon
    assert max(map(len, said.stdout.splitlines())) <= 80
    assert "no preflight" in " ".join(said.stdout.split())


def test_the_queue_is_the_same_wherever_it_is_named() -> None:
    for file in ("docs/install.md", "config/rig.yaml", "tests/guest/inside/guest_rig.py"):
        found = re.findall(r'txqueuelen"?,? "?(\d+)', (ROOT / file).read_text())
        assert found, file
        assert set(found) == {str(doctor_can.QUEUE)}, file
