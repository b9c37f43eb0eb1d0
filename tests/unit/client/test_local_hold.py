"""HOLD past the network, from the client's side: which daemon is meant, what is said, and a daemon of before."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import pwd
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from rigctl.client import local_hold
from rigctl.client.local_daemons import local_daemons, same_endpoint
from rigctl.config import layout
from rigctl.control.bus.hold_sockets import Hold, HoldSockets
from rigctl.ipc import runtime_folder as folders
from rigctl.ipc.folder_places import PUBLIC
from rigctl.ipc.hold_socket import HoldAnswer
from rigctl.ipc.runtime_folder import ACTIVE, PUBLIC_MODE, Runtime
from rigctl.model.faults import Fault
from rigctl.model.verbs import Refusal
from tests.builders.operators import KIM
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

ENDPOINT = "tcp/127.0.0.1:7447"


@pytest.fixture
def runtime(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> Runtime:
    monkeypatch.setattr(folders, "BASE", tmp_path)
    monkeypatch.setattr(layout, "SHARED_MEMORY", tmp_path)
    found = Runtime.of("paper_rig")
    found.claim()
    found.write_json(ACTIVE, {"settings": {"rig": "paper_rig", "telemetry": {"listen": ENDPOINT}}})
    return found


def test_who_may_not_read_the_settings_finds_the_daemon_by_its_public_file(runtime: Runtime) -> None:
    """An operator of the installed service."""
    runtime.place(ACTIVE).unlink()
    assert local_hold.held_here(ENDPOINT, None) == []
    runtime.write_json(PUBLIC, {"rig": "paper_rig", "listen": ENDPOINT})
    (found,) = local_hold.held_here(ENDPOINT, None)
    assert found.place.directory == runtime.directory


@contextlib.contextmanager
def loop(runtime: Runtime, answer: HoldAnswer | None) -> Iterator[list[Hold]]:
    """A loop that takes HOLD and gives an answer, or none; yields what it took."""
    sockets, taken, over = HoldSockets.of(runtime), list[Hold](), threading.Event()

    def tick() -> None:
        t_ns = 0
        while not over.wait(0.001):
            t_ns += 1_000_000
            if (hold := sockets.take(t_ns)) is not None:
                taken.append(hold)
                if answer is not None:
                    sockets.answer(t_ns, answer)

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        yield taken
    finally:
        over.set()
        thread.join()
        sockets.close()


def test_the_answer_is_the_gateways(runtime: Runtime) -> None:
    with loop(runtime, HoldAnswer(88, True, 0, 0, 0, 52.3, 300.04, "HOLD")) as taken:
        answer = local_hold.hold(ENDPOINT, None, "kim", patience_s())
    assert [hold.operator for hold in taken] == ["kim"]
    assert answer == {
        "accepted": True, "verb": "hold", "operator": KIM, "mode": "HOLD", "t_ns": 88, "value": 300.04,
        "text": "HOLD: stroke held at 52.30 mm, tension 300.0 N", "via": "local socket",
    }  # fmt: skip


def test_the_loops_refusal_is_the_answer(runtime: Runtime) -> None:
    refused = HoldAnswer(88, False, Refusal.WRONG_MODE, 0, Fault.NONE, 0.0, float("nan"), "DISARMED")
    with loop(runtime, refused):
        answer = local_hold.hold(ENDPOINT, None, "kim", patience_s())
    assert answer is not None
    assert (answer["accepted"], answer["reason"], answer["mode"]) == (False, "wrong_mode", "DISARMED")
    assert answer["text"] == "HOLD refused: hold is not possible in DISARMED: arm first"


def silent() -> bool:
    answer = local_hold.hold(ENDPOINT, None, "kim", 0.2)
    return answer is not None and (answer["accepted"], answer["reason"]) == (False, "no_answer")


def test_a_loop_that_does_not_answer_is_no_other_ways_matter(runtime: Runtime) -> None:
    with loop(runtime, None) as taken:
        assert silent()
        until(lambda: taken)
    assert [hold.operator for hold in taken] == ["kim"]
    assert silent()  # it has ended


@pytest.mark.usefixtures("runtime")
def test_a_daemon_of_another_version_is_one_line_that_names_the_other_ways() -> None:
    """It has no socket that this version gives HOLD to."""
    answer = local_hold.hold(ENDPOINT, None, "kim", 0.2)
    assert answer is not None
    assert (answer["accepted"], answer["reason"]) == (False, "no_answer")
    assert answer["text"] == (
        "HOLD: the loop of paper_rig has no socket for HOLD: it is about to start, or of another version; that "
        "version's page and rigctl give it HOLD; the emergency stop needs no program"
    )


@pytest.mark.parametrize(
    ("asked", "listen", "same"),
    [
        (ENDPOINT, ENDPOINT, True),
        ("tcp/localhost:7447", ENDPOINT, True),
        ("tcp/127.0.0.1:7447", "tcp/0.0.0.0:7447", True),
        ("tcp/[::1]:7447", "tcp/[::]:7447", True),
        ("tcp/127.0.0.1:7448", ENDPOINT, False),  # may be a tunnel to another computer
        ("tcp/192.168.1.10:7447", "tcp/0.0.0.0:7447", False),
        ("tcp/127.0.0.1:7447", "tcp/192.168.1.10:7447", False),
        ("quic/127.0.0.1:7447", ENDPOINT, False),
    ],
)
def test_only_the_daemon_at_the_endpoint_asked_for_is_meant(asked: str, listen: str, same: bool) -> None:
    assert same_endpoint(asked, listen) is same


def test_the_folder_is_found_by_endpoint_rig_and_owner(runtime: Runtime, monkeypatch: pytest.MonkeyPatch) -> None:
    def found(endpoint: str, rig: str | None) -> list[pathlib.Path]:
        return [one.place.directory for one in local_hold.held_here(endpoint, rig)]

    assert found(ENDPOINT, None) == found(ENDPOINT, "paper_rig") == [runtime.directory]
    assert found(ENDPOINT, "north_rig") == found("tcp/10.0.0.1:7447", None) == []
    joined = {"rig": "paper_rig", "telemetry": {"listen": ENDPOINT, "join": ["tcp/10.0.0.1:7447"]}}
    runtime.write_json(ACTIVE, {"settings": joined})
    assert found("tcp/10.0.0.1:7447", "paper_rig") == [runtime.directory]
    assert local_daemons()
    mine = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    assert found(ENDPOINT, None) == [runtime.directory]  # another user's, to which anybody gives HOLD
    assert local_daemons() == []
    runtime.directory.chmod(0o777)
    assert found(ENDPOINT, None) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to make another user's folder")
def test_of_other_users_daemons_every_one_that_is_meant_gets_the_hold_and_is_named_by_its_user(
    runtime: Runtime,
) -> None:
    """Anybody can make a folder that claims to be the one meant; here the loops that answer are of another user."""
    his = Runtime(runtime.directory.with_name("rigctl-a_false_one"))
    his.directory.mkdir(mode=0o711)
    his.write_json(PUBLIC, {"rig": "paper_rig", "listen": ENDPOINT}, PUBLIC_MODE)
    (his.directory / "lock").write_text(str(os.getpid()))
    answer = HoldAnswer(88, True, 0, 0, 0, 52.3, 300.04, "HOLD")
    with loop(runtime, answer) as taken, loop(his, answer) as stolen:
        for one, owner in ((runtime, 65533), (his, 65534)):
            os.chown(one.directory, owner, owner)
        found = local_hold.hold(ENDPOINT, "paper_rig", "kim", patience_s())
    assert found is not None
    assert not found["accepted"]
    assert found["text"].startswith("HOLD: the loop of paper_rig does not answer")
    assert found["text"].endswith("(the daemon is of nobody)")
    assert [hold.operator for hold in (*taken, *stolen)] == ["kim"] * 2


@pytest.mark.parametrize("active", [b"", b"[" * 100_000, b"7", b'{"settings": 7}', b'{"settings": {"telemetry": []}}'])
def test_a_folder_that_cannot_be_read_is_nobodys(runtime: Runtime, active: bytes) -> None:
    (runtime.directory / ACTIVE).write_bytes(active)
    assert local_hold.held_here(ENDPOINT, None) == []


IN_NAMESPACES = """
import ctypes, json, os, pathlib, pwd, sys
from rigctl.client import local_hold
from rigctl.config import layout
layout.SHARED_MEMORY, uid = pathlib.Path(sys.argv[1]), int(sys.argv[2])
libc = ctypes.CDLL(None, use_errno=True)
os.setgroups([])
os.setgid(uid)
os.setuid(uid)
libc.prctl(4, 1, 0, 0, 0)  # PR_SET_DUMPABLE: /proc/self is this user's again
for outer in [uid, 0][: int(sys.argv[3])]:
    if libc.unshare(0x10000000):  # CLONE_NEWUSER
        sys.exit(f"no user namespace here: {os.strerror(ctypes.get_errno())}")
    for name, text in (("setgroups", "deny"), ("uid_map", f"0 {outer} 1"), ("gid_map", f"0 {outer} 1")):
        pathlib.Path(f"/proc/self/{name}").write_text(text)
    assert os.geteuid() == 0
print(json.dumps(local_hold.hold("tcp/127.0.0.1:7447", None, "kim", float(sys.argv[4]))))
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to be another user")
@pytest.mark.parametrize("depth", [0, 1, 2])
def test_in_a_user_namespace_hold_goes_to_the_socket_of_the_kernels_user(
    monkeypatch: pytest.MonkeyPatch, depth: int
) -> None:
    """``unshare -Ur rigctl hold``, also in one of its own: the process is user 0 there, and nobody for the loop."""
    base = layout.SHARED_MEMORY / f"rigctl-test-namespace-{os.getpid()}"
    base.mkdir(mode=0o755)
    monkeypatch.setattr(folders, "BASE", base)
    found, uid = Runtime.of("paper_rig"), pwd.getpwnam("nobody").pw_uid
    found.claim()
    found.write_json(PUBLIC, {"rig": "paper_rig", "listen": ENDPOINT}, PUBLIC_MODE)
    try:
        with loop(found, HoldAnswer(88, True, 0, 0, 0, 52.3, 300.04, "HOLD")) as taken:
            words = [sys.executable, "-c", IN_NAMESPACES, str(base), str(uid), str(depth), str(patience_s())]
            done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=False)
    finally:
        found.remove()
        base.rmdir()
    if "no user namespace here" in done.stderr:
        pytest.skip(done.stderr.strip())
    answer = json.loads(done.stdout)
    assert (answer["accepted"], answer["operator"]) == (True, "kim (nobody)"), answer
    assert [(hold.operator, hold.uid) for hold in taken] == [("kim", uid)]
