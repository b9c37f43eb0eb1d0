"""A stream with iteration that does not block the event loop: ``async for item in stream``."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any, Generic, Self

import numpy.typing as npt

from rigctl.client.samples import Samples
from rigctl.client.stream import AGAIN_S, Item, Stream


class AsyncStream(Generic[Item]):
    """A `rigctl.client.stream.Stream` for one task. A cancelled step (``asyncio.timeout``) loses nothing.

    Zenoh's thread wakes the event loop at an arrival; items are taken, and missed ones queried, in another thread.
    """

    def __init__(self, stream: Stream[Item]) -> None:
        """Must be created in the event loop that will iterate."""
        self._stream = stream
        self._loop = asyncio.get_running_loop()
        self._arrived = asyncio.Event()
        self._taking: asyncio.Future[Item | None] | None = None  # continues when the step that began it is cancelled
        stream.on_arrival(self._wake)

    def _wake(self) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop has ended
            self._loop.call_soon_threadsafe(self._arrived.set)

    async def take(self) -> Item | None:
        """The next item that has arrived, or that a cancelled step took, or None."""
        if self._taking is None:
            self._arrived.clear()
            self._taking = self._loop.run_in_executor(None, self._stream.take)
        found = await asyncio.shield(self._taking)
        self._taking = None
        return found

    async def forget(self) -> None:
        """Let a cancelled step end, and drop the item it took."""
        if (taking := self._taking) is not None:
            await asyncio.wait([taking])
            if self._taking is taking:
                self._taking = None

    async def read(self) -> Item | None:
        """The next item; None once closed."""
        while not self._stream.closed:
            if (found := await self.take()) is not None:
                return found
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(AGAIN_S if self._stream.unanswered else None):
                    await self._arrived.wait()
        return None

    def close(self) -> None:
        """End the subscription and an iteration that waits."""
        self._stream.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Item:
        found = await self.read()
        if found is None:
            raise StopAsyncIteration
        return found

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_error: object) -> None:
        self.close()


class AsyncSamples(AsyncStream[npt.NDArray[Any]]):
    """The fast stream, as `rigctl.client.samples.Samples`."""

    def __init__(self, samples: Samples) -> None:
        super().__init__(samples)
        self.count = samples.count
