"""Why no daemon answers, with real processes: six causes, six texts of `status`, and what `watch` shows meanwhile."""

from __future__ import annotations

import json
import os
import pathlib
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

import pytest

from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.roles import Role
from rigctl.ipc.public_slot import PUBLIC_SLOT
from rigctl.ipc.runtime_folder import Runtime
from tests.builders import daemons
from tests.builders.paths import ROOT
from tests.builders.waiting import until

GATEWAY = "rigctl.gateway.gateway_process"


def gateway(file: pathlib.Path) -> int:
    return int(until(lambda: next(iter(daemons.processes_with(GATEWAY, f"rigctl-{daemons.name_of(file)}")), 0)))


def status(*words: str, file: pathlib.Path | None = None) -> tuple[int, str]:
    """Exit code and the one text, blanks and line ends as single blanks; it has at most eight lines of 80 columns."""
    done = daemons.rigctl("status", *words, file=file)
    assert "Traceback" not in done.stderr
    lines = done.stdout.splitlines()
    if done.returncode and "unanswered" not in done.stdout and "KEEP OUT" not in done.stdout:
        assert len(lines) <= 8, done.stdout
        assert all(len(line) <= 80 for line in lines), done.stdout
    return done.returncode, " ".join((done.stdout + done.stderr).split())


def repeated(act: Callable[[], None], file: pathlib.Path) -> str:
    """The text after ``act``, which is repeated where the supervisor was faster than the command."""
    texts: list[str] = []

    def unanswered() -> bool:
        act()
        code, text = status(file=file)
        texts.append(text)
        return code == 1

    until(unanswered)
    return texts[-1]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[pathlib.Path]:
    folder = tmp_path_factory.mktemp("unanswered")
    file = daemons.slow_rig_file(folder)
    with daemons.simulated_rig(file, folder / "rig.log"), daemons.daemon(file, folder / "daemon.log"):
        armed = daemons.rigctl("arm", file=file)
        assert armed.returncode == 0, armed.stderr
        yield file


@pytest.mark.smoke
def test_a_dead_gateway_leaves_mode_and_hold(rig: pathlib.Path) -> None:
    slot = Runtime.of(daemons.name_of(rig)).place(PUBLIC_SLOT).stat()
    assert (stat.S_IMODE(slot.st_mode), slot.st_size) == (0o644, 64)
    text = repeated(lambda: os.kill(gateway(rig), signal.SIGKILL), rig)
    for words in (
        "nothing is published, no command but HOLD is taken",
        "mode HOLD",
        "tension ",
        "load the loop runs on: ",
        "2 rigctl hold works",
    ):
        assert words in text
    held = json.loads(daemons.rigctl("hold", "--json", file=rig).stdout)
    assert (held["accepted"], held["via"]) == (True, "local socket")
    until(lambda: daemons.state(rig))


def test_a_hung_gateway_is_named(rig: pathlib.Path) -> None:
    pids: list[int] = []

    def stop() -> None:
        pids.append(gateway(rig))
        os.kill(pids[-1], signal.SIGSTOP)

    text = repeated(stop, rig)
    assert f"gateway it hangs, or is just starting (process {pids[-1]})" in text or "gateway it has ended" in text
    assert "mode HOLD" in text
    until(lambda: daemons.state(rig))


def test_json_has_the_cause_and_what_the_slot_shows(rig: pathlib.Path) -> None:
    def unanswered() -> dict[str, object]:
        os.kill(gateway(rig), signal.SIGKILL)
        done = daemons.rigctl("status", "--json", file=rig)
        return dict(json.loads(done.stdout)) if done.returncode == 1 else {}

    shown = until(unanswered)
    assert (shown["unanswered"]["cause"], shown["mode"], shown["fault"]) == ("GATEWAY", "HOLD", None)
    assert isinstance(shown["age_ms"], float)
    until(lambda: daemons.state(rig))


def test_watch_shows_the_slot_while_the_gateway_is_away(rig: pathlib.Path) -> None:
    words = [sys.executable, "-m", "rigctl", "watch", "--connect", daemons.endpoint(rig)]
    watching = subprocess.Popen(words, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert watching.stdout is not None
        assert "HOLD" in watching.stdout.readline()
        os.kill(gateway(rig), signal.SIGSTOP)  # killed by the supervisor after 5 s
        line = next(line for line in watching.stdout if line.startswith("no data for "))
        assert "gateway: it hangs, or is just starting (process " in line or "gateway: it has ended: " in line
        assert "mode: HOLD " in line
        assert any("HOLD" in line and "no data" not in line for line in watching.stdout)
    finally:
        watching.kill()
        watching.communicate()


def test_another_port_is_named_with_the_daemons_own(rig: pathlib.Path) -> None:
    where = f"tcp/127.0.0.1:{daemons.free_port()}"
    code, text = status("--connect", where, "--rig", daemons.name_of(rig))
    assert code == 1
    assert f"port nothing listens at {where}; this computer's daemon: {daemons.name_of(rig)} at" in text
    assert "mode HOLD" in text
    assert f"1 rigctl status --connect {daemons.endpoint(rig)}" in text


def test_a_refused_key_is_not_allowed_and_shows_the_loop_of_this_computer(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, now = daemons.slow_rig_file(tmp_path), datetime.now(UTC)
    daemons.with_certificates(file)
    other = KeyIssuer(tmp_path / "other", now)
    other.init([])
    other.add("zoe", Role.VIEWER)
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, tmp_path / "daemon.log"):
        where = ("--connect", daemons.endpoint(file), "--rig", daemons.name_of(file))
        monkeypatch.setenv("RIGCTL_KEY", str(other.folder.issued("zoe")))
        code, text = status(*where)
        assert code == 1
        assert "access the key of zoe is not of the rig at " in text
        monkeypatch.setenv("RIGCTL_KEY", str(daemons.key_of("vera", file)))
        until(lambda: status(*where)[0] == 0)
        KeyIssuer(tmp_path / "keys", now).revoke("vera")

        def refused() -> str:
            code, text = status(*where)
            return text if code == 1 and " access " in text else ""

        text = until(refused)  # by the gateway that is started anew with the new access list
        assert "the key of vera, and shows it no rig: it is revoked" in text
        assert "mode DISARMED" in text


def test_a_start_says_what_it_waits_for_with_and_without_its_gateway(tmp_path: pathlib.Path) -> None:
    """Status had shown NO LOOP and "start the daemon anew". The simulated rig is stopped: no device answers."""
    file, log = daemons.slow_rig_file(tmp_path, {"can": {"boot_wait_s": 120.0}}), tmp_path / "daemon.log"
    seen: list[str] = []

    def starting(words: str) -> bool:
        seen.append(status(file=file)[1])
        return words in seen[-1]

    waits_for = "waits for: cylinder drive (node 4)"
    with daemons.simulated_rig(file, tmp_path / "rig.log") as served:
        served.send_signal(signal.SIGSTOP)
        with daemons.process("rigctl", "run", str(file), log=log):
            try:
                until(lambda: starting(f"loop the daemon starts, and {waits_for}"), log=log)  # by the gateway
                assert "mode STARTING" in seen[-1]
                assert not any("NO LOOP" in text or "start the daemon anew" in text for text in seen)
                os.kill(gateway(file), signal.SIGSTOP)
                assert starting(f"start the daemon starts, and {waits_for}"), seen[-1]  # by the slot
                assert "mode STARTING" in seen[-1]
            finally:
                served.send_signal(signal.SIGCONT)
            os.kill(gateway(file), signal.SIGCONT)
            until(lambda: daemons.mode(file) == "DISARMED", log=log)


def test_a_killed_supervisor_is_a_dead_loop(tmp_path: pathlib.Path) -> None:
    file, log = daemons.slow_rig_file(tmp_path), tmp_path / "daemon.log"
    with daemons.simulated_rig(file, tmp_path / "rig.log"), daemons.daemon(file, log) as daemon:
        daemon.kill()
        daemon.wait()
        until(lambda: not daemons.processes_with("rigctl.", f"rigctl-{daemons.name_of(file)}"))
        code, text = status(file=file)
    assert code == 1
    assert "loop the supervisor has been killed, and a loop without it ends" in text
    assert "mode DISARMED" in text
    assert "rigctl doctor, then start the daemon anew" in text
    for left in Runtime.of(daemons.name_of(file)).directory.iterdir():
        left.unlink()
    Runtime.of(daemons.name_of(file)).directory.rmdir()


def test_a_hung_loop_and_gateway_are_a_dead_loop(rig: pathlib.Path) -> None:
    def stop() -> None:
        for module in ("rigctl.control", GATEWAY):
            for pid in daemons.processes_with(module, f"rigctl-{daemons.name_of(rig)}"):
                os.kill(pid, signal.SIGSTOP)

    text = repeated(stop, rig)
    assert "loop no records: it has ended, or hangs" in text, text
    assert "tension not known" in text
    until(lambda: daemons.mode(rig) == "DISARMED")
