"""The rig for programs on an event loop. Nothing here blocks the loop: arrivals wake streams, calls run in a thread."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import pathlib
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from typing import Any, Concatenate, ParamSpec, TypeVar

from rigctl.client.block_order import DEPTH_BLOCKS
from rigctl.client.decoding import SampleField
from rigctl.client.rig import Rig, connect, fits
from rigctl.client.shapes import Message
from rigctl.client.stream_async import AsyncSamples, AsyncStream

_Given = ParamSpec("_Given")
_Answer = TypeVar("_Answer")


def _in_thread(
    method: Callable[Concatenate[Rig, _Given], _Answer],
) -> Callable[Concatenate[AsyncRig, _Given], Coroutine[Any, Any, _Answer]]:
    """A method of `Rig` that waits for the daemon, in a thread of its own."""

    @functools.wraps(method)
    async def call(self: AsyncRig, /, *args: _Given.args, **kwargs: _Given.kwargs) -> _Answer:
        return await asyncio.to_thread(method, self.rig, *args, **kwargs)

    return call


class AsyncRig:
    """As `rigctl.client.rig.Rig`: same methods, same errors."""

    def __init__(self, rig: Rig) -> None:
        """Take over a rig; must be created in the event loop."""
        self.rig = rig
        self._new_events = AsyncStream(rig.new_events)

    @property
    def name(self) -> str:
        """Name of the rig."""
        return self.rig.name

    @property
    def fields(self) -> Mapping[str, SampleField]:
        """Fields of a sample by name."""
        return self.rig.fields

    @property
    def refused(self) -> int:
        """Messages refused so far because they did not have the shape of a daemon's."""
        return self.rig.refused

    @property
    def alive(self) -> bool:
        """Whether the daemon's gateway is alive."""
        return self.rig.alive

    async def wait_alive(self, timeout_s: float | None = None) -> bool:
        """Wait for the daemon; returns whether it is alive within ``timeout_s``."""
        until = None if timeout_s is None else asyncio.get_running_loop().time() + timeout_s
        while not self.rig.alive:
            if until is not None and asyncio.get_running_loop().time() >= until:
                return False
            await asyncio.sleep(0.02)
        return True

    state = _in_thread(Rig.state)
    config = _in_thread(Rig.config)
    schema = _in_thread(Rig.schema)
    take_lease = _in_thread(Rig.take_lease)
    return_lease = _in_thread(Rig.return_lease)

    def fast(self, depth: int = DEPTH_BLOCKS) -> AsyncSamples:
        """Every tick from now on."""
        return AsyncSamples(self.rig.fast(depth))

    def states(self) -> AsyncStream[Message]:
        """States from now on; a slow reader misses the oldest."""
        return AsyncStream(self.rig.states())

    def configs(self) -> AsyncStream[Message]:
        """Active configurations from now on, one at every change."""
        return AsyncStream(self.rig.configs())

    def events(self, *, past: bool = False) -> AsyncStream[Message]:
        """Events from now on, or from the oldest held (``past``); each once, also across a restart."""
        return AsyncStream(self.rig.events(past=past))

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
        return await asyncio.to_thread(self.rig.command, verb, value, operator=operator, lease=lease, **options)


@contextlib.asynccontextmanager
async def connect_async(
    endpoint: str | None = None,
    rig: str | None = None,
    *,
    timeout_s: float = 0.0,
    credentials: pathlib.Path | str | None = None,
) -> AsyncIterator[AsyncRig]:
    """``async with connect_async() as rig``: as `rigctl.client.rig.connect`; closes the rig at the end."""
    opening = asyncio.ensure_future(
        asyncio.to_thread(connect, endpoint, rig, timeout_s=timeout_s, credentials=credentials)
    )
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
