"""A stream with iteration that does not block the event loop: ``async for item in stream``."""

from __future__ import annotations

import asyncio
import contextlib
from types import TracebackType
from typing import Generic, Self, TypeVar

from rigctl.client.connection import Client
from rigctl.client.enquiry import AGAIN_S, Enquiry
from rigctl.client.source import Question, Source

Item = TypeVar("Item")


class AsyncStream(Generic[Item]):
    """Items in order, for one task. A cancelled step (``asyncio.timeout``) loses nothing: the next step continues.

    Zenoh's thread wakes the event loop at an arrival; queries run in a thread of their own.
    """

    def __init__(self, client: Client, source: Source[Item]) -> None:
        """Must be created in the event loop that will iterate."""
        self._enquiry, self._source = Enquiry(client), source
        self._loop = asyncio.get_running_loop()
        self._come = asyncio.Event()
        self._asking: asyncio.Future[bool] | None = None  # continues when the step that began it is cancelled
        source.mailbox.on_arrival(self._wake)

    def _wake(self) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop has ended
            self._loop.call_soon_threadsafe(self._come.set)

    async def read(self) -> Item | None:
        """The next item; None once closed."""
        mailbox = self._source.mailbox
        await asyncio.sleep(0)  # lets other tasks run even while many items wait
        while not mailbox.closed:
            if self._asking is not None:
                settled = await asyncio.shield(self._asking)
                self._asking = None
                if not settled:
                    await asyncio.sleep(AGAIN_S)
                continue
            self._come.clear()
            found = self._source.poll()
            if isinstance(found, Question):
                self._asking = self._loop.run_in_executor(None, self._enquiry.settle, self._source, found)
            elif found is not None:
                return found
            elif not mailbox.closed:
                await self._come.wait()
        return None

    def close(self) -> None:
        """End the subscription and an iteration that waits."""
        self._source.mailbox.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Item:
        found = await self.read()
        if found is None:
            raise StopAsyncIteration
        return found

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()
