"""The Debian package and the services of a rig, in a real systemd (see ``tests/builders/service_computer.py``)."""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.builders.paths import ROOT
from tests.builders.service_computer import (
    CAP_IPC_LOCK,
    CAP_SYS_NICE,
    ServiceComputer,
    may_raise_limits,
    service_computer,
)

RIG = "/usr/share/rigctl/config/paper_rig.yaml"
DAEMON, SIMULATED = "rigctl@paper_rig.service", "rigctl-sim@paper_rig.service"
CHILDREN = ("rigctl.control", "rigctl.hold", "rigctl.gateway.gateway_process", "rigctl.recorder")
LENT = 1 << CAP_SYS_NICE | 1 << CAP_IPC_LOCK
PAGE = "rigctl-page@paper_rig.service"
NEEDS = os.geteuid() == 0 and all(map(shutil.which, ("systemctl", "unshare", "nsenter", "dpkg-deb")))
pytestmark = [
    pytest.mark.skipif(not NEEDS, reason="needs root, systemd and util-linux"),
    pytest.mark.timeout(900),
]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The package as `make deb` builds it, in less time and more bytes; RIGCTL_DEB names one that exists."""
    if given := os.environ.get("RIGCTL_DEB"):
        return pathlib.Path(given)
    out = tmp_path_factory.mktemp("deb")
    build = [str(ROOT / "deploy/deb"), sys.executable, str(out)]
    subprocess.run(build, check=True, env={**os.environ, "RIGCTL_DEB_LEVEL": "1"}, timeout=800)
    return next(out.glob("*.deb"))


@pytest.fixture(scope="module")
def computer(package: pathlib.Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceComputer]:
    """A computer on which a new user has given the three commands of docs/install.md."""
    with service_computer(tmp_path_factory.mktemp("computer")) as made:
        made.done("dpkg", "--install", made.put(package))
        made.lend_real_time("rigctl@.service", "rigctl-sim@.service")
        made.done("rigctl", "install", RIG)
        made.done("rigctl", "arm")
        yield made


@pytest.fixture(autouse=True)
def _fresh(request: pytest.FixtureRequest) -> Iterator[None]:
    """Each test begins with both services running, and no starts counted."""
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


def compensate(computer: ServiceComputer) -> None:
    if mode(computer) == "FAULT":
        computer.wait_for(lambda: computer.run("rigctl", "reset").returncode == 0)
    if mode(computer) == "DISARMED":
        computer.wait_for(lambda: computer.run("rigctl", "arm").returncode == 0)
    computer.done("rigctl", "tension", "--wait")
    assert mode(computer) == "COMPENSATING"


def test_no_process_is_roots_and_each_service_has_a_user(computer: ServiceComputer) -> None:
    users: dict[str, set[str]] = {}
    for unit in (DAEMON, SIMULATED):
        for pid in computer.processes(unit):
            status = computer.done("cat", f"/proc/{pid}/status")
            fields = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
            assert {int(fields[name], 16) for name in ("CapEff", "CapPrm", "CapBnd")} == {
                0 if may_raise_limits() else LENT
            }
            assert fields["NoNewPrivs"] == "1"
            users.setdefault(unit, set()).add(fields["Uid"].split()[0])
    names = {unit: {computer.done("id", "-un", uid).strip() for uid in found} for unit, found in users.items()}
    assert names == {DAEMON: {"rigctl"}, SIMULATED: {"rigctl-sim"}}


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
    assert modes.splitlines() == ["/etc/rigctl root 755", "/var/lib/rigctl rigctl 750", "/run/rigctl rigctl 700"]
    computer.done("test", "-f", "/var/lib/rigctl/audit/paper_rig.jsonl")
    computer.done("test", "-d", "/run/rigctl/rigctl-paper_rig")
    assert not computer.done("find", "/dev/shm", "-name", "rigctl*")
    assert not computer.done("find", "/etc/rigctl", "-not", "-user", "root")
    computer.done("rigctl", "audit", "verify", "/etc/rigctl/paper_rig.yaml")


def test_installing_again_changes_nothing_and_the_daemon_goes_on(computer: ServiceComputer) -> None:
    before = computer.value(DAEMON, "MainPID")
    assert "nothing has changed" in computer.done("rigctl", "install", RIG)
    assert computer.value(DAEMON, "MainPID") == before


@pytest.mark.parametrize("module", CHILDREN)
def test_a_process_that_is_killed_comes_back_within_the_same_daemon(computer: ServiceComputer, module: str) -> None:
    supervisor, killed = computer.value(DAEMON, "MainPID"), pid_of(computer, DAEMON, module)
    computer.done("kill", "-KILL", str(killed))
    computer.wait_for(lambda: pid_of(computer, DAEMON, module) not in (0, killed))
    computer.wait_for(lambda: mode(computer))
    if module == "rigctl.control":
        computer.wait_for(lambda: mode(computer) == "DISARMED")
    assert computer.value(DAEMON, "MainPID") == supervisor


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
    assert computer.value(DAEMON, "Result") == "start-limit-hit"
    assert computer.run("systemctl", "start", DAEMON).returncode != 0
    computer.done("systemctl", "reset-failed", DAEMON)
    computer.done("systemctl", "start", DAEMON)
    computer.wait_for(lambda: mode(computer) == "DISARMED")


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
    computer.done("sh", "-c", f"cp -r /usr/share/rigctl/config {folder} && echo '{page}' >>{folder}/paper_rig.yaml")
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


def test_uninstall_stops_the_services_and_keeps_settings_and_data(computer: ServiceComputer) -> None:
    computer.done("rigctl", "uninstall", "paper_rig")
    assert computer.value(DAEMON, "ActiveState") == "inactive"
    computer.done("test", "-f", "/etc/rigctl/paper_rig.yaml")
    computer.done("test", "-f", "/var/lib/rigctl/audit/paper_rig.jsonl")
    assert computer.run("test", "-e", "/etc/systemd/system/rigctl@paper_rig.service.d").returncode != 0
    assert not computer.done("sh", "-c", "find /etc/systemd/system -name '*rigctl*' -not -name 'rigctl*@.service.d'")
    computer.done("rigctl", "install", RIG, "--no-start")
