"""What a client of the command socket does when the gateway ends its connection: it repeats what was not taken."""

from __future__ import annotations

import pathlib
import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from rigctl.client.command_connection import ATTEMPTS, CommandConnections
from rigctl.wire.socket_message import LONGEST_QUESTION, SocketAnswer, SocketQuestion, Splitter, packed, unpacked
from tests.builders.waiting import patience_s, until

Turn = Callable[[socket.socket], None]


class Gateway:
    """A socket that does something else with each connection."""

    def __init__(self, place: pathlib.Path) -> None:
        self.place, self.taken, self.accepted = place, list[bytes](), 0
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(str(place))
        self.listener.listen()

    def play(self, *turns: Turn) -> threading.Thread:
        def run() -> None:
            for turn in turns:
                try:
                    own, _ = self.listener.accept()
                except OSError:  # the test has ended
                    return
                self.accepted += 1
                with own:
                    turn(own)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        return thread

    def read(self, own: socket.socket) -> SocketQuestion:
        splitter = Splitter(LONGEST_QUESTION)
        while (found := splitter.take()) is None:
            splitter.feed(own.recv(4096))
        question, payload = unpacked(found, SocketQuestion)
        self.taken.append(payload)
        return question

    def answers(self, own: socket.socket) -> None:
        number = self.read(own).number
        own.sendall(packed(SocketAnswer(number, True), b"done"))
        own.recv(1)  # until the client ends it

    def sheds(self, own: socket.socket) -> None:
        own.recv(1, socket.MSG_PEEK)  # the question has been sent
        own.sendall(packed(SocketAnswer(0, False, again=True), b"{}"))

    def leaves_it_unread(self, own: socket.socket) -> None:
        own.recv(1, socket.MSG_PEEK)

    def leaves_after_reading(self, own: socket.socket) -> None:
        self.read(own)

    def reads_and_waits(self, own: socket.socket) -> None:
        self.read(own)
        own.recv(1)  # until the client ends it

    def refuses(self, own: socket.socket) -> None:
        own.recv(1, socket.MSG_PEEK)
        own.sendall(packed(SocketAnswer(0, False), b"why"))


@pytest.fixture
def gateway(tmp_path: pathlib.Path) -> Iterator[Gateway]:
    found = Gateway(tmp_path / "command.sock")
    yield found
    found.listener.shutdown(socket.SHUT_RDWR)  # ends an accept, which a close alone would leave to the next file
    found.listener.close()


@pytest.mark.parametrize("how", ["sheds", "leaves_it_unread"])
def test_a_question_that_was_not_taken_is_asked_on_another_connection(gateway: Gateway, how: str) -> None:
    gateway.play(getattr(gateway, how), gateway.answers)
    client = CommandConnections(gateway.place)
    assert client.ask("cmd/arm", b"kim", patience_s()) == (True, b"done")
    assert (gateway.taken, gateway.accepted) == ([b"kim"], 2)
    client.close()


def test_one_that_may_have_been_taken_is_not(gateway: Gateway) -> None:
    gateway.play(gateway.leaves_after_reading, gateway.answers)
    client = CommandConnections(gateway.place)
    with pytest.raises(ConnectionError):
        client.ask("cmd/arm", b"kim", patience_s())
    assert (gateway.taken, gateway.accepted) == ([b"kim"], 1)


def test_a_refused_connection_gives_the_gateways_word(gateway: Gateway) -> None:
    gateway.play(gateway.refuses)
    assert CommandConnections(gateway.place).ask("cmd/arm", b"kim", patience_s()) == (False, b"why")
    assert gateway.taken == []


def test_a_gateway_that_sheds_every_connection_is_left(gateway: Gateway) -> None:
    gateway.play(*[gateway.sheds] * ATTEMPTS)
    with pytest.raises(ConnectionError):
        CommandConnections(gateway.place).ask("cmd/arm", b"kim", patience_s())
    assert gateway.accepted == ATTEMPTS


def test_a_gateway_that_does_not_answer_is_waited_for_as_long_as_is_said(gateway: Gateway) -> None:
    gateway.play(gateway.reads_and_waits)
    with pytest.raises(TimeoutError):
        CommandConnections(gateway.place).ask("cmd/arm", b"kim", 0.2)
    assert gateway.accepted == 1


def test_a_question_under_way_ends_with_the_client(gateway: Gateway) -> None:
    gateway.play(gateway.reads_and_waits)
    client, found = CommandConnections(gateway.place), list[OSError]()

    def ask() -> None:
        try:
            client.ask("cmd/arm", b"kim", patience_s())
        except OSError as error:
            found.append(error)

    thread = threading.Thread(target=ask)
    thread.start()
    until(lambda: gateway.taken)
    client.close()
    thread.join(patience_s())
    assert len(found) == 1
    with pytest.raises(ConnectionError):
        client.ask("cmd/arm", b"kim", patience_s())
