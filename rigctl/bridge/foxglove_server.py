"""A server of the Foxglove WebSocket protocol: channels and parameters to every client, and no client slows another.

A message is handed to the operating system at once or kept for its client. A client that leaves more than
``BACKLOG_BYTES`` untaken for ``FULL_S``, or does not answer a ping for ``PATIENCE_S``, is disconnected and counted.
"""

from __future__ import annotations

import contextlib
import itertools
import secrets
import socket
import time
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from http import HTTPStatus
from urllib.parse import urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed, NegotiationError
from websockets.http11 import Request as Handshake
from websockets.http11 import Response
from websockets.protocol import State
from websockets.typing import Subprotocol

from rigctl.bridge import foxglove_protocol as protocol
from rigctl.bridge.foxglove_protocol import (
    SUBPROTOCOLS,
    Channel,
    GetParameters,
    Parameters,
    RequestRefusedError,
    SetParameters,
    Subscribe,
    SubscribeParameters,
    Unsubscribe,
    UnsubscribeParameters,
)
from rigctl.config.address import Address, names_server

BACKLOG_BYTES = 4 << 20
FULL_S = 10.0
"""A gateway that catches up sends seconds of records in one piece, which a client must have time to take."""
SENDING_BYTES = 1 << 18
"""What the operating system may keep for a client beside the backlog, so that a stalled one is noticed."""
PING_S, PATIENCE_S = 5.0, 20.0
CLIENTS = 16
REQUEST_BYTES = 1 << 16
READ_ONLY = "read-only: the rig's settings are those of its file; commands are given with rigctl"


class _Viewer:
    """A client: its connection, and what it asked for."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.numbers: dict[int, int] = {}  # channel by the client's number
        self.parameters: set[str] | None = set()  # names it follows, None for all
        self.dropped = False
        self.full_since: float | None = None  # monotonic time in s since which more than `BACKLOG_BYTES` are untaken

    def follows(self, name: str) -> bool:
        return self.parameters is None or name in self.parameters

    def numbers_of(self, channel: int) -> list[int]:
        return [number for number, known in self.numbers.items() if known == channel]


class FoxgloveServer:
    """Channels, parameters and clients; for one event loop."""

    def __init__(self, name: str, address: Address, origins: Collection[str], on_drop: Callable[[str], None]) -> None:
        """``origins``: of web pages that may connect beside those of this computer; ``on_drop`` is told why."""
        self.name = name
        self._address, self._origins, self._on_drop = address, frozenset(origins), on_drop
        self._session = secrets.token_hex(8)
        self._channels: dict[int, Channel] = {}
        self._parameters: Parameters = {}
        self._viewers: set[_Viewer] = set()
        self._numbers = itertools.count(1)
        self.dropped = 0
        """Slow clients disconnected so far."""

    @property
    def clients(self) -> int:
        """Clients connected now."""
        return len(self._viewers)

    @contextlib.asynccontextmanager
    async def serving(self, listening: socket.socket) -> AsyncIterator[None]:
        """Serve on a socket that listens, within the context."""
        async with serve(
            self._serve,
            sock=listening,
            subprotocols=[Subprotocol(name) for name in SUBPROTOCOLS],
            select_subprotocol=_chosen,
            process_request=self._admit,
            compression=None,  # numbers of 64 bits, which a local network carries faster than they are compressed
            max_size=REQUEST_BYTES,
            ping_interval=PING_S,
            ping_timeout=PATIENCE_S,
            close_timeout=1.0,
            server_header=None,
        ):
            yield

    # -- what is on offer -----------------------------------------------------------------------------------
    def offer(self, topic: str, encoding: str, schema_name: str, schema: str, schema_encoding: str) -> Channel:
        """Add a channel; clients are told."""
        channel = Channel(next(self._numbers), topic, encoding, schema_name, schema, schema_encoding)
        self._channels[channel.id] = channel
        self._tell_all(protocol.advertise([channel]))
        return channel

    def withdraw(self, channel: Channel) -> None:
        """Take a channel away; clients are told."""
        del self._channels[channel.id]
        for viewer in self._viewers:
            for number in viewer.numbers_of(channel.id):
                del viewer.numbers[number]
        self._tell_all(protocol.unadvertise([channel.id]))

    def is_wanted(self, channel: Channel) -> bool:
        """Whether a client has subscribed to it."""
        return any(channel.id in viewer.numbers.values() for viewer in self._viewers)

    def publish(self, channel: Channel, wall_ns: Sequence[int], payloads: Sequence[bytes]) -> None:
        """Send messages, oldest first, with their times on the wall clock, to those who subscribed."""
        for viewer in list(self._viewers):
            for number in viewer.numbers_of(channel.id):
                self._send(viewer, [protocol.message_data(number, *one) for one in zip(wall_ns, payloads, strict=True)])

    def set_parameters(self, values: Parameters) -> None:
        """Replace the parameters; clients that follow one that changed are told."""
        old, self._parameters = self._parameters, values
        changed = {name: value for name, value in values.items() if name not in old or old[name] != value}
        for viewer in list(self._viewers):
            if news := {name: value for name, value in changed.items() if viewer.follows(name)}:
                self._send(viewer, [protocol.parameter_values(news)])

    # -- clients --------------------------------------------------------------------------------------------
    def _admit(self, connection: ServerConnection, handshake: Handshake) -> Response | None:
        """Refuse a web page that is none of this computer's, a foreign name for it, and too many clients."""
        if not names_server(handshake.headers.get("Host", ""), self._address):
            return connection.respond(HTTPStatus.MISDIRECTED_REQUEST, "this server does not go by that name\n")
        if len(self._viewers) >= CLIENTS:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{CLIENTS} clients are connected already\n")
        origin = handshake.headers.get("Origin")
        if origin is not None and not self._is_allowed(origin):
            words = f"found a page of {origin[:100]}, which may not connect; --origin allows it\n"
            return connection.respond(HTTPStatus.FORBIDDEN, words)
        return None

    def _is_allowed(self, origin: str) -> bool:
        if origin in self._origins:
            return True
        parts = urlsplit(origin)
        return parts.scheme in ("http", "https") and parts.hostname in ("localhost", "127.0.0.1", "::1",
                                                                        self._address.host)  # fmt: skip

    async def _serve(self, connection: ServerConnection) -> None:
        viewer = _Viewer(connection)
        if (transport_socket := connection.transport.get_extra_info("socket")) is not None:
            transport_socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENDING_BYTES)
        self._viewers.add(viewer)
        try:
            self._send(viewer, [protocol.server_info(self.name, self._session)])
            self._send(viewer, [protocol.advertise(self._channels.values())])
            async for message in connection:
                try:
                    self._answer(viewer, message)
                except RequestRefusedError as error:
                    self._send(viewer, [protocol.status(protocol.ERROR, str(error))])
        except ConnectionClosed:
            pass
        finally:
            self._viewers.discard(viewer)
            ended = connection.protocol.close_sent
            if not viewer.dropped and ended is not None and "ping timeout" in ended.reason:
                self._count_drop(viewer, f"no answer to a ping for {PATIENCE_S:.0f} s")

    def _answer(self, viewer: _Viewer, message: str | bytes) -> None:
        match protocol.request_of(message):
            case Subscribe(subscriptions):
                for one in subscriptions:
                    if one.channel not in self._channels:
                        raise RequestRefusedError(f"found channel {one.channel}, expected one on offer")
                    if viewer.numbers.setdefault(one.id, one.channel) != one.channel or len(viewer.numbers) > 1024:
                        raise RequestRefusedError(f"found subscription {one.id} a second time, or too many")
            case Unsubscribe(ids):
                for number in ids:
                    viewer.numbers.pop(number, None)
            case GetParameters(names, number):
                self._send(viewer, [protocol.parameter_values(self._asked(names), number)])
            case SetParameters(_, number):
                self._send(viewer, [protocol.status(protocol.ERROR, READ_ONLY)])
                self._send(viewer, [protocol.parameter_values(self._parameters, number)])
            case SubscribeParameters(names):
                viewer.parameters = None if not names or viewer.parameters is None else viewer.parameters | {*names}
            case UnsubscribeParameters(names):
                viewer.parameters = (viewer.parameters or set()) - {*names} if names else set()

    def _asked(self, names: Collection[str]) -> Parameters:
        return {name: self._parameters[name] for name in names or self._parameters if name in self._parameters}

    def _tell_all(self, message: str) -> None:
        for viewer in list(self._viewers):
            self._send(viewer, [message])

    def _send(self, viewer: _Viewer, messages: Sequence[str | bytes]) -> None:
        """Hand messages over in one call to the operating system; disconnect a client that has left too much."""
        sender = viewer.connection.protocol
        if viewer.dropped or sender.state is not State.OPEN:
            return
        for message in messages:
            if isinstance(message, str):
                sender.send_text(message.encode())
            else:
                sender.send_binary(message)
        transport = viewer.connection.transport
        transport.write(b"".join(sender.data_to_send()))
        if transport.get_write_buffer_size() <= BACKLOG_BYTES:
            viewer.full_since = None
            return
        now = time.monotonic()
        if viewer.full_since is None:
            viewer.full_since = now
        if now - viewer.full_since >= FULL_S:
            transport.abort()
            self._count_drop(viewer, f"more than {BACKLOG_BYTES >> 20} MiB untaken")

    def _count_drop(self, viewer: _Viewer, why: str) -> None:
        viewer.dropped = True
        self.dropped += 1
        self._viewers.discard(viewer)
        host, port, *_ = viewer.connection.remote_address or ("unknown", 0)
        self._on_drop(f"client {Address(str(host), int(port))} was disconnected: {why}")


def _chosen(_connection: ServerConnection, offered: Sequence[Subprotocol]) -> Subprotocol:
    """The client's first sub-protocol that is known.

    Raises:
        NegotiationError: it knows none.
    """
    for name in offered:
        if name in SUBPROTOCOLS:
            return name
    raise NegotiationError(f"expected a sub-protocol {' or '.join(SUBPROTOCOLS)}")
