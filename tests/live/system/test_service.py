"""The Debian package and the services of a rig, in a real systemd (see ``tests/builders/service_computer.py``)."""

from __future__ import annotations

import json
import os
import pathlib
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from tests.builders.paths import ROOT
from tests.builders.service_computer import (
    CAP_IPC_LOCK,
    CAP_SYS_NICE,
    ServiceComputer,
    may_raise_limits,
    service_computer,
)
from tests.builders.waiting import patience_s

RIG = "/usr/share/rigctl/config/paper_rig.yaml"
NAME = "paper_rig"
DAEMON, SIMULATED = f"rigctl@{NAME}.service", f"rigctl-sim@{NAME}.service"
GATEWAY, RECORDER = (f"rigctl-{process}@{NAME}.service" for process in ("gateway", "recorder"))
PAGE = f"rigctl-page@{NAME}.service"
USERS = {DAEMON: "rigctl", SIMULATED: "rigctl-sim", GATEWAY: "rigctl-gateway", RECORDER: "rigctl-recorder"}
PROCESSES = {"rigctl.control": DAEMON, "rigctl.gateway.gateway_process": GATEWAY, "rigctl.recorder": RECORDER}
EXPOSURE = {"rigctl": 20, "rigctl-gateway": 20, "rigctl-recorder": 20, "rigctl-sim": 20, "rigctl-page": 15}
FOLDER = f"/run/rigctl/rigctl-{NAME}"
WRITERS = {"commands": "rigctl-gateway", "desk": "rigctl-gateway", "notes": "rigctl-gateway"}
LENT = 1 << CAP_SYS_NICE | 1 << CAP_IPC_LOCK
WITH_REAL_TIME = (DAEMON, SIMULATED)
OPERATOR, VIEWER, STRANGER = "kim", "lee", "vera"
NEEDS = os.geteuid() == 0 and all(map(shutil.which, ("systemctl", "unshare", "nsenter", "dpkg-deb")))
pytestmark = [
    pytest.mark.machine,
    pytest.mark.skipif(not NEEDS, reason="needs root, systemd and util-linux"),
]


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> list[pathlib.Path]:
    """rigctl and rigctl-sim as `make deb` builds them, in less time and more bytes; RIGCTL_DEB: a folder with both."""
    if given := os.environ.get("RIGCTL_DEB"):
        return in_order(pathlib.Path(given))
    out = tmp_path_factory.mktemp("deb")
    build = [str(ROOT / "deploy/deb"), sys.executable, str(out)]
    subprocess.run(build, check=True, env={**os.environ, "RIGCTL_DEB_LEVEL": "1"}, timeout=patience_s(300.0))
    return in_order(out)


def in_order(folder: pathlib.Path) -> list[pathlib.Path]:
    return [next(folder.glob(f"{name}_*.deb")) for name in ("rigctl", "rigctl-sim")]


def commands_of_a_new_user() -> list[str]:
    """What docs/install.md has a new user give, from a bare system to an armed rig."""
    text = (ROOT / "docs/install.md").read_text()
    first = text.partition("```console\n")[2].partition("```")[0]
    return [line.removeprefix("$ ") for line in first.splitlines() if line.startswith("$ ")]


@pytest.fixture(scope="module")
def computer(packages: list[pathlib.Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceComputer]:
    """A computer on which a new user has given the commands of docs/install.md, and two more users."""
    with service_computer(tmp_path_factory.mktemp("computer")) as made:
        unpack, *others = commands_of_a_new_user()
        assert unpack.startswith("apt install ./")  # which looks for the libraries of Debian's own, here already
        made.done("dpkg", "--install", *map(made.put, packages))
        made.lend_real_time("rigctl@.service", "rigctl-sim@.service")
        for command in others:
            made.insist(*shlex.split(command))
        assert mode(made) in ("HOLD", "FAULT")  # FAULT: a loop on a busy machine tripped since
        made.patient()
        for user in (OPERATOR, VIEWER, STRANGER):
            made.done("useradd", user)
        members = ("--operator", OPERATOR, "--viewer", VIEWER)
        made.done("rigctl", "install", f"/etc/rigctl/{NAME}.yaml", *members)
        yield made


@pytest.fixture(autouse=True)
def _fresh(request: pytest.FixtureRequest) -> Iterator[None]:
    """Each test begins with all services running, and no starts counted."""
    if "computer" in request.fixturenames:
        made: ServiceComputer = request.getfixturevalue("computer")
        made.run("systemctl", "reset-failed")
        made.done("systemctl", "start", SIMULATED, DAEMON)
        made.wait_for(lambda: mode(made))
    yield


def mode(computer: ServiceComputer) -> str:
    """The daemon's mode; empty while it does not answer."""
    answer = computer.run("rigctl", "status", "--json")
    return str(json.loads(answer.stdout)["mode"]) if answer.returncode == 0 else ""


def pid_of(computer: ServiceComputer, unit: str, module: str) -> int:
    """The process of a unit that runs a module; 0 without one."""
    found = [pid for pid, line in computer.processes(unit).items() if module in line]
    return found[0] if found else 0


def given_by(computer: ServiceComputer, user: str, *command: str) -> subprocess.CompletedProcess[str]:
    """A command given by a user of the computer; by a service's user with the groups of that service."""
    groups = [f"--regid={user}", "--init-groups"]
    for unit in [unit for unit, name in USERS.items() if name == user]:
        status = computer.done("cat", f"/proc/{computer.value(unit, 'MainPID')}/status")
        fields = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
        groups = [f"--regid={fields['Gid'].split()[0]}", f"--groups={','.join(fields['Groups'].split())}"]
    return computer.run("setpriv", f"--reuid={user}", *groups, "env", f"USER={user}", *command)


def audited(computer: ServiceComputer) -> list[dict[str, Any]]:
    """The audit log's entries."""
    return [json.loads(line) for line in computer.done("cat", f"/var/lib/rigctl/audit/{NAME}.jsonl").splitlines()]


def disarm(computer: ServiceComputer) -> None:
    """Bring the rig to DISARMED from wherever it is, with nobody's lease left."""
    computer.done("systemctl", "restart", DAEMON)
    computer.wait_for(lambda: mode(computer) == "DISARMED")


def arm(computer: ServiceComputer, user: str = "root") -> None:
    """Arm; what the preflight looks at may not have been looked at yet."""
    said = [""]

    def armed() -> bool:
        given = given_by(computer, user, "rigctl", "arm")
        said[0] = given.stderr
        if "reset clears it" in given.stderr:  # the drive's own stop, after a killed loop
            given_by(computer, user, "rigctl", "reset")
        return given.returncode == 0

    try:
        computer.wait_for(armed)
    except AssertionError:
        raise AssertionError(f"{user} cannot arm: {said[0]}") from None


def compensate(computer: ServiceComputer) -> None:
    disarm(computer)
    arm(computer)
    computer.done("rigctl", "tension", "--wait")
    assert mode(computer) == "COMPENSATING"


def test_three_commands_lead_from_a_bare_system_to_an_armed_rig() -> None:
    unpack, install, arm = commands_of_a_new_user()
    assert unpack == "apt install ./rigctl_0.1.0_amd64.deb ./rigctl-sim_0.1.0_amd64.deb"
    assert (install, arm) == (f"rigctl install {RIG}", "rigctl arm")


def test_the_rigs_package_runs_without_the_other_one(packages: list[pathlib.Path], tmp_path: pathlib.Path) -> None:
    files = [set(subprocess.check_output(["dpkg-deb", "-c", str(one)], text=True).splitlines()) for one in packages]
    carried, added = ({line.split()[5] for line in lines if not line.startswith("d")} for lines in files)
    site = "./usr/lib/rigctl/lib/python3.11/site-packages/"
    for library in ("numba", "llvmlite", "pyarrow", "jinja2"):
        assert f"{site}{library}/__init__.py" in added - carried
    assert not carried & added
    needs = subprocess.check_output(["dpkg-deb", "-f", str(packages[1]), "Depends"], text=True)
    assert needs == "rigctl (= 0.1.0)\n"
    subprocess.run(["dpkg-deb", "-x", str(packages[0]), str(tmp_path)], check=True)
    python = [str(tmp_path / "usr/lib/rigctl/bin/python3"), "-I", "-m"]
    rig = str(tmp_path / "usr/share/rigctl/config/paper_rig.yaml")
    subprocess.run([*python, "rigctl", "check", rig], check=True, capture_output=True)
    refused = subprocess.run([*python, "hil", "serve", rig], capture_output=True, text=True, check=False)
    assert (refused.returncode, refused.stderr.partition(" (")[0]) == (
        2, "python -m hil: needs the extra sim: found no numba",
    )  # fmt: skip
    subprocess.run(["dpkg-deb", "-x", str(packages[1]), str(tmp_path)], check=True)
    subprocess.run([python[0], "-I", "-c", "import hil.plant.kernel, rigctl.report.page, control"], check=True)


def test_no_process_is_roots_and_each_service_has_a_user(computer: ServiceComputer) -> None:
    users: dict[str, set[str]] = {}
    for unit in USERS:
        for pid in computer.processes(unit):
            status = computer.done("cat", f"/proc/{pid}/status")
            fields = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
            lent = 0 if may_raise_limits() or unit not in WITH_REAL_TIME else LENT
            assert {int(fields[name], 16) for name in ("CapEff", "CapPrm", "CapBnd")} == {lent}
            assert fields["NoNewPrivs"] == "1"
            users.setdefault(unit, set()).add(fields["Uid"].split()[0])
    names = {unit: {computer.done("id", "-un", uid).strip() for uid in found} for unit, found in users.items()}
    assert names == {unit: {user} for unit, user in USERS.items()}


OPENS = """
import os, sys
for name in sys.argv[1:]:
    try:
        os.close(os.open(name, os.O_RDWR))
        print(os.path.basename(name), "written")
    except OSError as error:
        print(os.path.basename(name), error.errno)
"""


@pytest.mark.parametrize("user", ["rigctl-gateway", "rigctl-recorder", "rigctl-page", "rigctl-sim", OPERATOR, STRANGER])
def test_the_kernel_lets_each_ring_be_written_by_one_user_alone(computer: ServiceComputer, user: str) -> None:
    rings = computer.done("ls", f"{FOLDER}/rings").split()
    assert {*WRITERS} < {*rings}
    made = given_by(computer, user, "python3", "-c", OPENS, *(f"{FOLDER}/rings/{ring}" for ring in rings))
    written = {ring for ring, _, found in (line.partition(" ") for line in made.stdout.splitlines())
               if found == "written"}  # fmt: skip
    assert len(made.stdout.splitlines()) == len(rings)
    assert written == {ring for ring, writer in WRITERS.items() if writer == user}


def test_what_another_user_may_read_is_the_public_file(computer: ServiceComputer) -> None:
    files = computer.done("find", FOLDER, "-type", "f").split()
    read = {name for name in files if given_by(computer, STRANGER, "cat", name).returncode == 0}
    public = {
        "gateway/public.json",
        "lock",
        *(f"{name}/{name}.pid.json" for name in ("gateway", "recorder")),
    }
    assert read == {f"{FOLDER}/{name}" for name in public}
    assert given_by(computer, STRANGER, "ls", "/var/lib/rigctl").returncode != 0
    assert given_by(computer, OPERATOR, "cat", f"{FOLDER}/gateway/lease.json").returncode != 0
    for socket in (f"{FOLDER}/gateway/gateway.sock", f"{FOLDER}/gateway/command.sock"):
        may = {user: given_by(computer, user, "test", "-w", socket).returncode == 0
               for user in (OPERATOR, VIEWER, STRANGER, "rigctl-page")}  # fmt: skip
        assert may == {OPERATOR: True, VIEWER: True, STRANGER: False, "rigctl-page": True}


def test_no_service_renames_anothers_folder_and_the_gateway_reads_no_recording(computer: ServiceComputer) -> None:
    state = "/var/lib/rigctl"
    folders = computer.done("ls", state).split()
    assert {"audit", "calibration", "recordings", "trips"} <= {*folders}
    for user in ("rigctl", "rigctl-gateway", "rigctl-recorder"):
        for name in folders:
            moved = given_by(computer, user, "mv", f"{state}/{name}", f"{state}/{name}.moved")
            assert moved.returncode != 0, f"{user} renames {name}"
    assert computer.done("find", f"{state}/recordings", "-name", "*.mcap").split()
    for name in ("recordings", "trips", "audit"):
        assert given_by(computer, "rigctl-gateway", "ls", f"{state}/{name}").returncode != 0
        assert given_by(computer, "rigctl", "ls", f"{state}/{name}").returncode == 0


def test_an_operator_of_the_group_commands_and_gives_hold_on_the_local_socket(computer: ServiceComputer) -> None:
    disarm(computer)
    arm(computer, OPERATOR)
    held = given_by(computer, OPERATOR, "rigctl", "hold", "--json")
    assert held.returncode == 0, held.stderr
    assert json.loads(held.stdout)["via"] == "local socket"
    assert given_by(computer, OPERATOR, "rigctl", "disarm").returncode == 0


def test_a_viewer_reads_on_the_socket_and_commands_nothing(computer: ServiceComputer) -> None:
    disarm(computer)
    state = given_by(computer, VIEWER, "rigctl", "status", "--json")
    assert json.loads(state.stdout)["mode"] == "DISARMED"
    assert "not verified" not in state.stderr
    refused = given_by(computer, VIEWER, "rigctl", "arm")
    assert (refused.returncode, refused.stderr) == (
        1, f"rigctl: ARM refused: {VIEWER} reads the rig; its commands are for the group rigctl-operator\n",
    )  # fmt: skip
    assert mode(computer) == "DISARMED"


def test_another_user_reads_telemetry_and_may_hold_but_commands_nothing(computer: ServiceComputer) -> None:
    disarm(computer)
    state = given_by(computer, STRANGER, "rigctl", "status", "--json")
    assert json.loads(state.stdout)["mode"] == "DISARMED"
    refused = given_by(computer, STRANGER, "rigctl", "arm")
    assert refused.returncode == 1
    assert f"this user may not open {FOLDER}/gateway/gateway.sock" in refused.stderr
    assert mode(computer) == "DISARMED"
    arm(computer)
    held = given_by(computer, STRANGER, "rigctl", "hold", "--json")
    assert held.returncode == 0, held.stderr
    assert json.loads(held.stdout)["via"] == "local socket"


def test_systemd_finds_no_fault_and_little_exposure(computer: ServiceComputer) -> None:
    found = computer.run("systemd-analyze", "verify", "--man=no", *USERS, PAGE)
    said = [line for line in found.stderr.splitlines() if "rigctl" in line]
    assert (found.returncode, said) == (0, [])
    for unit, allowed in EXPOSURE.items():
        file = f"/usr/lib/systemd/system/{unit}@.service"
        computer.done("systemd-analyze", "security", "--offline=true", "--no-pager", f"--threshold={allowed}", file)


def test_the_loops_processor_is_kept_from_everybody_else(computer: ServiceComputer) -> None:
    top = pathlib.PurePosixPath("/sys/fs/cgroup")
    if "cpuset" not in computer.done("cat", f"{top}/cgroup.controllers").split():
        pytest.skip("this kernel has the controller cpuset in control groups of version 1, which systemd does not use")
    found = {name: computer.done("cat", f"{top}/{name}/cpuset.cpus.effective").strip()
             for name in ("rigctl.slice", "system.slice", "init.scope")}  # fmt: skip
    everything = computer.done("cat", f"{top}/cpuset.cpus.effective").strip()
    assert found["rigctl.slice"] == everything
    assert found["system.slice"] == found["init.scope"] != everything


def test_the_loop_has_real_time_without_being_root(computer: ServiceComputer) -> None:
    said = computer.journal(DAEMON)
    assert "real time: scheduler: SCHED_FIFO 80" in said
    assert "MiB locked" in said
    assert "WARNING: SCHED_FIFO" not in said
    loop = pid_of(computer, DAEMON, "rigctl.control")
    if may_raise_limits():
        assert computer.done("cat", f"/proc/{loop}/oom_score_adj").strip() == "-900"


def test_settings_state_and_run_time_folder_are_where_they_belong(computer: ServiceComputer) -> None:
    modes = computer.done("stat", "-c", "%n %U %a", "/etc/rigctl", "/var/lib/rigctl", "/run/rigctl")
    assert modes.splitlines() == ["/etc/rigctl root 755", "/var/lib/rigctl root 750", "/run/rigctl rigctl 755"]
    computer.done("test", "-f", "/var/lib/rigctl/audit/paper_rig.jsonl")
    computer.done("test", "-d", "/run/rigctl/rigctl-paper_rig")
    assert not computer.done("find", "/dev/shm", "-name", "rigctl*")
    assert not computer.done("find", "/etc/rigctl", "-not", "-user", "root")
    computer.done("rigctl", "audit", "verify", "/etc/rigctl/paper_rig.yaml")


def test_installing_again_changes_nothing_and_the_daemon_goes_on(computer: ServiceComputer) -> None:
    before = computer.value(DAEMON, "MainPID")
    assert "nothing has changed" in computer.done("rigctl", "install", f"/etc/rigctl/{NAME}.yaml")
    assert computer.value(DAEMON, "MainPID") == before


@pytest.mark.parametrize("module", PROCESSES)
def test_a_process_that_is_killed_comes_back_within_the_same_daemon(computer: ServiceComputer, module: str) -> None:
    unit, name = PROCESSES[module], module.split(".")[1]
    supervisor, killed = computer.value(DAEMON, "MainPID"), pid_of(computer, unit, module)
    before = len(audited(computer))
    computer.done("kill", "-KILL", str(killed))
    computer.wait_for(lambda: pid_of(computer, unit, module) not in (0, killed))
    computer.wait_for(lambda: mode(computer))
    if module == "rigctl.control":
        computer.wait_for(lambda: mode(computer) == "DISARMED")
    assert computer.value(DAEMON, "MainPID") == supervisor

    def noted() -> bool:
        notes = [(entry["what"], entry["details"].get("process")) for entry in audited(computer)[before:]]
        return {("process_ended", name), ("process_started", name)} <= {*notes}

    computer.wait_for(noted)


def test_a_supervisor_that_is_killed_is_started_again_and_comes_up_disarmed(computer: ServiceComputer) -> None:
    killed = computer.value(DAEMON, "MainPID")
    computer.done("kill", "-KILL", killed)
    computer.wait_for(lambda: computer.value(DAEMON, "MainPID") not in ("0", killed))
    computer.wait_for(lambda: mode(computer) == "DISARMED")


def test_a_simulated_rig_that_is_killed_is_started_again(computer: ServiceComputer) -> None:
    killed = computer.value(SIMULATED, "MainPID")
    computer.done("kill", "-KILL", killed)
    computer.wait_for(lambda: computer.value(SIMULATED, "MainPID") not in ("0", killed))


def test_a_stopped_loop_starves_the_watchdog_and_the_daemon_is_started_anew(computer: ServiceComputer) -> None:
    restarts = int(computer.value(DAEMON, "NRestarts"))
    computer.done("kill", "-STOP", str(pid_of(computer, DAEMON, "rigctl.control")))
    computer.wait_for(lambda: int(computer.value(DAEMON, "NRestarts")) > restarts)
    assert "Watchdog timeout" in computer.journal(DAEMON)
    computer.wait_for(lambda: mode(computer) == "DISARMED")


def test_a_daemon_that_keeps_dying_is_left_failed_until_a_person_resets_it(computer: ServiceComputer) -> None:
    def killed() -> bool:
        if (pid := computer.value(DAEMON, "MainPID")) != "0":
            computer.run("kill", "-KILL", pid)
        return computer.value(DAEMON, "ActiveState") == "failed" and computer.value(DAEMON, "SubState") == "failed"

    computer.wait_for(killed)
    assert "Start request repeated too quickly" in computer.journal(DAEMON)
    assert computer.run("systemctl", "start", DAEMON).returncode != 0
    computer.done("systemctl", "reset-failed", DAEMON)
    computer.done("systemctl", "start", DAEMON)
    computer.wait_for(lambda: mode(computer) == "DISARMED")


def test_the_processes_of_other_users_end_with_the_daemon_and_join_the_next(computer: ServiceComputer) -> None:
    before = {unit: computer.value(unit, "MainPID") for unit in (GATEWAY, RECORDER)}
    computer.done("kill", "-KILL", computer.value(DAEMON, "MainPID"))
    computer.wait_for(lambda: all(computer.value(unit, "MainPID") not in ("0", pid) for unit, pid in before.items()))
    computer.wait_for(lambda: mode(computer) == "DISARMED")
    computer.done("systemctl", "stop", DAEMON)
    assert {computer.value(unit, "ActiveState") for unit in before} == {"inactive"}
    assert {computer.value(unit, "Result") for unit in before} == {"success"}
    last = [entry["what"] for entry in audited(computer)[-2:]]
    assert last == ["daemon_stopped", "recorder_stopped"]


def test_a_stop_in_compensating_ends_held_with_the_brake_closed(computer: ServiceComputer) -> None:
    compensate(computer)
    computer.done("systemctl", "stop", DAEMON)
    assert computer.value(DAEMON, "Result") == "success"
    ended = [line for line in computer.journal(DAEMON).splitlines() if "stopped in " in line][-1]
    assert ended.endswith("brake closed")
    assert not computer.done("find", "/run/rigctl", "-mindepth", "1")


def test_it_starts_with_the_computer_and_its_data_are_kept(computer: ServiceComputer) -> None:
    known = computer.done("cat", "/var/lib/rigctl/audit/paper_rig.jsonl")
    computer.switch_off()
    computer.boot()
    computer.wait_for(lambda: mode(computer) == "DISARMED")
    assert computer.done("cat", "/var/lib/rigctl/audit/paper_rig.jsonl").startswith(known)


def test_the_page_is_a_service_of_its_own_and_comes_back(computer: ServiceComputer) -> None:
    folder = "/tmp/with_page"
    page = 'page: {listen: "127.0.0.1:8090"}'
    computer.done("sh", "-c", f"cp -r /etc/rigctl {folder} && echo '{page}' >>{folder}/paper_rig.yaml")
    computer.done("rigctl", "install", f"{folder}/paper_rig.yaml")

    def served() -> bool:
        fetch = "import urllib.request as u; print(u.urlopen('http://127.0.0.1:8090/').status)"
        return computer.run("python3", "-c", fetch).stdout.strip() == "200"

    computer.wait_for(served)
    pid = computer.value(PAGE, "MainPID")
    assert computer.done("stat", "-c", "%U", f"/proc/{pid}").strip() == "rigctl-page"
    computer.done("kill", "-KILL", pid)
    computer.wait_for(lambda: computer.value(PAGE, "MainPID") not in ("0", pid) and served())


def stages() -> dict[str, dict[str, str]]:
    """Last value of each instruction of the container file, by stage."""
    found: dict[str, dict[str, str]] = {}
    text = (ROOT / "deploy/Containerfile").read_text().replace("\\\n", " ")
    for line in text.splitlines():
        word, _, rest = line.partition(" ")
        if word == "FROM":
            found[rest.split()[-1]] = {}
        elif word.isupper():
            found[list(found)[-1]][word] = rest
    return found


def in_container(computer: ServiceComputer, stage: dict[str, str], *more: str) -> tuple[str, ...]:
    """A stage's entry point as its user, with what it prepares made first."""
    if "RUN" in stage:
        computer.done("sh", "-c", stage["RUN"])
    user = stage["USER"]
    group = computer.done("id", "-g", user).strip()
    variables = [stage["ENV"]] if "ENV" in stage else []
    become = ("setpriv", f"--reuid={user}", f"--regid={group}", "--init-groups", "env", "HOME=/tmp", *variables)
    return (*become, *json.loads(stage["ENTRYPOINT"]), *more)


def test_the_containers_entry_points_serve_a_rig_and_its_page(computer: ServiceComputer) -> None:
    made = stages()
    assert list(made) == ["base", "simulated", "page", "viewer"]
    computer.done("systemctl", "stop", DAEMON, SIMULATED)
    start = ("systemd-run", "--collect", "--quiet")
    computer.done(*start, "--unit=container-rig", *in_container(computer, made["simulated"]))
    computer.done(*start, "--unit=container-page", *in_container(computer, made["page"]))
    computer.wait_for(lambda: mode(computer) == "DISARMED")
    fetch = "import urllib.request as u; print(u.urlopen('http://127.0.0.1:8080/').status)"
    computer.wait_for(lambda: computer.run("python3", "-c", fetch).stdout.strip() == "200")
    seen = computer.run("timeout", "-s", "INT", "5", *in_container(computer, made["viewer"]))
    assert "DISARMED" in seen.stdout.replace(" ", "")
    computer.done("systemctl", "stop", "container-page", "container-rig")


def test_a_load_that_the_motor_carries_bars_the_removal_and_is_lowered_by_a_stop(computer: ServiceComputer) -> None:
    disarm(computer)
    computer.done("rigctl", "target", "100")

    def tensioned() -> bool:
        """Given again while a busy machine trips the rig."""
        for word in ("reset", "arm"):
            computer.run("rigctl", word)
        return computer.run("rigctl", "tension", "--wait").returncode == 0

    computer.wait_for(tensioned)
    computer.done("rigctl", "hold")
    beside_the_bus = ("-p", "PrivateTmp=yes", "-p", f"JoinsNamespaceOf={SIMULATED}")
    inject = ("/usr/lib/rigctl/bin/python3", "-m", "hil", "inject", f"/etc/rigctl/{NAME}.yaml", "brake_slips_parking")
    computer.done("systemd-run", "--wait", "--quiet", *beside_the_bus, *inject)
    computer.wait_for(lambda: computer.run("rigctl", "carry", "600").returncode == 0)
    computer.wait_for(lambda: "carries" in json.loads(computer.done("rigctl", "status", "--json"))["flag_names"])
    for removal in (f"rigctl uninstall {NAME}", "dpkg --force-depends --remove rigctl"):
        refused = computer.run(*removal.split())
        assert refused.returncode != 0
        assert "rigctl: paper_rig: the motor carries a load of " in refused.stderr, refused.stderr
    assert computer.value(DAEMON, "ActiveState") == "active"
    computer.done("systemctl", "stop", DAEMON)
    said = computer.journal(DAEMON)
    assert "the load is lowered" in said
    assert "stopped in FAULT" in said.partition("the load is lowered")[2]
    assert computer.value(DAEMON, "Result") == "success"
    computer.done("systemctl", "restart", SIMULATED)  # with a brake that holds


def test_uninstall_stops_the_services_and_keeps_settings_and_data(computer: ServiceComputer) -> None:
    computer.done("rigctl", "uninstall", "paper_rig")
    assert computer.value(DAEMON, "ActiveState") == "inactive"
    computer.done("test", "-f", "/etc/rigctl/paper_rig.yaml")
    computer.done("test", "-f", "/var/lib/rigctl/audit/paper_rig.jsonl")
    assert computer.run("test", "-e", "/etc/systemd/system/rigctl@paper_rig.service.d").returncode != 0
    assert not computer.done("sh", "-c", "find /etc/systemd/system -name '*rigctl*' -not -name 'rigctl*@.service.d'")
    computer.done("rigctl", "install", f"/etc/rigctl/{NAME}.yaml", "--no-start")
