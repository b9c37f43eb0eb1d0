"""Stream to one browser: charts in binary frames, texts in JSON. A slow browser gets fewer frames, never old ones."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

import msgspec
from starlette.websockets import WebSocket, WebSocketDisconnect

from rigctl.config import input_file
from rigctl.model.signals import Signal
from rigctl.page.chart_frame import frame
from rigctl.page.chart_signals import SIGNALS, STRIPS
from rigctl.page.history import WINDOWS_S
from rigctl.page.lateness import EDGES_US
from rigctl.page.page_commands import PageCommands
from rigctl.page.panel import events_message, settings_message, state_message
from rigctl.page.picture import Picture

FRAME_S = 0.04
WORDS_EVERY = 3  # frames
LATENESS_EVERY = 12
_SLOW_S = 10.0  # a browser that accepts no data for this long counts as gone


class BrowserStream:
    """One websocket. The browser sends ``{"window": N}`` and gets that window from its start."""

    def __init__(
        self,
        socket: WebSocket,
        picture: Picture,
        hello: dict[str, Any],
        commands: PageCommands | None,
        may_read: Callable[[], bool],
    ) -> None:
        """``may_read``: whether the browser's session still allows the stream."""
        self._socket, self._picture, self._hello, self._commands = socket, picture, hello, commands
        self._may_read = may_read
        self._window = self._since = 0
        self._newest_ns = -1
        self._events = self._active = -1

    async def run(self) -> None:
        """Send until the browser disconnects."""
        listening = asyncio.create_task(self._listen())
        try:
            await self._put(
                {
                    **self._hello,
                    "signals": [signal.name for signal in SIGNALS],
                    "strips": [_strip(row) for row in STRIPS],
                    "edges_us": EDGES_US.round(3).tolist(),
                }
            )
            count = 0
            while not listening.done():
                if count % WORDS_EVERY == 0 and not self._may_read():
                    await self._socket.close(4401)
                    break
                await self._round(count)
                count += 1
                await asyncio.sleep(FRAME_S)
        except (WebSocketDisconnect, RuntimeError, OSError, TimeoutError):
            pass  # the browser disconnected during a send
        finally:
            listening.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await listening

    async def _listen(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            with contextlib.suppress(msgspec.MsgspecError, KeyError, TypeError):
                wanted = input_file.decoded((message.get("text") or "").encode())["window"]
                if wanted in range(len(WINDOWS_S)):
                    self._window, self._since, self._newest_ns = int(wanted), 0, -1

    async def _round(self, count: int) -> None:
        picture = self._picture
        if picture.active_serial != self._active:
            self._active = picture.active_serial
            await self._put(settings_message(picture.active))
        if picture.events_serial != self._events:
            self._events = picture.events_serial
            await self._put(events_message(picture))
        if count % WORDS_EVERY == 0:
            commands = self._commands
            mine = commands is not None and commands.holds_lease(picture.state)
            await self._put(state_message(picture, mine, commands.asked if commands is not None else ""))
        if count % LATENESS_EVERY == 0:
            with picture.lock:
                found = picture.lateness.window(WINDOWS_S[self._window])
            await self._put({"kind": "lateness", **found})
        if picture.history.newest_ns != self._newest_ns:
            self._newest_ns = picture.history.newest_ns
            with picture.lock:
                payload, self._since = frame(picture.history, self._window, self._since)
            async with asyncio.timeout(_SLOW_S):
                await self._socket.send_bytes(payload)

    async def _put(self, message: dict[str, Any]) -> None:
        async with asyncio.timeout(_SLOW_S):
            await self._socket.send_text(msgspec.json.encode(message).decode())


def _strip(row: Signal) -> dict[str, Any]:
    return {"signal": row.name, "title": row.shown.label, "unit": row.unit, "digits": row.shown.digits,
            "least": row.shown.span, "device": row.device}  # fmt: skip
