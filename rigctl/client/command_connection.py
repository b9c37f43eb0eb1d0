"""Commands and the state by the gateway's Unix stream socket: a question and its answer at a time on a connection.

A connection is kept for the next question. One on which the gateway has not taken the question, because it ended the
connection or was started anew, is replaced; a question that may have been taken is never repeated.
"""

from __future__ import annotations

import contextlib
import pathlib
import socket
import threading
import time

from rigctl.client.mailbox import Mailbox
from rigctl.wire.socket_message import (
    LONGEST_ANSWER,
    STATE,
    SocketAnswer,
    SocketMessageError,
    SocketQuestion,
    Splitter,
    packed,
    unpacked,
)

ATTEMPTS = 3
AGAIN_S = 0.1  # between two attempts to follow a gateway that starts anew
SILENCE_S = 5.0  # of a gateway that sends 50 states a second
_KEPT = 2
_QUEUE_S = 0.01
_RECEIVED_BYTES = 1 << 16

Answered = tuple[SocketAnswer, bytes]
"""An answer and its payload."""


class _NotTakenError(ConnectionError):
    """The question did not reach the gateway."""


class _SocketSession:
    def __init__(self, place: pathlib.Path, limit_s: float) -> None:
        self._own = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._splitter, self._number = Splitter(LONGEST_ANSWER), 0
        try:
            self._connect(str(place), limit_s)
        except OSError:
            self._own.close()
            raise

    def _connect(self, place: str, limit_s: float) -> None:
        until = time.monotonic() + limit_s
        self._own.setblocking(False)
        while True:
            try:
                return self._own.connect(place)
            except BlockingIOError:  # as many wait for the gateway as its queue holds
                if time.monotonic() >= until:
                    raise
                time.sleep(_QUEUE_S)

    def ask(self, key: str, payload: bytes, limit_s: float, *, follow: bool = False) -> Answered:
        """One question and its answer.

        Raises:
            _NotTakenError: the gateway did not take it.
            OSError: no answer.
        """
        self._number += 1
        question = packed(SocketQuestion(self._number, key, follow), payload)
        until = time.monotonic() + limit_s
        try:
            self._own.settimeout(limit_s)
            self._own.sendall(question)
        except (BrokenPipeError, ConnectionResetError):
            with contextlib.suppress(OSError):
                return self._ended(self.read(0.0))  # the gateway's word on why
            raise _NotTakenError("the gateway has ended the connection") from None
        while True:
            try:
                answer, found = self.read(max(0.0, until - time.monotonic()))
            except ConnectionResetError:  # the gateway has gone without having read all of it
                raise _NotTakenError("the gateway has ended the connection") from None
            if answer.number == self._number:
                return answer, found
            if answer.number == 0:
                return self._ended((answer, found))

    @staticmethod
    def _ended(answered: Answered) -> Answered:
        if answered[0].again:
            raise _NotTakenError("the gateway has ended the connection")
        return answered

    def read(self, limit_s: float) -> Answered:
        """The next answer.

        Raises:
            OSError: none comes within ``limit_s``, or the gateway has ended the connection.
        """
        until = time.monotonic() + limit_s
        try:
            while (data := self._splitter.take()) is None:
                self._own.settimeout(max(1e-3, until - time.monotonic()))
                received = self._own.recv(_RECEIVED_BYTES)
                if not received:
                    raise ConnectionError("the gateway has ended the connection")
                self._splitter.feed(received)
            return unpacked(data, SocketAnswer)
        except SocketMessageError as error:
            raise ConnectionError(str(error)) from None

    def has_ended(self) -> bool:
        """Whether the gateway has ended it, or sent what no question waits for."""
        self._own.setblocking(False)
        try:
            self._own.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            return True
        return True

    def end(self) -> None:
        """End it, and wake whoever waits for an answer."""
        with contextlib.suppress(OSError):
            self._own.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._own.close()


class CommandConnections:
    """The connections of one client; every method may be called from any thread."""

    def __init__(self, place: pathlib.Path) -> None:
        """``place``: of the socket, which may not be there yet."""
        self._place = place
        self._lock = threading.Lock()
        self._idle: list[_SocketSession] = []
        self._used: set[_SocketSession] = set()
        self._closed = False

    def ask(self, key: str, payload: bytes | None, limit_s: float) -> tuple[bool, bytes]:
        """One question; whether it was answered (else refused), and the answer's bytes.

        Raises:
            OSError: no answer; whether a command was carried out is unknown.
        """
        until = time.monotonic() + limit_s
        for _ in range(ATTEMPTS):
            left_s = max(1e-3, until - time.monotonic())
            one = self._taken(left_s)
            try:
                answer, found = one.ask(key, payload or b"", left_s)
            except _NotTakenError:
                self._give_back(one, keep=False)
                continue
            except OSError:
                self._give_back(one, keep=False)
                raise
            self._give_back(one, keep=answer.number > 0)
            return answer.good, found
        raise ConnectionError("the gateway ends every connection")

    def follow_state(self, mailbox: Mailbox) -> None:
        """Put every state from now on into a mailbox until it is closed, also of gateways to come, in a thread."""
        threading.Thread(target=self._follow, args=(mailbox,), name="states", daemon=True).start()

    def _follow(self, mailbox: Mailbox) -> None:
        while not mailbox.closed and not self._closed:
            with contextlib.suppress(OSError):
                one = self._opened(SILENCE_S)
                mailbox.on_close(one.end)
                try:
                    answer, _ = one.ask(STATE, b"", SILENCE_S, follow=True)
                    while answer.good and not mailbox.closed:
                        answer, state = one.read(SILENCE_S)
                        if answer.good:
                            mailbox.put(state)
                finally:
                    mailbox.on_close(None)
                    self._give_back(one, keep=False)
            if not mailbox.closed:
                time.sleep(AGAIN_S)

    def _taken(self, limit_s: float) -> _SocketSession:
        while True:
            with self._lock:
                one = self._idle.pop() if self._idle else None
                if one is not None:
                    self._used.add(one)
            if one is None:
                return self._opened(limit_s)
            if not one.has_ended():
                return one
            self._give_back(one, keep=False)

    def _opened(self, limit_s: float) -> _SocketSession:
        one = _SocketSession(self._place, limit_s)
        with self._lock:
            if not self._closed:
                self._used.add(one)
                return one
        one.close()
        raise ConnectionError("the connection is closed")

    def _give_back(self, one: _SocketSession, *, keep: bool) -> None:
        with self._lock:
            self._used.discard(one)
            keep = keep and not self._closed and len(self._idle) < _KEPT
            if keep:
                self._idle.append(one)
        if not keep:
            one.close()

    def close(self) -> None:
        """End all connections; who waits for an answer gets none."""
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
            for one in self._used:
                one.end()
        for one in idle:
            one.close()
