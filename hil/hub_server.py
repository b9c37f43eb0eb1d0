"""The hub for other processes: a Unix SEQPACKET socket, one 16-byte frame per packet.

Single-threaded and non-blocking. A client that comes, goes, stalls or sends rubbish affects no other client.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import pathlib
import select
import socket
import stat

from hil.hub import Hub
from hil.wire import FRAME_SIZE

SEND_BUFFER_BYTES = 4 << 20
"""Send buffer of a client in the kernel (about 768 bytes a frame): 0.4 s of a busy bus, where the system grants it."""

FRAMES_PER_TURN = 64
"""Frames taken from one client before the others have their turn."""

_SO_SNDBUFFORCE = 32


class SocketRefusedError(OSError):
    """The socket cannot be served; ``str()`` is one line that names its path."""


class HubServer:
    """Accepts clients on ``path`` and makes each a port of ``hub``.

    Args:
        path: file name of the socket, below 108 bytes.
        hub: the wire.

    Raises:
        SocketRefusedError: another server is alive there, or the path cannot be used.
    """

    def __init__(self, path: str | pathlib.Path, hub: Hub) -> None:
        self.path = pathlib.Path(path)
        self.received = 0
        self.delivered = 0
        self.lost = 0
        self.malformed = 0
        self.clients_seen = 0
        self._hub = hub
        self._clients: dict[int, _Client] = {}
        self._lock = _PathLock(self.path)
        try:
            self._listener = _listen(self.path)
        except BaseException:
            self._lock.release()
            raise
        self._epoll = select.epoll()
        self._epoll.register(self._listener.fileno(), select.EPOLLIN)

    @property
    def clients(self) -> int:
        """Clients connected now."""
        return len(self._clients)

    @property
    def lost_per_client(self) -> list[int]:
        """Frames each connected client has lost because its socket was full, oldest client first."""
        return [client.lost for client in self._clients.values()]

    def fileno(self) -> int:
        """Readable when ``poll`` has something to do, for use in another selector."""
        return self._epoll.fileno()

    def poll(self, timeout_s: float) -> None:
        """Wait at most ``timeout_s`` for traffic, then receive it: one turn for every client."""
        for fd, _ in self._epoll.poll(timeout_s):
            client = self._clients.get(fd)
            if client is not None:
                client.take_in(FRAMES_PER_TURN)
            else:
                self._accept()
        for client in [c for c in self._clients.values() if c.gone]:
            self._dismiss(client)

    def close(self) -> None:
        """Disconnect the clients and remove the socket file; closing again changes nothing."""
        if self._epoll.closed:
            return
        for client in list(self._clients.values()):
            self._dismiss(client)
        self._epoll.close()
        self._listener.close()
        self.path.unlink(missing_ok=True)
        self._lock.release()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # the client has left already, or no descriptor is free
            return
        connection.setblocking(False)
        _widen(connection)
        client = _Client(self, self._hub, connection)
        self._clients[connection.fileno()] = client
        self._epoll.register(connection.fileno(), select.EPOLLIN | select.EPOLLRDHUP)
        self.clients_seen += 1

    def _dismiss(self, client: _Client) -> None:
        del self._clients[client.fileno()]
        self._epoll.unregister(client.fileno())
        client.close()


class _Client:
    """One connection and its port."""

    __slots__ = ("_connection", "_port", "_send", "_server", "gone", "lost")

    def __init__(self, server: HubServer, hub: Hub, connection: socket.socket) -> None:
        self.gone = False
        self.lost = 0
        self._server = server
        self._connection = connection
        self._send = connection.send
        self._port = hub.attach(self._give)

    def fileno(self) -> int:
        return self._connection.fileno()

    def take_in(self, most: int) -> None:
        """Put at most ``most`` waiting frames on the wire."""
        recv = self._connection.recv
        server = self._server
        for _ in range(most):
            try:
                packet = recv(FRAME_SIZE + 1)
            except BlockingIOError:
                return
            except OSError:
                self.gone = True
                return
            if len(packet) == FRAME_SIZE:
                server.received += 1
                self._port.send(packet)
            elif packet or not self._hung_up():
                server.malformed += 1
            else:
                self.gone = True
                return

    def close(self) -> None:
        self._port.hub.detach(self._port)
        self._connection.close()

    def _give(self, frame: bytes) -> None:
        if self.gone:
            return
        try:
            self._send(frame)
            self._server.delivered += 1
        except BlockingIOError:
            self.lost += 1
            self._server.lost += 1
        except OSError:  # EPIPE, ECONNRESET: disconnected at the end of this turn
            self.gone = True

    def _hung_up(self) -> bool:
        """Whether an empty packet is the end of the connection (a client may also send one of no bytes)."""
        probe = select.poll()
        probe.register(self._connection, select.POLLRDHUP)
        return bool(probe.poll(0))


class _PathLock:
    """Exclusive right to a socket path: a locked file beside it, which the kernel unlocks when the process dies."""

    def __init__(self, path: pathlib.Path) -> None:
        self._path = path.with_name(path.name + ".lock")
        while True:
            try:
                self._fd = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            except OSError as error:
                raise SocketRefusedError(f"{path}: cannot be served: {error.strerror}") from None
            try:
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(self._fd)
                raise SocketRefusedError(f"{path}: another simulated rig is being served here") from None
            if self._is_current():
                return
            os.close(self._fd)  # the owner removed the file between open and lock

    def release(self) -> None:
        self._path.unlink(missing_ok=True)
        os.close(self._fd)

    def _is_current(self) -> bool:
        try:
            return os.path.samestat(self._path.stat(), os.fstat(self._fd))
        except FileNotFoundError:
            return False


def _listen(path: pathlib.Path) -> socket.socket:
    """A listening socket at ``path``, which replaces the file of a dead server."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
    try:
        if path.exists() or path.is_symlink():
            _remove_stale(path)
        listener.bind(str(path))
        listener.listen(64)
    except SocketRefusedError:
        listener.close()
        raise
    except OSError as error:
        listener.close()
        raise SocketRefusedError(f"{path}: cannot be served: {error.strerror or error}") from None
    return listener


def _remove_stale(path: pathlib.Path) -> None:
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise SocketRefusedError(f"{path}: exists and is not a socket")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        answer = probe.connect_ex(str(path))
    if answer != errno.ECONNREFUSED:
        raise SocketRefusedError(f"{path}: another server owns this socket")
    path.unlink()


def _widen(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    with contextlib.suppress(PermissionError):  # exceeds the system's limit, but needs the privilege
        connection.setsockopt(socket.SOL_SOCKET, _SO_SNDBUFFORCE, SEND_BUFFER_BYTES)
