"""The wire: one order for all, and a server that no client can block."""

from __future__ import annotations

import pathlib
import re
import socket
import tempfile
from collections.abc import Iterator

import pytest

from hil.hub import Hub, Port
from hil.hub_server import HubServer, SocketRefusedError


def frame(number: int) -> bytes:
    return number.to_bytes(16, "little")


def number(data: bytes) -> int:
    return int.from_bytes(data, "little")


@pytest.fixture
def path() -> Iterator[str]:
    with tempfile.TemporaryDirectory(prefix="hub", dir="/tmp") as folder:
        yield folder + "/rig.sock"


class Door:
    """A hub with its server and one local port."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.hub = Hub()
        self.server = HubServer(path, self.hub)
        self.heard: list[int] = []
        self.port = self.hub.attach(lambda data: self.heard.append(number(data)))

    def client(self) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        connection.connect(self.path)
        connection.setblocking(False)
        self.server.poll(0)
        return connection

    def settle(self) -> None:
        for _ in range(10):
            self.server.poll(0)


@pytest.fixture
def door(path: str) -> Iterator[Door]:
    door = Door(path)
    yield door
    door.server.close()


def drain(connection: socket.socket) -> list[int]:
    found = []
    while True:
        try:
            found.append(number(connection.recv(64)))
        except BlockingIOError:
            return found


def test_a_frame_reaches_every_port_but_its_sender() -> None:
    hub = Hub()
    heard: dict[int, list[bytes]] = {0: [], 1: [], 2: []}
    ports = [hub.attach(heard[i].append) for i in heard]
    ports[1].send(frame(7))
    assert heard == {0: [frame(7)], 1: [], 2: [frame(7)]}


def test_an_answer_never_overtakes_its_question() -> None:
    """The first port answers during delivery; the last must still receive the request first."""
    hub = Hub()
    order: list[int] = []

    def answer(data: bytes) -> None:
        if number(data) < 10:
            answering.send(frame(number(data) + 10))
            answering.send(frame(number(data) + 20))

    answering = hub.attach(answer)
    asking = hub.attach(lambda _: None)
    hub.attach(lambda data: order.append(number(data)))
    asking.send(frame(1))
    asking.send(frame(2))
    assert order == [1, 11, 21, 2, 12, 22]


def test_a_failing_port_does_not_jam_the_wire() -> None:
    hub = Hub()
    heard: list[bytes] = []

    def fail(_: bytes) -> None:
        hub.detach(failing)
        raise RuntimeError("broken")

    failing = hub.attach(fail)
    sender = hub.attach(lambda _: None)
    hub.attach(heard.append)
    with pytest.raises(RuntimeError):
        sender.send(frame(1))
    sender.send(frame(2))
    assert heard == [frame(2)]


def test_the_log_keeps_order_and_time() -> None:
    times = iter([5, 6])
    hub = Hub(lambda: next(times))
    port: Port = hub.attach(lambda _: None)
    port.send(frame(1))
    port.send(frame(2))
    assert hub.log == [(5, frame(1)), (6, frame(2))]


def test_clients_hear_each_other_and_the_local_port(door: Door) -> None:
    first, second = door.client(), door.client()
    first.send(frame(1))
    door.settle()
    door.port.send(frame(2))
    assert drain(second) == [1, 2]
    assert drain(first) == [2]
    assert door.heard == [1]


def test_clients_may_come_and_go(door: Door) -> None:
    staying = door.client()
    for i in range(20):
        leaving = door.client()
        leaving.send(frame(i))
        leaving.close()
        door.settle()
    door.port.send(frame(99))
    assert drain(staying) == [*range(20), 99]
    assert door.server.clients == 1
    assert door.server.clients_seen == 21


def test_a_client_that_leaves_between_two_frames_is_noticed_at_the_send(door: Door) -> None:
    leaving, staying = door.client(), door.client()
    leaving.close()
    door.port.send(frame(1))
    door.port.send(frame(2))
    door.settle()
    assert drain(staying) == [1, 2]
    assert door.server.clients == 1


def test_a_half_closed_client_is_dismissed(door: Door) -> None:
    leaving, staying = door.client(), door.client()
    leaving.shutdown(socket.SHUT_WR)
    door.settle()
    door.port.send(frame(1))
    assert drain(staying) == [1]
    assert door.server.clients == 1


def test_a_stalled_client_loses_frames_and_nobody_else_does(door: Door) -> None:
    stalled, reading = door.client(), door.client()
    got: list[int] = []
    sent = 0
    while not door.server.lost:
        for _ in range(50):
            door.port.send(frame(sent))
            sent += 1
        got += drain(reading)
    assert got == list(range(sent))
    assert door.server.lost_per_client == [door.server.lost, 0]
    kept = drain(stalled)
    assert kept == list(range(len(kept)))  # it has the beginning, without a gap
    assert len(kept) >= 250  # 50 ms of a bus at 5 frames a millisecond
    door.settle()
    door.port.send(frame(7))
    assert drain(stalled) == [7]  # it has missed frames and is still connected


def test_rubbish_is_counted_and_dropped(door: Door) -> None:
    client = door.client()
    for size in (0, 1, 15, 17, 40):
        client.send(bytes(size))
    client.send(frame(3))
    door.settle()
    assert door.heard == [3]
    assert door.server.malformed == 5
    assert door.server.clients == 1


def test_one_flooding_client_leaves_the_others_their_turn(door: Door) -> None:
    flooding, modest = door.client(), door.client()
    for i in range(200):
        flooding.send(frame(i))
    modest.send(frame(1000))
    door.server.poll(0)
    assert 1000 in door.heard


def test_a_second_server_is_refused_and_the_first_lives_on(door: Door) -> None:
    with pytest.raises(SocketRefusedError, match=door.path):
        HubServer(door.path, Hub())
    client = door.client()
    door.port.send(frame(1))
    assert drain(client) == [1]


def test_a_foreign_live_socket_is_refused(path: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as foreign:
        foreign.bind(path)
        foreign.listen()
        with pytest.raises(SocketRefusedError, match=path):
            HubServer(path, Hub())
    assert pathlib.Path(path).is_socket()


def test_a_dead_ones_socket_is_replaced(path: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(path)
    door = Door(path)
    client = door.client()
    door.port.send(frame(1))
    assert drain(client) == [1]
    door.server.close()


def test_a_file_that_is_no_socket_is_left_alone(path: str) -> None:
    pathlib.Path(path).write_text("precious")
    with pytest.raises(SocketRefusedError, match="not a socket"):
        HubServer(path, Hub())
    assert pathlib.Path(path).read_text() == "precious"


def test_a_folder_that_is_not_there_is_one_clear_line(path: str) -> None:
    nowhere = f"{path}.d/rig.sock"
    with pytest.raises(SocketRefusedError, match=rf"^{re.escape(nowhere)}: cannot be served: No such file") as refused:
        HubServer(nowhere, Hub())
    assert "\n" not in str(refused.value)


def test_closing_leaves_nothing_behind(path: str) -> None:
    HubServer(path, Hub()).close()
    assert list(pathlib.Path(path).parent.iterdir()) == []
    HubServer(path, Hub()).close()  # the path is free again
