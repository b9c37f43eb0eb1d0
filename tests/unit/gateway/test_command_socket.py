"""The command socket with processes of other users, clients that do not read, and connections without end."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import pwd
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from rigctl.client.command_connection import CommandConnections
from rigctl.client.mailbox import Mailbox
from rigctl.config import layout
from rigctl.gateway import command_socket
from rigctl.gateway.command_server import Giver, Reply
from rigctl.gateway.command_socket import ALL_BUSY, NOT_ALLOWED, PER_USER, TOO_MANY, CommandSocket
from rigctl.gateway.local_peer import peer_of
from rigctl.ipc import writers
from rigctl.ipc.folder_places import COMMAND_SOCKET
from rigctl.ipc.runtime_folder import FolderError, Runtime
from rigctl.wire.socket_message import LONGEST_ANSWER, SocketAnswer, SocketQuestion, Splitter, packed, unpacked
from tests.builders.operators import USER
from tests.builders.waiting import patience_s, until

OWN = os.geteuid()
ROOT = pytest.mark.skipif(OWN != 0, reason="needs root, to run processes of other users")
NOBODY = pwd.getpwnam("nobody").pw_uid
OPERATORS, VIEWERS = 4242, 4243
STATE = b'{"mode":"HOLD"}'
ASK = """
import os, pathlib, sys
from rigctl.client.command_connection import CommandConnections
place, uid, groups = pathlib.Path(sys.argv[1]), int(sys.argv[2]), [int(one) for one in sys.argv[3:]]
os.setgroups(groups); os.setgid(uid); os.setuid(uid)
try:
    print(CommandConnections(place).ask("cmd/arm", b"{}", 60.0))
except OSError as error:
    print(error.strerror)
"""


class Gateway:
    """A command socket whose commands are answered at once, but for ``release``, which waits for `answer`."""

    def __init__(self, runtime: Runtime) -> None:
        self.given: list[tuple[str, bytes | None, Giver]] = []
        self.waiting: list[Reply] = []
        self.state = STATE
        self.runtime = runtime
        self.place = runtime.place(COMMAND_SOCKET)
        self.socket = CommandSocket(runtime, self.take, lambda: self.state)
        self.socket.open()

    def take(self, name: str, payload: bytes | None, giver: Giver, reply: Reply) -> None:
        self.given.append((name, payload, giver))
        if name == "release":
            self.waiting.append(reply)
        elif name == "target":
            reply({"accepted": True, "text": (payload or b"").decode()})
        else:
            reply({"accepted": name != "tension", "text": name})

    def connected(self) -> socket.socket:
        own = socket.socket(socket.AF_UNIX)
        own.settimeout(patience_s())
        until(lambda: own.connect_ex(str(self.place)) == 0)  # the queue of those that connect may be full
        return own


def asked(own: socket.socket, number: int, key: str = "cmd/arm", **more: Any) -> None:
    own.sendall(packed(SocketQuestion(number, key, **more), b"{}"))


def answered(own: socket.socket) -> tuple[SocketAnswer, bytes]:
    splitter = Splitter(LONGEST_ANSWER)
    while (found := splitter.take()) is None:
        data = own.recv(4)[:4] if not splitter._held else own.recv(1)
        assert data, "the connection has ended"
        splitter.feed(data)
    return unpacked(found, SocketAnswer)


def ended(own: socket.socket) -> bool:
    with contextlib.suppress(ConnectionResetError):
        return own.recv(1) == b""
    return True


@pytest.fixture
def runtime(tmp_path: pathlib.Path) -> Iterator[Runtime]:
    found = Runtime.of("paper_rig", tmp_path)
    found.claim()
    yield found
    found.remove()


@pytest.fixture
def gateway(runtime: Runtime) -> Iterator[Gateway]:
    found = Gateway(runtime)
    yield found
    found.socket.close()


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Iterator[Gateway]:
    """In a folder as of the installed service, whose groups are ``OPERATORS`` and ``VIEWERS``."""
    base = layout.SHARED_MEMORY / f"rigctl-test-command-{os.getpid()}"
    base.mkdir(mode=0o755)
    monkeypatch.setattr(layout, "RUN", base)
    groups = {writers.OPERATORS: OPERATORS, writers.VIEWERS: VIEWERS}
    monkeypatch.setattr(writers, "group_number", lambda name: groups.get(name, -1))
    runtime = Runtime.of("paper_rig", base)
    runtime.claim()
    found = Gateway(runtime)
    yield found
    found.socket.close()
    runtime.remove()
    base.rmdir()


def by(uid: int, gateway: Gateway, *groups: int) -> str:
    words = [sys.executable, "-c", ASK, str(gateway.place), str(uid), *map(str, groups)]
    return subprocess.run(words, capture_output=True, text=True, timeout=patience_s(), check=True).stdout.strip()


def test_a_command_comes_with_the_kernels_user_and_process_and_gets_its_answer(gateway: Gateway) -> None:
    client = CommandConnections(gateway.place)
    good, found = client.ask("cmd/arm", b'{"operator":"kim"}', patience_s())
    assert (good, json.loads(found)) == (True, {"accepted": True, "text": "arm"})
    good, found = client.ask("cmd/tension", b"no json", patience_s())
    assert (good, json.loads(found)["accepted"]) == (False, False)
    giver = Giver("", USER, os.getpid())
    assert gateway.given == [("arm", b'{"operator":"kim"}', giver), ("tension", b"no json", giver)]
    assert client.ask("tele/state", None, patience_s()) == (True, STATE)
    client.close()


def test_the_socket_is_its_users_alone_and_one_that_was_left_is_replaced(gateway: Gateway) -> None:
    assert stat.S_IMODE(gateway.place.stat().st_mode) == 0o600
    gateway.socket.close()
    again = Gateway(gateway.runtime)
    assert CommandConnections(gateway.place).ask("cmd/arm", b"{}", patience_s())[0]
    again.socket.close()


def test_a_folder_in_its_place_is_removed(runtime: Runtime) -> None:
    (runtime.place(COMMAND_SOCKET) / "x").mkdir(parents=True)
    found = Gateway(runtime)
    assert CommandConnections(found.place).ask("cmd/arm", b"{}", patience_s())[0]
    found.socket.close()


def test_a_path_that_is_too_long_is_one_line(tmp_path: pathlib.Path) -> None:
    runtime = Runtime.of("x" * 107, tmp_path)
    runtime.claim()
    with pytest.raises(FolderError, match="a socket's has at most 107"):
        command_socket.listening(runtime)
    runtime.remove()


@ROOT
def test_of_the_service_members_of_the_two_groups_are_admitted_and_no_other_user(service: Gateway) -> None:
    assert service.place.stat().st_gid == os.getegid()  # a member of the file's own group is none of them
    for group in (OPERATORS, VIEWERS):
        assert by(NOBODY, service, group).startswith("(True, ")
    assert [(giver.user, giver.commands) for _, _, giver in service.given] == [("nobody", True), ("nobody", False)]
    service.given.pop()
    assert by(NOBODY, service) == "Permission denied"
    service.place.chmod(0o666)  # even if anyone could open it
    refused = by(NOBODY, service)
    assert refused.startswith("(False, ")
    assert "nobody is not the daemon" in refused
    assert len(service.given) == 1
    assert ("local user nobody", f"nobody is {NOT_ALLOWED}") in service.socket.closed


@ROOT
def test_where_the_kernel_does_not_name_the_groups_the_user_database_does(
    service: Gateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rigctl.gateway.local_peer._SO_PEERGROUPS", 0xFFFF)
    with service.connected() as own:
        assert peer_of(own).groups == frozenset(os.getgrouplist("root", 0))
    assert by(NOBODY, service, OPERATORS).startswith("(False, ")  # a group of his process alone


def test_200_idle_connections_of_a_user_lose_the_oldest_and_no_command(gateway: Gateway) -> None:
    client = CommandConnections(gateway.place)
    assert client.ask("cmd/arm", b"{}", patience_s())[0]
    idle = [gateway.connected() for _ in range(200)]
    for number in range(20):
        assert client.ask("cmd/arm", str(number).encode(), patience_s())[0]
    assert [payload for _, payload, _ in gateway.given] == [b"{}", *(str(one).encode() for one in range(20))]
    until(lambda: len(gateway.socket._of) <= PER_USER)
    answer, why = answered(idle[0])
    assert (answer.number, answer.good, answer.again) == (0, False, True)
    assert TOO_MANY in why.decode()
    assert ended(idle[0])
    asked(idle[-1], 1)
    assert answered(idle[-1])[0].good
    assert (f"local user {USER}", TOO_MANY) in gateway.socket.closed
    for one in idle:
        one.close()


def test_a_connection_with_a_command_under_way_is_not_the_one_that_goes(gateway: Gateway) -> None:
    busy = [gateway.connected() for _ in range(PER_USER - 1)]
    for one in busy:
        asked(one, 1, "cmd/release")
    until(lambda: len(gateway.waiting) == PER_USER - 1)
    first, second = gateway.connected(), gateway.connected()
    asked(second, 1)
    assert answered(second)[0].good
    assert answered(first)[0].again
    asked(second, 2, "cmd/release")
    until(lambda: len(gateway.waiting) == PER_USER)
    with gateway.connected() as newest:
        answer, why = answered(newest)
        assert (answer.number, answer.again) == (0, False)
        assert ALL_BUSY in why.decode()
    for reply in gateway.waiting:
        reply({"accepted": True, "text": "done"})
    for one in (*busy, second):
        assert answered(one)[0].good
        one.close()
    first.close()


def test_of_many_at_a_time_each_gets_its_own_answer(gateway: Gateway) -> None:
    client, found = CommandConnections(gateway.place), dict[str, str]()

    def ask(one: int) -> None:
        for number in range(50):
            text = f"{one} {number}"
            found[text] = json.loads(client.ask("cmd/target", text.encode(), patience_s())[1])["text"]

    threads = [threading.Thread(target=ask, args=(one,)) for one in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(patience_s())
    assert len(found) == 400
    assert all(text == answer for text, answer in found.items())
    client.close()


def test_questions_in_a_row_are_answered_in_order_one_at_a_time(gateway: Gateway) -> None:
    with gateway.connected() as own:
        asked(own, 1, "cmd/release")
        for number in range(2, 30):  # a socket holds that many while the gateway reads none
            asked(own, number, "tele/state" if number % 2 else "cmd/arm")
        until(lambda: gateway.waiting)
        assert len(gateway.given) == 1
        gateway.waiting[0]({"accepted": True, "text": "done"})
        assert [answered(own)[0].number for _ in range(29)] == list(range(1, 30))


def test_who_asks_and_does_not_read_waits_and_takes_no_memory(gateway: Gateway) -> None:
    gateway.state = b'"' + b"x" * 60_000 + b'"'
    own = gateway.connected()
    own.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            own.send(packed(SocketQuestion(1, "tele/state")))
    client = CommandConnections(gateway.place)
    for _ in range(20):
        assert client.ask("cmd/arm", b"{}", patience_s())[0]
    held = [len(one.out) + len(one.splitter._held) for one in gateway.socket._of.values()]
    assert max(held) < 200_000
    own.close()
    client.close()


def test_a_follower_gets_every_state_and_one_that_was_slow_the_newest(gateway: Gateway) -> None:
    client, mailbox = CommandConnections(gateway.place), Mailbox(None, "state", 10_000)
    client.follow_state(mailbox)
    slow = gateway.connected()
    asked(slow, 9, "tele/state", follow=True)
    until(lambda: sum(bool(one.follows) for one in gateway.socket._of.values()) == 2)
    assert answered(slow) == (SocketAnswer(9, True), b"")
    assert mailbox.take() is None  # states from now on
    for number in range(100):
        gateway.socket.publish(str(number).encode() + b" " * 20_000)
        assert int(until(mailbox.take)) == number
    seen = [answered(slow)]
    while seen[-1][1].strip() != b"99":
        seen.append(answered(slow))
    assert {answer.number for answer, _ in seen} == {9}
    assert len(seen) < 100
    mailbox.close()
    until(lambda: sum(bool(one.follows) for one in gateway.socket._of.values()) == 1)
    slow.close()
    client.close()


def test_a_follower_goes_on_with_the_next_gateway(gateway: Gateway) -> None:
    client, mailbox = CommandConnections(gateway.place), Mailbox(None, "state", 10_000)
    client.follow_state(mailbox)

    def published(state: bytes) -> bytes | None:
        gateway.socket.publish(state)
        return mailbox.take()

    assert until(lambda: published(b"1")) == b"1"
    gateway.socket.close()
    mailbox.clear()
    gateway.socket = CommandSocket(gateway.runtime, gateway.take, lambda: STATE)
    gateway.socket.open()
    until(lambda: published(b"2") == b"2")  # a state of the former gateway may come first
    mailbox.close()
    client.close()


@pytest.mark.parametrize(
    "data",
    [
        b"GET / HTTP/1.1\r\n\r\n", (1 << 31).to_bytes(4, "big"), b"\0\0\0\0", b"\0\0\0\x02{}",
        packed(SocketQuestion(0, "cmd/arm")), packed(SocketQuestion(-1, "tele/state")),
        packed(SocketQuestion(1, "tele/fast")), packed(SocketQuestion(1, "cmd/arm", follow=True)),
        packed(SocketQuestion(1, "x" * 60_000)),
    ],
)  # fmt: skip
def test_what_is_no_question_ends_the_connection_with_one_line(gateway: Gateway, data: bytes) -> None:
    with gateway.connected() as own:
        own.sendall(data)
        answer, payload = answered(own)
        found = json.loads(payload)
        assert (answer.number, answer.good, answer.again, found["reason"]) == (0, False, False, "bad_request")
        assert found["text"].startswith("COMMAND refused: ")
        assert len(found["text"]) < 250
        assert ended(own)
    assert not gateway.given
    assert CommandConnections(gateway.place).ask("cmd/arm", b"{}", patience_s())[0]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_gateway_whose_socket_has_ended_is_not_left_running(gateway: Gateway) -> None:
    gateway.socket._state = lambda: None  # type: ignore[assignment, return-value]
    with gateway.connected() as own:
        asked(own, 1, "tele/state")
        until(lambda: not gateway.socket._thread.is_alive())
    with pytest.raises(RuntimeError, match="has ended"):
        gateway.socket.publish(STATE)
