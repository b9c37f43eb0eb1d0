"""Commands and the state on a Unix stream socket in the run-time folder, for the users of this computer.

The kernel lets only the daemon's user, operators and viewers open it, and names the user and process of each
connection; viewers read. Nobody's connections take another's place or memory: of one user at most ``PER_USER`` stay, a
connection has one question at a time and is read no further before the answer is sent, and a follower that does not
read gets the newest state when it does. Messages are in `rigctl.wire.socket_message`.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import shutil
import socket
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import count
from queue import Empty, SimpleQueue
from typing import Any

import msgspec

from rigctl.config.one_line import on_one_line
from rigctl.gateway.command_server import Giver, Reply
from rigctl.gateway.local_peer import LocalPeer, is_admitted, peer_of
from rigctl.ipc.folder_places import COMMAND_SOCKET
from rigctl.ipc.runtime_folder import FolderError, Runtime
from rigctl.ipc.writers import OPERATORS, VIEWERS
from rigctl.wire.socket_message import (
    COMMAND,
    LONGEST_QUESTION,
    STATE,
    SocketAnswer,
    SocketMessageError,
    SocketQuestion,
    Splitter,
    packed,
    unpacked,
)

PER_USER = 32  # connections; a terminal has one, a page two
PATH_BYTES = 107  # of struct sockaddr_un, without the zero at the end
NOT_ALLOWED = f"not the daemon's user, root or a member of the groups {OPERATORS} and {VIEWERS}"
TOO_MANY = f"more than {PER_USER} connections of one user; the oldest idle one is closed for the newest"
ALL_BUSY = f"more than {PER_USER} connections of one user, each with a command under way; the newest is closed"
_BACKLOG = 128
_ACCEPTED = 16  # before the connections have their turn
_RECEIVED_BYTES = 1 << 12  # of one connection before the others have their turn
_REST_S = 0.1  # before a connection is accepted again, where no descriptor is left
_CLOSED_MAX = 256
_NO_ROOM = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS})

Take = Callable[[str, bytes | None, Giver, Reply], None]
"""See `rigctl.gateway.command_server.CommandServer.take`."""


def listening(runtime: Runtime) -> socket.socket:
    """The socket, in place of one that a gateway before has left.

    Raises:
        FolderError: its path is too long.
        OSError: it cannot be made.
    """
    place = runtime.place(COMMAND_SOCKET)
    if (found := len(os.fsencode(place))) > PATH_BYTES:
        raise FolderError(f"{place}: found a path of {found} bytes, a socket's has at most {PATH_BYTES}")
    try:
        place.unlink(missing_ok=True)
    except IsADirectoryError:
        shutil.rmtree(place)
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        os.fchmod(made.fileno(), 0o600)  # before it has a name that others could open
        made.bind(str(place))
        made.setblocking(False)
        made.listen(_BACKLOG)
        runtime.let_members_connect(place)
    except OSError:
        made.close()
        raise
    return made


class _LocalConnection:
    """One connection, its question and what is to be sent on it."""

    def __init__(self, own: socket.socket, peer: LocalPeer, used: int, *, commands: bool) -> None:
        self.own, self.peer, self.used = own, peer, used
        self.giver = Giver(user=peer.name, process=peer.pid, commands=commands)
        self.splitter, self.out = Splitter(LONGEST_QUESTION), bytearray()
        self.asked = 0  # number of the question without an answer
        self.follows = 0  # number of the question since which it gets the states
        self.state: bytes | None = None  # to be sent next
        self.watched = select.EPOLLIN

    @property
    def loss(self) -> tuple[bool, bool, bool, int]:
        """In the order in which those of a user are ended: the longest idle, then followers, then who does not read."""
        return bool(self.asked), bool(self.out), bool(self.follows), self.used


class CommandSocket:
    """The socket and its thread."""

    def __init__(self, runtime: Runtime, take: Take, state: Callable[[], bytes]) -> None:
        """``take``: gives a command; ``state``: the newest one. Nothing is accepted before `open`.

        Raises:
            FolderError: its path is too long.
            OSError: it cannot be made.
        """
        self._take, self._state = take, state
        self._members = runtime.members
        self._listener = listening(runtime)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._epoll = select.epoll()
        self._epoll.register(self._wake, select.EPOLLIN)
        self._of: dict[int, _LocalConnection] = {}  # by descriptor
        self._uses = count(1)
        self._answers: SimpleQueue[tuple[_LocalConnection, dict[str, Any]]] = SimpleQueue()
        self._published: deque[bytes] = deque(maxlen=1)
        self._followed = False
        self._ending = False
        self.closed: deque[tuple[str, str]] = deque(maxlen=_CLOSED_MAX)
        """Connections that were ended, for the record: whose, and why."""
        self._thread = threading.Thread(target=self._serve, name="command socket", daemon=True)

    def open(self) -> None:
        """Accept connections."""
        self._epoll.register(self._listener, select.EPOLLIN)
        self._thread.start()

    def publish(self, state: bytes) -> None:
        """Send a state to all that follow; from any thread.

        Raises:
            RuntimeError: the thread has ended, so that the gateway has to be replaced.
        """
        if self._ending:
            return
        if not self._thread.is_alive():
            raise RuntimeError("the thread of the command socket has ended")
        if self._followed:
            self._published.append(state)
            self._wake_up()

    def close(self) -> None:
        """End the thread and all connections."""
        if self._ending:
            return
        self._ending = True
        self._wake_up()
        if self._thread.is_alive():
            self._thread.join()
        for one in list(self._of.values()):
            self._drop(one)
        self._listener.close()
        self._epoll.close()
        os.close(self._wake)

    def _wake_up(self) -> None:
        os.eventfd_write(self._wake, 1)

    # -- the thread -----------------------------------------------------------------------------------------
    def _serve(self) -> None:
        rests = False
        while not self._ending:
            found = self._epoll.poll(_REST_S if rests else None)
            if rests:
                self._epoll.register(self._listener, select.EPOLLIN)
                rests = False
            for descriptor, events in found:
                if descriptor == self._wake:
                    os.eventfd_read(self._wake)
                elif (one := self._of.get(descriptor)) is not None:
                    self._turn(one, events)
            self._send_answers()
            self._send_states()
            # Last, since a new connection may get the descriptor of one that has just ended.
            if any(descriptor == self._listener.fileno() for descriptor, _ in found) and not self._accept():
                self._epoll.unregister(self._listener)
                rests = True

    def _turn(self, one: _LocalConnection, events: int) -> None:
        if events & (select.EPOLLHUP | select.EPOLLERR):
            self._drop(one)
        elif events & select.EPOLLOUT:
            self._go_on(one)
        elif events & select.EPOLLIN:
            data = b""
            with contextlib.suppress(OSError):
                data = one.own.recv(_RECEIVED_BYTES)
            if not data:
                self._drop(one)
                return
            one.splitter.feed(data)
            one.used = next(self._uses)
            self._go_on(one)

    def _accept(self) -> bool:
        """Accept some; False where there is no descriptor or memory for one."""
        for _ in range(_ACCEPTED):
            try:
                own, _ = self._listener.accept()
            except OSError as error:
                return error.errno not in _NO_ROOM
            self._admit(own)
        return True

    def _admit(self, own: socket.socket) -> None:
        own.setblocking(False)
        try:
            peer = peer_of(own)
            commands = is_admitted(peer, os.geteuid(), self._members[0])
            one = _LocalConnection(own, peer, next(self._uses), commands=commands)
        except OSError:
            own.close()
            return
        if not is_admitted(peer, os.geteuid(), *self._members):
            self._end(one, "not_allowed", f"{peer.name} is {NOT_ALLOWED}")
            return
        same = [other for other in self._of.values() if other.peer.uid == peer.uid]
        if len(same) >= PER_USER:
            shed = min(same, key=lambda other: other.loss)
            if shed.asked:  # its answer would be lost
                self._end(one, "too_many", ALL_BUSY)
                return
            self._end(shed, "too_many", TOO_MANY)
        self._of[own.fileno()] = one
        self._epoll.register(own, one.watched)

    def _end(self, one: _LocalConnection, reason: str, text: str) -> None:
        """End a connection with a word on why. The client of an idle one asks again on another one."""
        message = {"accepted": False, "reason": reason, "text": f"COMMAND refused: {text}"}
        again = text is TOO_MANY and not one.out
        last = packed(SocketAnswer(0, False, again), msgspec.json.encode(message))
        with contextlib.suppress(OSError):
            one.own.send(bytes(one.out) + last)
        self.closed.append((f"local user {one.peer.name}", text))
        self._drop(one)

    def _drop(self, one: _LocalConnection) -> None:
        if self._of.pop(one.own.fileno(), None) is not None:
            self._epoll.unregister(one.own)
        one.own.close()
        self._followed = any(other.follows for other in self._of.values())

    def _go_on(self, one: _LocalConnection) -> None:
        """Send what there is, then the newest state, then take the next question; as far as it goes without waiting."""
        try:
            while self._is_open(one):
                if one.out:
                    if not self._sent(one):
                        break
                elif one.state is not None:
                    one.out += packed(SocketAnswer(one.follows, True), one.state)
                    one.state = None
                elif one.asked or (data := one.splitter.take()) is None:
                    break
                else:
                    self._ask(one, *unpacked(data, SocketQuestion))
        except SocketMessageError as error:
            self._end(one, "bad_request", str(error))
        self._watch(one)

    def _ask(self, one: _LocalConnection, question: SocketQuestion, payload: bytes) -> None:
        number, key = question.number, question.key
        if number < 1:
            raise SocketMessageError(f"found number {number}, expected one above 0")
        if key == STATE:
            if question.follow:
                one.follows, self._followed = number, True
            one.out += packed(SocketAnswer(number, True), b"" if question.follow else self._state())
        elif key.startswith(COMMAND) and not question.follow:
            one.asked = number
            self._take(key.removeprefix(COMMAND), payload, one.giver, partial(self._put_answer, one))
        else:
            raise SocketMessageError(f"found the key {on_one_line(key)[:80]}, expected {COMMAND}VERB or {STATE}")

    def _put_answer(self, one: _LocalConnection, message: dict[str, Any]) -> None:
        """Answer the command of a connection, which has one at a time; from any thread."""
        self._answers.put((one, message))
        if not self._ending:
            self._wake_up()

    def _send_answers(self) -> None:
        with contextlib.suppress(Empty):
            while True:
                one, message = self._answers.get_nowait()
                if self._is_open(one):
                    answer = SocketAnswer(one.asked, bool(message["accepted"]))
                    one.out += packed(answer, msgspec.json.encode(message))
                    one.asked = 0
                    self._go_on(one)

    def _send_states(self) -> None:
        while self._published:
            state = self._published.popleft()
            for one in [one for one in self._of.values() if one.follows]:
                one.state = state
                self._go_on(one)

    def _sent(self, one: _LocalConnection) -> bool:
        """Send without waiting; whether all is sent."""
        try:
            del one.out[: one.own.send(one.out)]
        except BlockingIOError:
            return False
        except OSError:
            self._drop(one)
        return not one.out

    def _is_open(self, one: _LocalConnection) -> bool:
        return self._of.get(one.own.fileno()) is one

    def _watch(self, one: _LocalConnection) -> None:
        """Wait for what is next: room for the rest, a question, or, while a command is carried out, its end alone."""
        if not self._is_open(one):
            return
        wanted = select.EPOLLOUT if one.out else 0 if one.asked else select.EPOLLIN
        if wanted != one.watched:
            one.watched = wanted
            self._epoll.modify(one.own, wanted)
