"""Connections of the page's server: time for a request, number of connections, and room for a command.

Anyone who reaches the port may open connections without a request. A new connection is always accepted; at the limit
the oldest one that is neither a viewer nor a running command is closed for it, so an operator's HOLD is served. With
HTTPS the same holds before and during the handshake.
"""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from typing import Any

import h11
from starlette.datastructures import Headers
from uvicorn.protocols.http.h11_impl import H11Protocol

from rigctl.page.guard import Guard

CONNECTIONS = 256
VIEWERS = 32
"""Limit of streams. The rest exceeds what can be accepted in one turn of the event loop (BACKLOG)."""
BACKLOG = 128
REQUEST_S = 5.0  # for headers and body, after the opening or the last answer
ANSWER_S = 30.0  # to make and deliver the answer
HEADER_BYTES = 16_384


class BrowserConnection(H11Protocol):
    """One connection, until it is closed or becomes a viewer's stream."""

    guard: Guard
    tls: ssl.SSLContext | None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See `asyncio.Protocol`. It counts, and has its time, from before the handshake of TLS on."""
        super().connection_made(transport)
        self._opened_s, self._answering = self.loop.time(), False
        self._timer = self.loop.call_later(REQUEST_S, transport.abort)
        self._handshake: asyncio.Task[None] | None = None
        self._early = b""  # data between the end of the handshake and the turn of its task
        if self.tls is not None:
            self._handshake = self.loop.create_task(self._shake_hands(transport, self.tls))
        if len(self.connections) > CONNECTIONS:
            self._make_room()

    async def _shake_hands(self, plain: asyncio.Transport, tls: ssl.SSLContext) -> None:
        secured = None
        with contextlib.suppress(OSError):  # ssl.SSLError is one
            secured = await self.loop.start_tls(plain, self, tls, server_side=True, ssl_handshake_timeout=REQUEST_S)
        self._handshake = None
        if secured is None or plain.is_closing():
            plain.abort()
            self.connection_lost(None)
            return
        super().connection_made(secured)
        self._allow(REQUEST_S)
        if self._early:
            self.data_received(self._early)

    def _make_room(self) -> None:
        others = [one for one in self.connections if isinstance(one, BrowserConnection) and not one.commands]
        oldest = min(others, key=lambda one: one._opened_s)
        self.connections.discard(oldest)  # abort removes it only in the next turn, but its place is needed now
        oldest.transport.abort()

    @property
    def commands(self) -> bool:
        """Whether a command with a session is being carried out here."""
        if not self._answering or not self.scope["path"].startswith("/api/"):
            return False
        return self.guard.may_command(Headers(raw=self.headers))

    def data_received(self, data: bytes) -> None:
        """See `asyncio.Protocol`."""
        if self._handshake is not None:
            self._early += data
            return
        super().data_received(data)
        self._check_request()

    def _check_request(self) -> None:
        """Extend the time limit once a request is complete."""
        if not self._answering and self.cycle is not None and self.conn.their_state is not h11.SEND_BODY:
            self._answering = not self.cycle.response_complete
            if self._answering:
                self._allow(ANSWER_S)

    def _allow(self, seconds: float) -> None:
        self._timer.cancel()
        self._timer = self.loop.call_later(seconds, self.transport.abort)

    def on_response_complete(self) -> None:
        """See `H11Protocol`."""
        self._answering = False
        self._allow(REQUEST_S)
        super().on_response_complete()
        self._check_request()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """See `H11Protocol`; a viewer's stream has its own limits."""
        if sum(not isinstance(one, BrowserConnection) for one in self.connections) >= VIEWERS:
            self.transport.write(b"HTTP/1.1 503 Service Unavailable\r\ncontent-length: 0\r\nconnection: close\r\n\r\n")
            self.transport.close()
            return
        self._timer.cancel()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self._timer.cancel()
        super().connection_lost(exc)


def protocol(guard: Guard, tls: ssl.SSLContext | None = None) -> type[asyncio.Protocol]:
    """The protocol of one server; ``tls``: for HTTPS."""
    attributes: dict[str, Any] = {"guard": guard, "tls": tls}
    return type("GuardedConnection", (BrowserConnection,), attributes)
