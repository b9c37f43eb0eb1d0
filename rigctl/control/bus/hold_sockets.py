"""HOLD from the users of this computer: the loop's own datagram sockets, one for each user.

Nothing that a user does on his socket delays the loop or another user's HOLD:

- A tick takes at most one datagram, without waiting. Of sockets with a datagram each has its turn.
- A socket of which one was taken rests for ``REST_NS``: the others wait in its queue, and the sender behind that.
- A user's socket admits his processes alone (POSIX access list); who has none shares the socket of the others.
- A descriptor sent along (SCM_RIGHTS) would be closed in the tick, and closing one can block: a TCP socket with
  SO_LINGER, a file of a hung file system. The kernel refuses it where it can (Linux 6.16); else the datagram is left in
  its queue, and that socket is read no more.
- Answers go to abstract addresses only: to look up a path in a sender's file system could block.
"""

from __future__ import annotations

import contextlib
import os
import pwd
import resource
import select
import socket
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple, Protocol

from rigctl.ipc import access_list
from rigctl.ipc.access_list import READ_WRITE
from rigctl.ipc.hold_socket import (
    CREDENTIALS,
    CREDENTIALS_ROOM,
    HOLD_SOCKETS,
    NAME_BYTES,
    HoldAnswer,
    socket_name,
)
from rigctl.ipc.runtime_folder import Runtime

REST_NS = 20_000_000
USERS_MAX = 250
_UNANSWERED_MAX = 16
_ARMED = select.EPOLLIN | select.EPOLLONESHOT
_WRITES = bytes(ord("?") if code < 0x20 or code == 0x7F else code for code in range(256))  # on a terminal
_SO_PASSRIGHTS = 83  # <asm-generic/socket.h>
_PEEK = socket.MSG_DONTWAIT | socket.MSG_PEEK


class Hold(NamedTuple):
    """A HOLD as it came: user and process as the kernel says, the operator's name in the sender's words."""

    uid: int
    pid: int
    operator: str
    closed: bool = False  # its socket is read no more: it sent a descriptor


class HoldSource(Protocol):
    """Where the loop takes HOLD from."""

    def take(self, t_ns: int) -> Hold | None:
        """The HOLD for the tick at ``t_ns``, if there is one."""

    def answer(self, taken_ns: int, answer: HoldAnswer) -> None:
        """Answer the HOLD that was taken at ``taken_ns``."""


class GivenHolds(deque[Hold]):
    """HOLDs that a program puts in, one for each tick: of a simulated rig or a recording."""

    def take(self, t_ns: int) -> Hold | None:  # noqa: ARG002
        """See `HoldSource`."""
        return self.popleft() if self else None

    def answer(self, taken_ns: int, answer: HoldAnswer) -> None:
        """See `HoldSource`; the answer is in the ring of replies."""


class HoldSockets:
    """Datagram sockets that the loop reads HOLD from."""

    def __init__(self, sockets: Iterable[socket.socket]) -> None:
        """``sockets``: each `prepared`."""
        self._epoll = select.epoll()
        self._sockets = {one.fileno(): one for one in sockets}
        self._resting: deque[tuple[int, int]] = deque()  # when each may be read again, and its descriptor
        self._unanswered: dict[int, tuple[socket.socket, bytes]] = {}  # by the time of the tick that has taken it
        for one in self._sockets.values():
            self._epoll.register(one, _ARMED)

    @classmethod
    def of(cls, runtime: Runtime) -> HoldSockets:
        """The sockets in the run-time folder, made in place of those that a loop before has left.

        Raises:
            OSError: one cannot be made.
        """
        apart, own = _users(), os.geteuid()
        made = [_bound(runtime, own)]
        for uid in apart:
            if uid != own:
                try:
                    made.append(_of_user(runtime, uid))
                except OSError:  # a file system without access lists, or without room: all others share a socket
                    apart = []
                    break
        made.append(_bound(runtime, None))
        if apart:
            others = dict.fromkeys(apart, 0)
            access_list.admit(runtime.place(socket_name(None)), users=others, others=READ_WRITE)
        names = {socket_name(uid) for uid in (*apart, own, None)}
        for path in runtime.directory.glob(f"{HOLD_SOCKETS}*"):
            if path.name not in names:  # of users that are no more
                path.unlink()
        return cls(made)

    def take(self, t_ns: int) -> Hold | None:
        """See `HoldSource`."""
        resting = self._resting
        if resting and t_ns >= resting[0][0]:
            self._epoll.modify(resting.popleft()[1], _ARMED)
        for descriptor, _ in self._epoll.poll(0, 1):
            return self._receive(self._sockets[descriptor], t_ns)
        return None

    def _receive(self, one: socket.socket, t_ns: int) -> Hold | None:
        closed = False
        try:
            data, ancillary, flags, address = one.recvmsg(NAME_BYTES, CREDENTIALS_ROOM, _PEEK)
            closed = bool(flags & socket.MSG_CTRUNC)  # there was more than the credentials: descriptors
            if not closed:
                one.recv(1, socket.MSG_DONTWAIT)
        except OSError:
            return None
        finally:
            if not closed:
                self._resting.append((t_ns + REST_NS, one.fileno()))
        if isinstance(address, bytes) and address.startswith(b"\0"):
            if len(self._unanswered) >= _UNANSWERED_MAX:
                self._unanswered.clear()
            self._unanswered[t_ns] = one, address
        pid, uid, _gid = CREDENTIALS.unpack(ancillary[0][2]) if ancillary else (0, 0xFFFFFFFF, 0)
        name = data.translate(_WRITES).decode(errors="replace")
        if not name.isprintable():  # a loop over its letters would take a tenth of a tick
            name = name.encode("ascii", "replace").decode()
        return Hold(uid, pid, name, closed)

    def answer(self, taken_ns: int, answer: HoldAnswer) -> None:
        """See `HoldSource`."""
        if (asked := self._unanswered.pop(taken_ns, None)) is not None:
            one, address = asked
            with contextlib.suppress(OSError):  # the sender has gone, or does not read
                one.sendto(answer.packed(), socket.MSG_DONTWAIT, address)

    def close(self) -> None:
        """Close the sockets; their files stay until the folder is deleted."""
        self._epoll.close()
        for one in self._sockets.values():
            one.close()


def prepared(one: socket.socket) -> socket.socket:
    """A socket with the options that it needs before anybody can send to it."""
    one.setblocking(False)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
    with contextlib.suppress(OSError):
        one.setsockopt(socket.SOL_SOCKET, _SO_PASSRIGHTS, 0)
    return one


def _of_user(runtime: Runtime, uid: int) -> socket.socket:
    """A socket in the folder that this user alone can open."""
    one = _bound(runtime, uid)
    try:
        access_list.admit(runtime.place(socket_name(uid)), users={uid: READ_WRITE})
    except OSError:
        one.close()
        raise
    return one


def _bound(runtime: Runtime, uid: int | None) -> socket.socket:
    """A user's socket in the folder. The one before goes right before, so that its room is free for this one."""
    place = runtime.place(socket_name(uid))
    one = prepared(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    place.unlink(missing_ok=True)
    one.bind(str(place))
    place.chmod(0o666 if uid is None else 0o600)
    return one


def _users() -> list[int]:
    """The users of this computer, at most ``USERS_MAX``: root and persons before the accounts of services."""
    found = {entry.pw_uid for entry in pwd.getpwall()}
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return sorted(found, key=lambda uid: (0 < uid < 1000, uid))[: min(USERS_MAX, descriptors // 4)]
