"""Sends each new head of the audit log to a syslog collector on another computer, where nobody here can change it.

Messages are RFC 5424, over UDP or over TCP with a line end after each (RFC 6587). A thread of its own sends them, so
that nothing waits for the network; while the collector is away, the newest are kept and the older are dropped: a head
covers every entry before it.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from collections import deque

from rigctl.config.address import Address
from rigctl.config.one_line import on_one_line
from rigctl.recorder.chain import AuditEntry

PRIORITY = 13 * 8 + 5  # facility "log audit", severity "notice"
KEPT = 256
CONNECT_S, RETRY_S = 3.0, 2.0


def message(entry: AuditEntry, head: str) -> bytes:
    """The message of one entry of the log; ``head``: its hash."""
    who = f"{entry.who}: " if entry.who else ""
    text = on_one_line(f"{entry.what} {who}{entry.text}")
    sender = f"{socket.gethostname()[:255] or '-'} rigctl {os.getpid()} audit -"
    return f"<{PRIORITY}>1 {entry.wall} {sender} {entry.rig} entry {entry.n} head {head} {text}\n".encode()


class AuditHost:
    """A collector. ``why``: why nothing can be sent now, empty if all is well."""

    def __init__(self, endpoint: str) -> None:
        """``endpoint``: ``tcp/HOST:PORT`` or ``udp/HOST:PORT``."""
        self.endpoint = endpoint
        protocol, _, where = endpoint.partition("/")
        address = Address.parse(where)
        self._tcp, self._address = protocol == "tcp", (address.host, address.port)
        self._waiting: deque[bytes] = deque(maxlen=KEPT)
        self._awake = threading.Condition()
        self._ending = False
        self.why = ""
        self._thread = threading.Thread(target=self._run, name="audit host", daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Queue a message; returns at once."""
        with self._awake:
            self._waiting.append(data)
            self._awake.notify()

    def close(self, limit_s: float) -> None:
        """Send the rest, for ``limit_s`` at most."""
        with self._awake:
            self._ending = True
            self._awake.notify()
        self._thread.join(limit_s)

    def _run(self) -> None:
        connection: socket.socket | None = None
        while True:
            with self._awake:
                self._awake.wait_for(lambda: self._waiting or self._ending)
                if not self._waiting:
                    break
                data = self._waiting[0]
            try:
                connection = connection or self._connected()
                if self._tcp and _has_ended(connection):
                    raise ConnectionResetError(0, "the collector has closed the connection")
                connection.sendall(data)
            except OSError as error:
                self.why = f"{self.endpoint} cannot be reached: {error.strerror or error}"
                if connection is not None:
                    connection.close()
                connection = None
                if self._ending:
                    break
                time.sleep(RETRY_S)
                continue
            self.why = ""
            with self._awake, contextlib.suppress(IndexError):
                if self._waiting[0] is data:  # it may have been dropped meanwhile
                    self._waiting.popleft()
        if connection is not None:
            connection.close()

    def _connected(self) -> socket.socket:
        if self._tcp:
            return socket.create_connection(self._address, CONNECT_S)
        (family, kind, _, _, address), *_ = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)
        found = socket.socket(family, kind)
        found.connect(address)
        return found


def _has_ended(connection: socket.socket) -> bool:
    """Whether the other end has closed it; a collector sends nothing."""
    readable, _, _ = select.select([connection], [], [], 0.0)
    return bool(readable) and not connection.recv(4096)
