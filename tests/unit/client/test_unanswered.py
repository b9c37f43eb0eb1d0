"""Why no daemon answers: six causes, distinguished on this computer by the public slot, elsewhere by the connection."""

from __future__ import annotations

import contextlib
import os
import pathlib
import socket
import threading
import types
from collections.abc import Iterator

import pytest

from rigctl.cli import unanswered as printed
from rigctl.client import unanswered as client
from rigctl.client.connection import NoDaemonError
from rigctl.client.endpoint_probe import Met, probe
from rigctl.client.local_daemons import LocalDaemon
from rigctl.client.unanswered import Obstacle, Unanswered
from rigctl.ipc.folder_places import LOCK, FolderPlaces, digest
from rigctl.ipc.public_slot import PublicSlot, SlotWriter
from rigctl.model.faults import Fault
from rigctl.model.states import HeldBy, Mode
from tests.builders.daemons import free_port

ENDPOINT = "tcp/127.0.0.1:7447"
WAITS_FOR = "second force path (node 12)"
NOW_NS = 10**15


@pytest.fixture
def daemon(tmp_path: pathlib.Path) -> LocalDaemon:
    """A run-time folder with its lock held by this process, and a gateway that has ended."""
    place = FolderPlaces(tmp_path)
    place.place(LOCK).write_text(f"{os.getpid()}\n")
    _show_gateway(place, 1 << 21)
    return LocalDaemon(place, os.geteuid(), "paper_rig", ENDPOINT)


def _show_gateway(place: FolderPlaces, pid: int) -> None:
    data = b'{"pid":%d,"run_id":"1"}' % pid
    place.place("gateway.pid.json").write_bytes(data + b"\n" + digest(data) + b"\n")


def slot(looked_s: float = 0.05, record_s: float | None = 0.06, waits_for: str = "") -> PublicSlot:
    """Written ``looked_s`` before ``NOW_NS`` with a record that is ``record_s`` old; None: without a record."""
    looked_ns = NOW_NS - round(looked_s * 1e9)
    if record_s is None:
        return PublicSlot(looked_ns, waits_for=waits_for)
    t_ns = NOW_NS - round(record_s * 1e9)
    return PublicSlot(looked_ns, t_ns, 301.25, 0, Mode.HOLD, HeldBy.BRAKE, waits_for=waits_for)


@pytest.fixture(autouse=True)
def now(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "time", types.SimpleNamespace(monotonic_ns=lambda: NOW_NS))


def found(daemon: LocalDaemon, content: PublicSlot | None) -> Unanswered:
    if content is not None:
        writer = SlotWriter(daemon.place)
        writer.write(content)
        writer.close()
    return client._local(daemon)


def lines(shown: Unanswered, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setenv("COLUMNS", "80")
    capsys.readouterr()
    printed._print(shown, ENDPOINT, None)
    return capsys.readouterr().out.splitlines()


def test_a_gateway_that_has_ended_leaves_the_rig_in_sight(
    daemon: LocalDaemon, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = found(daemon, slot())
    assert shown.cause is Obstacle.GATEWAY
    text = "\n".join(lines(shown, capsys, monkeypatch))
    for words in ("it has ended", " HOLD ", "301.25 N", "0.1 s old", "held by the brake", "rigctl hold works"):
        assert words in text


def test_one_that_hangs_is_another_text(daemon: LocalDaemon) -> None:
    _show_gateway(daemon.place, os.getpid())
    assert f"it hangs, or is just starting (process {os.getpid()})" in found(daemon, slot()).wrong


@pytest.mark.parametrize(
    ("content", "cause", "words"),
    [
        (
            slot(record_s=None, waits_for=WAITS_FOR),
            Obstacle.STARTING,
            f"the daemon starts, and waits for: {WAITS_FOR}",
        ),
        (slot(9.0, None, "design of the gains"), Obstacle.STARTING, "waits for: design of the gains"),
        (slot(waits_for="gateway"), Obstacle.STARTING, "waits for: gateway"),
        (slot(record_s=0.5), Obstacle.LOOP, "no records: it has ended, or hangs"),
        (slot(record_s=3.0, waits_for=WAITS_FOR), Obstacle.LOOP, f"; its next start waits for: {WAITS_FOR}"),
        (slot(3.0, 3.0), Obstacle.GATEWAY, "gateway and supervisor hang, or this computer is stalled"),
        (None, Obstacle.GATEWAY, "it has ended"),
    ],
)
def test_the_public_slot_tells_the_causes_apart(
    daemon: LocalDaemon, content: PublicSlot | None, cause: Obstacle, words: str
) -> None:
    shown = found(daemon, content)
    assert shown.cause is cause, shown
    assert words in shown.wrong


@pytest.mark.parametrize("killed", [False, True], ids=["the loop hangs", "the supervisor is killed"])
def test_no_emergency_stop_is_a_step_for_a_load_that_the_brake_does_not_hold(daemon: LocalDaemon, killed: bool) -> None:
    if killed:
        daemon.place.place(LOCK).write_text(f"{1 << 21}\n")
    shown = found(daemon, slot(record_s=0.5))
    assert any("press the emergency stop" in step for step in shown.steps)
    shown = found(daemon, slot(record_s=0.5)._replace(brake_fails=True))
    assert shown.cause is Obstacle.LOOP
    assert not any("press the emergency stop" in step for step in shown.steps)
    assert any("support the payload from below" in step for step in shown.steps)


def test_a_killed_daemon_leaves_its_last_values_with_their_age_and_no_tension(
    daemon: LocalDaemon, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon.place.place(LOCK).write_text(f"{1 << 21}\n")
    shown = found(daemon, slot(12.0, 12.0))
    assert shown.cause is Obstacle.LOOP
    text = "\n".join(lines(shown, capsys, monkeypatch))
    assert "HOLD   12.0 s ago, tension not known" in text
    assert "301" not in text


def test_each_is_at_most_eight_lines_of_80_columns(
    daemon: LocalDaemon, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for content in (slot(), slot(record_s=3.0, waits_for=WAITS_FOR), slot(3.0, 3.0), slot(record_s=3.0),
                    slot(waits_for=WAITS_FOR)):  # fmt: skip
        worst = content._replace(fault=Fault.DRIVE_CONTRADICTS, mode=Mode.COMPENSATING, held_by=HeldBy.NOTHING)
        for brake_fails in (False, True):
            shown = lines(found(daemon, worst._replace(brake_fails=brake_fails)), capsys, monkeypatch)
            assert len(shown) <= 8, shown
            assert max(map(len, shown)) <= 80
    shown = lines(found(daemon, slot(record_s=None, waits_for=WAITS_FOR)), capsys, monkeypatch)
    assert len(shown) <= 8, shown


@contextlib.contextmanager
def listening(greets: bytes) -> Iterator[str]:
    """A program that is no daemon; the endpoint of it."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    connection.sendall(greets)
                    connection.close()

        threading.Thread(target=serve, daemon=True).start()
        yield f"tcp/127.0.0.1:{server.getsockname()[1]}"


NO_DAEMON = NoDaemonError("no daemon answers")


def test_a_port_without_a_listener_and_one_of_another_program_are_two_texts() -> None:
    nothing = client.unanswered(f"tcp/127.0.0.1:{free_port()}", "no_such_rig", NO_DAEMON)
    assert nothing.cause is Obstacle.PORT
    assert nothing.wrong.startswith("nothing listens at tcp/127.0.0.1:")
    with listening(b"220 mail\r\n") as endpoint:
        other = client.unanswered(endpoint, "no_such_rig", NO_DAEMON)
    assert other.cause is Obstacle.PORT
    assert other.wrong.startswith(f"what listens at {endpoint} is no daemon")


def test_an_unknown_host_is_named() -> None:
    shown = client.unanswered("tcp/no-such-host.invalid:7447", None, NO_DAEMON)
    assert shown.cause is Obstacle.HOST
    assert shown.wrong.startswith("host no-such-host.invalid is not known to this computer (")
    assert (shown.state, shown.does) == (None, "not known from here")


@pytest.mark.parametrize("endpoint", ["unixsock-stream//nowhere", "tcp/127.0.0.1:none", "udp/127.0.0.1:7447"])
def test_an_endpoint_without_an_address_is_not_looked_up(endpoint: str) -> None:
    assert probe(endpoint).met is Met.NO_ADDRESS
