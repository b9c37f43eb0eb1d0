"""The rig for programs on an event loop. Nothing here blocks the loop: arrivals wake streams, calls run in a thread."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping

from rigctl.client.block_order import DEPTH_BLOCKS
from rigctl.client.decoding import SampleField
from rigctl.client.rig import Rig, connect, fits
from rigctl.client.shapes import Message
from rigctl.client.stream_async import AsyncSamples, AsyncStream


class AsyncRig:
    """As `rigctl.client.rig.Rig`: same methods, same errors."""

    def __init__(self, rig: Rig) -> None:
        """Take over a rig; must be created in the event loop."""
        self._rig = rig
        self._new_events = AsyncStream(rig.new_events)

    @property
    def name(self) -> str:
        """Name of the rig."""
        return self._rig.name

    @property
    def fields(self) -> Mapping[str, SampleField]:
        """Fields of a sample by name."""
        return self._rig.fields

    @property
    def refused(self) -> int:
        """Messages refused so far because they did not have the shape of a daemon's."""
        return self._rig.refused

    @property
    def alive(self) -> bool:
        """Whether the daemon's gateway is alive."""
        return self._rig.alive

    async def wait_alive(self, timeout_s: float | None = None) -> bool:
        """Wait for the daemon; returns whether it is alive within ``timeout_s``."""
        until = None if timeout_s is None else asyncio.get_running_loop().time() + timeout_s
        while not self._rig.alive:
            if until is not None and asyncio.get_running_loop().time() >= until:
                return False
            await asyncio.sleep(0.02)
        return True

    async def state(self) -> Message:
        """The newest state."""
        return await asyncio.to_thread(self._rig.state)

    async def config(self) -> Message:
        """The active configuration."""
        return await asyncio.to_thread(self._rig.config)

    async def schema(self) -> Message:
        """The schema of all messages."""
        return await asyncio.to_thread(self._rig.schema)

    def fast(self, depth: int = DEPTH_BLOCKS) -> AsyncSamples:
        """Every tick from now on."""
        return AsyncSamples(self._rig.fast(depth))

    def states(self) -> AsyncStream[Message]:
        """States from now on; a slow reader misses the oldest."""
        return AsyncStream(self._rig.states())

    def configs(self) -> AsyncStream[Message]:
        """Active configurations from now on, one at every change."""
        return AsyncStream(self._rig.configs())

    def events(self, *, past: bool = False) -> AsyncStream[Message]:
        """Events from now on, or from the oldest held (``past``); each once, also across a restart."""
        return AsyncStream(self._rig.events(past=past))

    async def wait_event(
        self,
        kind: str | None = None,
        severity: str | None = None,
        where: Callable[[Message], bool] | None = None,
        timeout_s: float | None = None,
    ) -> Message | None:
        """The first such event since the last command given here, or since connecting; None after ``timeout_s``."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                async for event in self._new_events:
                    if fits(event, kind, severity, where):
                        return event
        return None

    async def command(
        self, verb: str, value: float | None = None, *, operator: str, lease: str | None = None, **options: bool | str
    ) -> Message:
        """Give a command; a cancelled one may still be carried out."""
        await self._new_events.forget()
        return await asyncio.to_thread(self._rig.command, verb, value, operator=operator, lease=lease, **options)

    async def take_lease(self, operator: str, reason: str = "") -> Message:
        """Take or renew the lease."""
        return await asyncio.to_thread(self._rig.take_lease, operator, reason)

    async def return_lease(self, operator: str) -> Message:
        """Give the lease back."""
        return await asyncio.to_thread(self._rig.return_lease, operator)


@contextlib.asynccontextmanager
async def connect_async(
    endpoint: str | None = None, rig: str | None = None, *, timeout_s: float = 0.0
) -> AsyncIterator[AsyncRig]:
    """``async with connect_async() as rig``: as `rigctl.client.rig.connect`; closes the rig at the end."""
    opening = asyncio.ensure_future(asyncio.to_thread(connect, endpoint, rig, timeout_s=timeout_s))
    try:
        found = await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(_close)
        raise
    try:
        yield AsyncRig(found)
    finally:
        await asyncio.to_thread(found.close)


def _close(opened: asyncio.Future[Rig]) -> None:
    """Close a rig whose connecting task was cancelled."""
    if not opened.cancelled() and opened.exception() is None:
        opened.result().close()
