"""The hold service on its socket, with rings on which the test acts as the loop."""

from __future__ import annotations

import contextlib
import os
import pathlib
import socket
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from rigctl.client import local_hold
from rigctl.config import layout
from rigctl.config import rig_file as config
from rigctl.control.modes import Mode, Refusal
from rigctl.hold import service
from rigctl.hold.service import CONNECTIONS_MAX, HoldService
from rigctl.ipc import runtime_folder as folders
from rigctl.ipc.record import RECORD, REPLY
from rigctl.ipc.ring import RingReader
from rigctl.ipc.runtime_folder import ACTIVE, Runtime
from tests.builders import daemons

ENDPOINT = "tcp/127.0.0.1:7447"


@pytest.fixture
def runtime(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> Runtime:
    monkeypatch.setattr(folders, "BASE", tmp_path)
    monkeypatch.setattr(layout, "SHARED_MEMORY", tmp_path)
    found = Runtime.of("paper_rig")
    found.claim()
    found.make_rings(config.load(daemons.PAPER))
    found.write_json(ACTIVE, {"settings": {"telemetry": {"listen": ENDPOINT}}})
    return found


class Rig:
    """A hold service and a stand-in for its loop."""

    def __init__(self, runtime: Runtime) -> None:
        self.runtime, self.service = runtime, HoldService(runtime)
        self.holds: RingReader = runtime.holds.reader()
        self.replies, self.records = runtime.replies.writer(), runtime.records.writer()

    def ask(self, payload: bytes = b'{"operator": "kim"}') -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        connection.setblocking(False)
        connection.connect(str(self.runtime.hold_socket))
        if payload:
            connection.send(payload)
        return connection

    def turns(self, count: int = 8) -> None:
        for _ in range(count):
            self.service.turn(0.0)

    def take(self, mode: Mode = Mode.HOLD, refusal: Refusal = Refusal.NONE) -> list[str]:
        """Carry out every HOLD on the ring, as the loop does; returns the operators."""
        slots = self.holds.read()
        values: dict[str, Any] = dict.fromkeys((field.name for field in RECORD.fields), 0)
        now = time.monotonic_ns()
        values |= {"t_ns": now, "mode": int(mode), "stroke_mm": 52.3, "tension_n": 300.0}
        self.records.write(*values.values())
        for slot in slots:
            accepted = refusal is Refusal.NONE
            self.replies.write(
                *REPLY.values(t_ns=now, id=slot["id"], accepted=accepted, reason=refusal, checks=0, mode=mode)
            )
        return [slot["operator"].decode() for slot in slots]


@pytest.fixture
def rig(runtime: Runtime) -> Iterator[Rig]:
    found = Rig(runtime)
    yield found
    found.service.close()


def answer_of(connection: socket.socket) -> dict[str, Any]:
    return dict(msgspec.json.decode(connection.recv(65536)))


def test_a_hold_is_given_with_its_user_and_answered_when_the_loop_has_taken_it(rig: Rig) -> None:
    asked = rig.ask()
    rig.turns()
    with pytest.raises(BlockingIOError):
        asked.recv(1)
    assert rig.holds.head == 1
    slot = rig.runtime.holds.reader(from_start=True).read()[0]
    assert (slot["uid"], slot["pid"], slot["operator"]) == (os.geteuid(), os.getpid(), b"kim")
    rig.take()
    rig.turns()
    answer = answer_of(asked)
    assert answer["text"] == "HOLD: stroke held at 52.30 mm, tension 300.0 N"
    assert (answer["accepted"], answer["mode"], answer["via"]) == (True, "HOLD", "local socket")


def test_the_loops_refusal_is_the_answer(rig: Rig) -> None:
    asked = rig.ask()
    rig.turns()
    rig.take(Mode.DISARMED, Refusal.WRONG_MODE)
    rig.turns()
    answer = answer_of(asked)
    assert (answer["accepted"], answer["reason"]) == (False, "wrong_mode")
    assert answer["text"] == "HOLD refused: hold is not possible in DISARMED: arm first"


def test_a_loop_that_says_nothing_is_told_with_what_it_showed_last(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    monkeypatch.setattr(service, "ANSWER_NS", 0)
    rig.take(Mode.COMPENSATING)
    asked = rig.ask()
    rig.turns()
    answer = answer_of(asked)
    assert (answer["accepted"], answer["reason"]) == (False, "no_answer")
    assert "the control loop does not answer; its last record, 0." in answer["text"]
    assert "shows COMPENSATING, stroke 52.30 mm, tension 300.0 N" in answer["text"]


def test_holds_that_come_together_share_a_slot_and_all_are_answered(rig: Rig) -> None:
    asked = [rig.ask(f'{{"operator": "{name}"}}'.encode()) for name in ("kim", "anna", "kim")]
    rig.turns(3)
    rig.service._next_ns = 0
    rig.turns()
    assert sum(len(names.split(", ")) for names in rig.take()) <= 3
    rig.turns()
    assert [answer_of(one)["accepted"] for one in asked] == [True] * 3


def test_a_flood_of_holds_is_spaced_and_the_names_stay(rig: Rig) -> None:
    asked = [rig.ask(f'{{"operator": "user{number}"}}'.encode()) for number in range(30)]
    rig.turns(70)
    assert rig.holds.head < 30
    names: list[str] = []
    while rig.service._waiting or rig.service._given:
        rig.turns(1)
        names += rig.take()
    assert sorted(", ".join(names).split(", ")) == sorted(f"user{number}" for number in range(30))
    assert all(answer_of(one)["accepted"] for one in asked)


@pytest.mark.parametrize(
    ("payload", "why"),
    [
        (b"[" * 900, "HOLD refused: "),
        (b'{"operator": ""}', "found operator ''"),
        (b'{"operator": "' + b"x" * 2000, "found more than 1024 bytes"),
        (b'{"operator": "kim", "velocity": 1}', "velocity"),
    ],
)
def test_what_is_no_hold_is_refused_and_never_reaches_the_loop(rig: Rig, payload: bytes, why: str) -> None:
    asked = rig.ask(payload)
    rig.turns()
    answer = answer_of(asked)
    assert (answer["accepted"], answer["reason"]) == (False, "bad_request")
    assert why in answer["text"]
    assert rig.holds.head == 0


def test_another_users_process_is_refused(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = os.geteuid()
    asked = rig.ask()
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    rig.service._accept(time.monotonic_ns())
    (peer,) = rig.service._peers.values()
    peer.uid = mine + 2
    rig.turns()
    assert f"found a process of uid {mine + 2}, expected one of the daemon's user" in answer_of(asked)["text"]
    assert rig.holds.head == 0


def test_connections_that_say_nothing_do_not_keep_a_hold_out(rig: Rig) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(3 * CONNECTIONS_MAX):
            stack.enter_context(rig.ask(b""))
            rig.turns(1)
        assert len(rig.service._peers) <= CONNECTIONS_MAX
        asked = stack.enter_context(rig.ask())
        rig.turns(CONNECTIONS_MAX)
        rig.take()
        rig.turns()
        assert answer_of(asked)["accepted"]
    rig.turns(2 * CONNECTIONS_MAX)
    assert not rig.service._peers


def test_who_goes_away_after_asking_has_given_hold(rig: Rig) -> None:
    rig.ask().close()
    rig.turns()
    assert rig.take() == ["kim"]
    rig.turns()
    assert not rig.service._peers


def test_a_service_that_was_killed_leaves_its_socket_to_the_next(runtime: Runtime) -> None:
    first = HoldService(runtime)
    second = Rig(runtime)
    asked = second.ask()
    second.turns()
    second.take()
    second.turns()
    assert answer_of(asked)["accepted"]
    first.close()
    second.service.close()


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
    assert local_hold.same_endpoint(asked, listen) is same


def test_the_socket_is_found_by_endpoint_rig_and_owner(runtime: Runtime, monkeypatch: pytest.MonkeyPatch) -> None:
    assert local_hold.socket_of(ENDPOINT, None) == runtime.hold_socket
    assert local_hold.socket_of(ENDPOINT, "paper_rig") == runtime.hold_socket
    assert local_hold.socket_of(ENDPOINT, "north_rig") is None
    assert local_hold.socket_of("tcp/10.0.0.1:7447", None) is None
    mine = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    assert local_hold.socket_of(ENDPOINT, None) is None


@pytest.mark.parametrize("active", [b"", b"[" * 100_000, b"7", b'{"settings": 7}', b'{"settings": {"telemetry": []}}'])
def test_a_folder_that_cannot_be_read_leaves_the_network(runtime: Runtime, active: bytes) -> None:
    (runtime.directory / ACTIVE).write_bytes(active)
    assert local_hold.socket_of(ENDPOINT, None) is None


def test_without_a_service_the_answer_is_none(runtime: Runtime) -> None:
    assert local_hold.socket_of(ENDPOINT, None) == runtime.hold_socket
    assert local_hold.hold(ENDPOINT, None, "kim") is None
