"""Connections of the page's server: how long one may take to ask, how many there are, and room for a command.

Whoever reaches the port may open connections and say nothing. The newest is always let in, and the oldest that is
neither a viewer nor a command under way goes for it: who asks at once, as an operator's HOLD does, is served.
"""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from starlette.datastructures import Headers
from uvicorn.protocols.http.h11_impl import H11Protocol

from rigctl.page.guard import Guard

CONNECTIONS = 256
VIEWERS = 32
"""Streams among them. What is left is more than can be accepted in one turn of the event loop (BACKLOG)."""
BACKLOG = 128
REQUEST_S = 5.0  # for headers and body, from the opening or the answer before on
ANSWER_S = 30.0  # for the answer to be made and taken
HEADER_BYTES = 16_384


class Connection(H11Protocol):
    """One connection until it is closed, or becomes a viewer's stream."""

    guard: Guard

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        self._opened_s, self._asked = self.loop.time(), False
        self._timer = self.loop.call_later(REQUEST_S, transport.abort)
        if len(self.connections) > CONNECTIONS:
            self._make_room()

    def _make_room(self) -> None:
        others = [one for one in self.connections if isinstance(one, Connection) and not one.commands]
        oldest = min(others, key=lambda one: one._opened_s)
        self.connections.discard(oldest)  # it is told a turn later, the next one in needs room in this
        oldest.transport.abort()

    @property
    def commands(self) -> bool:
        """Whether a command that shows the token is under way here."""
        if not self._asked or not self.scope["path"].startswith("/api/"):
            return False
        return self.guard.may_command(Headers(raw=self.headers))

    def data_received(self, data: bytes) -> None:
        """See `asyncio.Protocol`."""
        super().data_received(data)
        self._look()

    def _look(self) -> None:
        """Once a request is there in full, its answer may take longer."""
        if not self._asked and self.cycle is not None and self.conn.their_state is not h11.SEND_BODY:
            self._asked = not self.cycle.response_complete
            if self._asked:
                self._allow(ANSWER_S)

    def _allow(self, seconds: float) -> None:
        self._timer.cancel()
        self._timer = self.loop.call_later(seconds, self.transport.abort)

    def on_response_complete(self) -> None:
        """See `H11Protocol`."""
        self._asked = False
        self._allow(REQUEST_S)
        super().on_response_complete()
        self._look()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """See `H11Protocol`; the viewer's stream has limits of its own."""
        if sum(not isinstance(one, Connection) for one in self.connections) >= VIEWERS:
            self.transport.write(b"HTTP/1.1 503 Service Unavailable\r\ncontent-length: 0\r\nconnection: close\r\n\r\n")
            self.transport.close()
            return
        self._timer.cancel()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self._timer.cancel()
        super().connection_lost(exc)


def protocol(guard: Guard) -> type[asyncio.Protocol]:
    """The protocol of one server."""
    attributes: dict[str, Any] = {"guard": guard}
    return type("GuardedConnection", (Connection,), attributes)
