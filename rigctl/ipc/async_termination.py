"""An event loop that ends by a signal, also by one that comes while the loop is being made."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Coroutine
from typing import Any

from rigctl.ipc.termination import ENDING, heeded


def run_until_signal(main: Coroutine[Any, Any, None], end: Callable[[asyncio.Task[None]], object]) -> None:
    """Run ``main`` in an event loop of its own; a signal of ``ENDING`` has ``end`` called with its task.

    Until the loop can take it a signal waits: Ctrl-C would else leave the loop half made, and ``main`` unawaited.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    asyncio.run(_ended(main, end))


async def _ended(main: Coroutine[Any, Any, None], end: Callable[[asyncio.Task[None]], object]) -> None:
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None
    for number in heeded(*ENDING):
        loop.add_signal_handler(number, end, task)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    await main
