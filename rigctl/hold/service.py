"""The hold service: a local socket, and a ring to the loop that carries nothing but HOLD.

It uses no network and needs no gateway, so neither a flood at the gateway nor a hanging gateway delays it. It has one
thread, in which every wait is bounded. A request is one packet with the payload of the command ``hold``; the answer is
one packet with the gateway's answer to that command and ``"via": "local socket"``.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import socket
import struct
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from rigctl.control.modes import Mode, Verb
from rigctl.control.realtime import die_with_parent
from rigctl.ipc.joining import UsageError, joined
from rigctl.ipc.record import COMMAND_LIFETIME_NS, HOLD_ID
from rigctl.ipc.ring import RingError
from rigctl.ipc.runtime_folder import FolderError, Runtime
from rigctl.ipc.termination import Termination
from rigctl.ipc.writers import OPERATORS, group_id
from rigctl.wire.command_request import Request, RequestError, answer, newest_record, parse, refused, silent

PRIORITY = 1  # SCHED_FIFO: below every loop, above a flooded gateway
POLL_S = 0.001  # while a hold waits for the loop
IDLE_S = 0.2
REQUEST_BYTES = 1024
CONNECTIONS_MAX = 32  # a new connection replaces the oldest idle one, so idle ones cannot block the service
SAYS_NOTHING_NS = 500_000_000  # a connection without a request is closed after this time
ANSWER_NS = COMMAND_LIFETIME_NS + 500_000_000  # the loop carries out no command older than its lifetime
SPACING_NS = 20_000_000  # between two slots of the ring; requests that arrive in between share the next one
VIA = "local socket"
_CREDENTIALS = struct.Struct("3i")  # struct ucred: pid, uid, gid


@dataclass(eq=False)
class Peer:
    """A connection, and the process at its other end."""

    socket: socket.socket
    pid: int
    uid: int
    since_ns: int
    request: Request | None = None


@dataclass
class Given:
    """A slot that was written, and the peers that wait for its reply."""

    until_ns: int
    peers: list[Peer] = field(default_factory=list)


class HoldService:
    """HOLD in at the socket, ``HOLD`` slots out, ``REPLY`` slots in, answers out."""

    def __init__(self, runtime: Runtime) -> None:
        """Listen.

        Raises:
            OSError: the socket cannot be created.
            RingError: the rings have another version.
        """
        self._holds, self._replies = runtime.holds.writer(), runtime.replies.reader()
        self._records = runtime.records.reader()
        self._peers: dict[int, Peer] = {}  # by file descriptor, the oldest first
        self._waiting: list[Peer] = []
        self._given: dict[int, Given] = {}
        self._last_id = self._next_ns = 0
        runtime.hold_socket.unlink(missing_ok=True)  # left by a killed service
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.setblocking(False)
        self._listener.bind(str(runtime.hold_socket))
        # In the installed service process and socket are of the operators' group: the kernel admits its members.
        self._operators_too = runtime.is_shared and os.getegid() == group_id(OPERATORS)
        runtime.hold_socket.chmod(0o660 if self._operators_too else 0o600)
        self._listener.listen(CONNECTIONS_MAX)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)

    def serve(self, stop: Termination) -> None:
        """Serve until ``stop``."""
        while not stop.requested:
            self.turn(POLL_S if self._waiting or self._given else IDLE_S)

    def turn(self, wait_s: float) -> None:
        """Wait for input, ``wait_s`` at most, and do what is due."""
        found = self._selector.select(wait_s)
        now_ns = time.monotonic_ns()
        for key, _ in found:
            if key.fileobj is self._listener:
                self._accept(now_ns)
            elif (peer := self._peers.get(key.fd)) is not None:
                self._read(peer)
        self._give(now_ns)
        self._collect(now_ns)
        for peer in [*self._peers.values()]:
            if peer.request is None and now_ns - peer.since_ns > SAYS_NOTHING_NS:
                self._close(peer)

    def close(self) -> None:
        """Close all connections and the socket."""
        for peer in [*self._peers.values()]:
            self._close(peer)
        self._selector.close()
        self._listener.close()

    def _accept(self, now_ns: int) -> None:
        with contextlib.suppress(OSError):  # the peer has closed again, or no descriptor is free
            connection, _ = self._listener.accept()
            connection.setblocking(False)
            found = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
            pid, uid, _gid = _CREDENTIALS.unpack(found)
            if len(self._peers) >= CONNECTIONS_MAX:
                idle = (peer for peer in self._peers.values() if peer.request is None)
                self._close(next(idle, next(iter(self._peers.values()))))
            self._peers[connection.fileno()] = Peer(connection, pid, uid, now_ns)
            self._selector.register(connection, selectors.EVENT_READ)

    def _read(self, peer: Peer) -> None:
        try:
            payload = peer.socket.recv(REQUEST_BYTES + 1)
        except BlockingIOError:
            return
        except OSError:
            payload = b""
        if not payload or peer.request is not None:  # a HOLD stays valid when its sender closes the connection
            self._selector.unregister(peer.socket)
            if peer.request is None:
                self._drop(peer)
            return
        try:
            if not self._operators_too and peer.uid not in (os.geteuid(), 0):
                raise RequestError(f"found a process of uid {peer.uid}, expected one of the daemon's user")
            if len(payload) > REQUEST_BYTES:
                raise RequestError(f"found more than {REQUEST_BYTES} bytes, expected a hold")
            peer.request = parse(Verb.HOLD, payload)
        except RequestError as error:
            self._answer(peer, refused("hold", "", "bad_request", str(error)))
            return
        self._waiting.append(peer)

    def _give(self, now_ns: int) -> None:
        """Write the waiting requests as one slot for the loop."""
        if not self._waiting or now_ns < self._next_ns:
            return
        if not self._given:
            self._replies.cursor = self._replies.head
        self._next_ns = now_ns + SPACING_NS
        self._last_id = id_ = max(self._last_id + 1, HOLD_ID | now_ns)
        names = dict.fromkeys(peer.request.operator for peer in self._waiting if peer.request is not None)
        first = self._waiting[0]
        self._holds.write(now_ns, id_, first.uid, first.pid, ", ".join(names).encode()[:256])
        self._given[id_] = Given(now_ns + ANSWER_NS, self._waiting)
        self._waiting = []

    def _collect(self, now_ns: int) -> None:
        if not self._given:
            return
        for reply in self._replies.read():
            if (given := self._given.pop(int(reply["id"]), None)) is not None:
                newest = newest_record(self._records)  # the record of the tick that took it, or a newer one
                for peer in given.peers:
                    if peer.request is not None:
                        self._answer(peer, answer(peer.request, reply, newest, (0.0, 0.0)))
        for id_ in [id_ for id_, given in self._given.items() if now_ns > given.until_ns]:
            for peer in self._given.pop(id_).peers:
                self._answer(peer, self._unanswered(peer, now_ns))

    def _unanswered(self, peer: Peer, now_ns: int) -> dict[str, Any]:
        """The answer without a reply of the loop, with what the last record shows."""
        message = silent("hold", peer.request.operator if peer.request is not None else "")
        record = self._records.latest()
        if record is None:
            return message
        mode, age_s = int(record["mode"]), (now_ns - int(record["t_ns"])) / 1e9
        name = Mode(mode).name if mode in Mode._value2member_map_ else str(mode)
        message["text"] += (
            f"; its last record, {age_s:.1f} s old, shows {name}, stroke {record['stroke_mm']:.2f} mm, "
            f"tension {record['tension_n']:z.1f} N"
        )
        return message

    def _answer(self, peer: Peer, message: dict[str, Any]) -> None:
        with contextlib.suppress(OSError):
            peer.socket.send(msgspec.json.encode(message | {"via": VIA}))
        self._close(peer)

    def _close(self, peer: Peer) -> None:
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(peer.socket)
        self._drop(peer)

    def _drop(self, peer: Peer) -> None:
        self._peers.pop(peer.socket.fileno(), None)
        peer.socket.close()


def main(arguments: Sequence[str], stop: Termination) -> int:
    """Run the hold service of the runtime folder named until ``stop``; returns the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_parent(signal.SIGTERM)
    try:
        if (run := joined(arguments, "hold", stop)) is None:
            return 0
        service = HoldService(run.runtime)
        run.show()
    except UsageError as error:
        sys.stderr.write(f"usage: python -m rigctl.hold {error}\n")
        return 2
    except (OSError, RingError, FolderError) as error:
        sys.stderr.write(f"hold: no socket for HOLD: {error}\n")
        return 1
    with contextlib.suppress(OSError):  # without the right it runs at normal priority
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    service.serve(stop)
    service.close()
    return 0
