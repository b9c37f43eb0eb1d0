"""The connections that Zenoh's router in this process has accepted: whose they are, and their end.

Zenoh names the certificate of a session (`SessionInfo.links`), and has neither a limit for each client nor a call that
closes one. Its sockets are this process's own: each is found in ``/proc/self/fd`` and shut down, which
ends its session.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import pathlib
import resource
import socket
import stat
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import zenoh

from rigctl.gateway.places import Connection
from rigctl.gateway.tcp_table import End, end, owners

DESCRIPTORS = 8192
"""Descriptors that the gateway may have open: a flood within one period of 20 ms uses up no more."""
_FDS = pathlib.Path("/proc/self/fd")
_CREDENTIALS = struct.Struct("3i")  # struct ucred: pid, uid, gid


def raise_limit() -> None:
    """Let this process have ``DESCRIPTORS``, as far as its hard limit and service allow."""
    with contextlib.suppress(OSError, ValueError):
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        most = DESCRIPTORS if hard == resource.RLIM_INFINITY else min(DESCRIPTORS, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, most), hard))


def user(uid: int) -> str:
    """Name of a local user as an identity."""
    return f"local uid {uid}"


@dataclass
class _Accepted:
    fd: int
    inode: int
    connection: Connection
    ends: tuple[End, End] | None  # the other end and this one; None for a Unix socket


class AcceptedSockets:
    """The accepted connections of the endpoints ``tcp/``, ``tls/`` and ``unixsock-stream/`` of one router."""

    def __init__(self, endpoints: Iterable[str]) -> None:
        self._ports: set[int] = set()
        self._paths: set[str] = set()
        self._certified = False
        for endpoint in endpoints:
            protocol, _, where = endpoint.partition("/")
            self._certified |= protocol == "tls"
            if protocol == "unixsock-stream":
                self._paths.add(where)
            else:
                self._ports.add(int(where.rpartition(":")[2]))
        self._known: dict[tuple[int, int], _Accepted | None] = {}  # by descriptor and inode; None: no such connection
        self._number = 0
        self._listening = set[tuple[int, int]]()  # by descriptor and inode

    @property
    def listens(self) -> bool:
        """Whether the router had its endpoint of the network at the last `read`."""
        return bool(self._listening) or not self._ports

    def read(self, info: zenoh.SessionInfo, now_s: float) -> list[Connection]:
        """Every connection now."""
        present, new = set[tuple[int, int]](), dict[tuple[int, int], _Accepted]()
        for fd in _descriptors():
            with contextlib.suppress(OSError):
                found = os.fstat(fd)
                if not stat.S_ISSOCK(found.st_mode):
                    continue
                present.add(mark := (fd, found.st_ino))
                if mark not in self._known:
                    self._known[mark] = made = self._made(*mark, now_s)
                    if made is not None and made.ends is not None:
                        new[mark] = made
        for mark in self._known.keys() - present:
            del self._known[mark]
        self._listening &= present
        self._name_users(new.values())
        accepted = [one for one in self._known.values() if one is not None]
        self._name_sessions(accepted, info)
        return [one.connection for one in accepted]

    def close(self, connection: Connection) -> None:
        """End a connection; its session ends with it."""
        for one in self._known.values():
            if one is not None and one.connection.number == connection.number:
                with contextlib.suppress(OSError), _socket_of(one.fd) as own:
                    if os.fstat(own.fileno()).st_ino == one.inode:  # else Zenoh has closed it, and the number is reused
                        own.shutdown(socket.SHUT_RDWR)
                return

    def _made(self, fd: int, inode: int, now_s: float) -> _Accepted | None:
        with contextlib.suppress(OSError, ValueError), _socket_of(fd) as own:
            if own.type != socket.SOCK_STREAM:
                return None
            here = own.getsockname()
            if own.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                if own.family in (socket.AF_INET, socket.AF_INET6) and here[1] in self._ports:
                    self._listening.add((fd, inode))
                return None
            if own.family == socket.AF_UNIX and here in self._paths:
                pid, uid, _ = _CREDENTIALS.unpack(own.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
                if pid == os.getpid():  # the gateway's own session for commands
                    return None
                self._number += 1
                return _Accepted(fd, inode, Connection(self._number, now_s, user(uid), user(uid)), None)
            if own.family in (socket.AF_INET, socket.AF_INET6) and here[1] in self._ports:
                there = end(*own.getpeername()[:2])
                self._number += 1
                return _Accepted(
                    fd, inode, Connection(self._number, now_s, _network(there[0])), (there, end(*here[:2]))
                )
        return None

    @staticmethod
    def _name_users(accepted: Iterable[_Accepted]) -> None:
        """Name the user of each connection from this computer; one of another network namespace keeps its address."""
        local = list(accepted)
        if not local:
            return
        users = owners({one.ends[1][1] for one in local if one.ends is not None})
        for one in local:
            if one.ends is not None and (uid := users.get(one.ends)) is not None:
                one.connection = replace(one.connection, source=user(uid))

    def _name_sessions(self, accepted: Iterable[_Accepted], info: zenoh.SessionInfo) -> None:
        opening = {one.ends[0]: one for one in accepted if one.ends is not None and one.connection.identity is None}
        if not opening:
            return
        for link in info.links():
            address, _, port = str(link.dst).partition("/")[2].rpartition(":")
            with contextlib.suppress(ValueError):  # of a Unix socket
                if (one := opening.get(end(address, int(port)))) is not None:
                    identity = (link.auth_identifier or "") if self._certified else one.connection.source
                    one.connection = replace(one.connection, identity=identity)


def _descriptors() -> Iterable[int]:
    """Numbers of this process's descriptors; all that it may have, where none is left to read their list with."""
    try:
        return [int(entry.name) for entry in _FDS.iterdir()]
    except OSError as error:
        if error.errno != errno.EMFILE:
            raise
        return range(resource.getrlimit(resource.RLIMIT_NOFILE)[0])


@contextlib.contextmanager
def _socket_of(fd: int) -> Iterator[socket.socket]:
    """A socket of Zenoh's by a second descriptor, which no other socket can take over meanwhile.

    Where no descriptor is left, by Zenoh's own: else those that use them all up could neither be seen nor closed.
    """
    try:
        number = os.dup(fd)
    except OSError as error:
        if error.errno != errno.EMFILE:
            raise
        own = socket.socket(fileno=fd)
        try:
            yield own
        finally:
            own.detach()
        return
    try:
        own = socket.socket(fileno=number)
    except OSError:  # no socket by now, and the constructor leaves the descriptor open
        os.close(number)
        raise
    with own:
        yield own


def _network(address: str) -> str:
    """The source of an address: of IPv6 the network of 64 bits, in which one computer may use every address."""
    found = ipaddress.ip_address(address)
    return str(ipaddress.ip_network((found, 64), strict=False)) if found.version == 6 else address
