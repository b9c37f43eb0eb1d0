"""``python -m tests.bench.flood KIND ENDPOINT RIG SECONDS``: one peer's flood of a daemon, on loopback alone.

At an endpoint ``tls/`` the peer has the key of ``RIGCTL_KEY``.

It begins at once, prints one line of JSON when it is under way, ends by itself after SECONDS (at most ``SECONDS_MAX``)
and prints its counts. Every kind is bounded in number too.
"""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import pwd
import selectors
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import zenoh

from rigctl.client.connection import credentials_of
from rigctl.client.local_daemons import local_daemons, meant
from rigctl.control.realtime import die_with_parent
from rigctl.ipc.folder_places import COMMAND_SOCKET
from rigctl.ipc.hold_socket import socket_name
from rigctl.wire.keys import Keys
from rigctl.wire.session import SessionError, close, open_client
from tests.builders.paths import ROOT

SECONDS_MAX = 120.0
OPENING_S = 45.0
HALF_OPEN, SESSIONS, STALLED = 400, 999, 8
OPENINGS_MAX, QUERIES_MAX, PAYLOADS_MAX = 50_000, 2_000_000, 200
OUTSTANDING_MAX = 256  # queries without a reply: more would only fill this process
PAYLOAD_BYTES = 8 << 20
USERS, CONNECTIONS = 8, 200
_OPENERS = 8


class Flood:
    """A flood's target, end time and counts so far."""

    def __init__(self, endpoint: str, rig: str, seconds: float) -> None:
        where = endpoint.removeprefix("tcp/").removeprefix("tls/")
        host, _, port = where.rpartition(":")
        if host != "127.0.0.1":
            raise SystemExit(f"found the endpoint {endpoint}, expected one on 127.0.0.1")
        self.endpoint, self.address, self.owned = endpoint, (host, int(port)), credentials_of(endpoint, None)
        self.keys = Keys(rig, self.owned.name if self.owned is not None else "")
        self.until = time.monotonic() + min(seconds, SECONDS_MAX)
        self.count = 0
        self._lock, self._said = threading.Lock(), False

    @property
    def over(self) -> bool:
        return time.monotonic() >= self.until

    def done(self, number: int = 1) -> None:
        """Add to the count."""
        with self._lock:
            self.count += number

    def under_way(self) -> None:
        """Report once that the flood is under way."""
        if not self._said:
            self._said = True
            say({"under_way": self.count})


def say(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def _kept_open(flood: Flood, number: int, opened: Callable[[], socket.socket]) -> None:
    """Keep ``number`` connections that send nothing; one that the other end closes is opened anew."""
    selector = selectors.DefaultSelector()
    there = 0
    while not flood.over and flood.count < OPENINGS_MAX:
        with contextlib.suppress(OSError):
            while there < number and not flood.over:
                connection = opened()
                connection.setblocking(False)
                selector.register(connection, selectors.EVENT_READ)
                there += 1
                flood.done()
        flood.under_way()
        for key, _ in selector.select(0.02):
            with contextlib.suppress(BlockingIOError, OSError):
                if key.fileobj.recv(4096):  # type: ignore[union-attr]
                    continue
            selector.unregister(key.fileobj)
            key.fileobj.close()  # type: ignore[union-attr]
            there -= 1


def half_open(flood: Flood) -> None:
    """Connections to the gateway's port that send nothing."""
    _kept_open(flood, HALF_OPEN, lambda: socket.create_connection(flood.address, 1.0))


def idle_sessions(flood: Flood) -> None:
    """Sessions that do nothing, as many as the gateway accepts."""
    opened: list[zenoh.Session] = []

    def open_some() -> None:
        while not flood.over and flood.count < SESSIONS:
            flood.done()
            with contextlib.suppress(SessionError):
                opened.append(open_client(flood.endpoint, flood.owned))

    threads = [threading.Thread(target=open_some) for _ in range(_OPENERS)]
    for thread in threads:
        thread.start()
    while not flood.over and len(opened) < 100 and any(thread.is_alive() for thread in threads):
        time.sleep(0.05)
    flood.under_way()
    for thread in threads:
        thread.join()
    time.sleep(max(0.0, flood.until - time.monotonic()))
    flood.count = len(opened)


def _opened(flood: Flood) -> zenoh.Session:
    """A session, tried for again while the flood before this one still has every place of the router."""
    until = time.monotonic() + OPENING_S
    while True:
        try:
            return open_client(flood.endpoint, flood.owned)
        except SessionError:
            if time.monotonic() > until:
                raise


@contextlib.contextmanager
def _session(flood: Flood) -> Iterator[zenoh.Session]:
    session = _opened(flood)
    try:
        yield session
    finally:
        close(session)


def _forget(_reply: zenoh.Reply) -> None:
    pass


def _asking(flood: Flood, name: str, payload: Callable[[int], bytes], most: int) -> None:
    """Queries as fast as one peer can send them, at most ``OUTSTANDING_MAX`` without a reply."""
    room = threading.Semaphore(OUTSTANDING_MAX)
    with _session(flood) as session:
        for number in range(most):
            if flood.over:
                return
            if not room.acquire(timeout=0.2):
                continue
            # The drop of a query's handler is the end of the query, answered or not.
            session.get(
                flood.keys.command(name),
                handler=zenoh.handlers.Callback(_forget, drop=room.release),
                payload=payload(number),
                timeout=2.0,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            flood.done()
            if number >= OUTSTANDING_MAX:
                flood.under_way()


def _body(**values: Any) -> bytes:
    return msgspec.json.encode(values)


def queries(flood: Flood) -> None:
    """One command repeatedly."""
    _asking(flood, "tension", lambda _: _body(operator="flood"), QUERIES_MAX)


def names(flood: Flood) -> None:
    """A command under a new operator name each time."""
    _asking(flood, "tension", lambda number: _body(operator=f"flood{number}"), QUERIES_MAX)


def holds(flood: Flood) -> None:
    """HOLD repeatedly, over the network."""
    _asking(flood, "hold", lambda _: _body(operator="flood"), QUERIES_MAX)


def users_holds(flood: Flood) -> None:
    """HOLD on the loop's own sockets by ``USERS`` users of this computer, each as fast as the loop takes it.

    Other users' processes need root; else they are all of this user.
    """
    (daemon,) = meant(local_daemons(), flood.endpoint, flood.keys.rig)
    others = [one for one in pwd.getpwall() if one.pw_uid != os.geteuid()] if os.geteuid() == 0 else []
    users = [(one.pw_uid, one.pw_gid) for one in others[:USERS]] or [(os.geteuid(), os.getegid())] * USERS
    for uid, gid in users:
        if os.fork() == 0:
            os.setresgid(gid, gid, gid)
            os.setresuid(uid, uid, uid)
            die_with_parent(signal.SIGKILL)  # a change of user ends an earlier one
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
                own.connect(str(daemon.place.place(socket_name(uid))))
                while not flood.over:
                    own.send(b"flood")  # waits while the queue is full
            os._exit(0)
        flood.done()
    flood.under_way()
    time.sleep(max(0.0, flood.until - time.monotonic()))


def idle_connections(flood: Flood) -> None:
    """Connections of the operator's own user to the command socket that send nothing."""
    (daemon,) = meant(local_daemons(), flood.endpoint, flood.keys.rig)
    place = str(daemon.place.place(COMMAND_SOCKET))

    def opened() -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.setblocking(False)  # a full backlog is refused at once
        connection.connect(place)
        return connection

    _kept_open(flood, CONNECTIONS, opened)


def lease_take(flood: Flood) -> None:
    """The lease repeatedly taken over from its holder."""
    _asking(flood, "lease_take", lambda n: _body(operator=f"flood{n % 50}", reason="flood"), QUERIES_MAX)


def payloads(flood: Flood) -> None:
    """Commands of 8 MiB."""
    large = b'{"operator": "' + b"x" * PAYLOAD_BYTES + b'"}'
    with _session(flood) as session:
        for _ in range(PAYLOADS_MAX):
            if flood.over:
                return
            for _ in session.get(flood.keys.command("tension"), payload=large, timeout=0.2):
                pass
            flood.done()
            flood.under_way()
        flood.under_way()
    time.sleep(max(0.0, flood.until - time.monotonic()))


def forged(flood: Flood) -> None:
    """States put in the daemon's name; with certificates each is refused."""
    with _session(flood) as session:
        for number in range(QUERIES_MAX):
            if flood.over:
                return
            session.put(flood.keys.state, b"forged", congestion_control=zenoh.CongestionControl.DROP)
            flood.done()
            if number >= OUTSTANDING_MAX:
                flood.under_way()


def handshakes(flood: Flood) -> None:
    """TLS connections without a certificate, again and again: each costs the other end a signature."""
    anyone = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    anyone.check_hostname, anyone.verify_mode = False, ssl.CERT_NONE

    def open_some() -> None:
        while not flood.over and flood.count < OPENINGS_MAX:
            with (
                contextlib.suppress(OSError),
                socket.create_connection(flood.address, 1.0) as plain,
                anyone.wrap_socket(plain, server_hostname="localhost") as secure,
            ):
                secure.recv(1)
            flood.done()
            flood.under_way()

    threads = [threading.Thread(target=open_some) for _ in range(_OPENERS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def stalled(flood: Flood) -> None:
    """Subscribers to all keys that stop reading."""
    command = [sys.executable, "-m", "tests.bench.flood", "subscriber", flood.endpoint, flood.keys.rig, "120"]
    children = [subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) for _ in range(STALLED)]
    try:
        for child in children:
            assert child.stdout is not None
            child.stdout.readline()
            child.send_signal(signal.SIGSTOP)
            flood.done()
        flood.under_way()
        time.sleep(max(0.0, flood.until - time.monotonic()))
    finally:
        for child in children:
            child.kill()
            child.wait()


def subscriber(flood: Flood) -> None:
    """One of the stalled subscribers."""
    die_with_parent(signal.SIGKILL)
    with _session(flood) as session:
        session.declare_subscriber("rigctl/**", lambda _sample: None)
        time.sleep(0.5)
        flood.under_way()
        time.sleep(max(0.0, flood.until - time.monotonic()))


KINDS = {
    "half_open": half_open,
    "idle_sessions": idle_sessions,
    "queries": queries,
    "names": names,
    "payloads": payloads,
    "stalled": stalled,
    "lease_take": lease_take,
    "holds": holds,
    "forged": forged,
    "users_holds": users_holds,
    "idle_connections": idle_connections,
}
TLS_KINDS = {**KINDS, "handshakes": handshakes}
"""Floods of a daemon that listens with certificates."""


def main(words: list[str]) -> int:
    kind, endpoint, rig, seconds = words
    flood = Flood(endpoint, rig, float(seconds))
    (TLS_KINDS | {"subscriber": subscriber})[kind](flood)
    say({"done": flood.count})
    sys.stdout.flush()
    os._exit(0)  # Zenoh's own shutdown of hundreds of sessions is slow


@contextlib.contextmanager
def flooding(
    kind: str, endpoint: str, rig: str, seconds: float, key: pathlib.Path | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A flood in a process of its own, under way when the block begins, ended with it."""
    command = [sys.executable, "-m", "tests.bench.flood", kind, endpoint, rig, str(seconds)]
    given = {**os.environ, **({"RIGCTL_KEY": str(key)} if key is not None else {})}
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=given) as child:
        try:
            assert child.stdout is not None
            if not child.stdout.readline():
                raise RuntimeError(f"the flood {kind} ended before it was under way")
            yield child
        finally:
            child.kill()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
