"""Runs the page's server in this process."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import sys
import threading
from collections.abc import Iterator
from typing import NoReturn

import uvicorn

from rigctl.ipc.termination import ENDING, heeded
from rigctl.page.browser_connection import BACKLOG, HEADER_BYTES, protocol
from rigctl.page.guard import Guard
from rigctl.page.page_commands import PageCommands
from rigctl.page.picture import Picture
from rigctl.page.rig_reader import RigReader
from rigctl.page.server import Page

CLOSE_S = 1  # for browsers to close their connections


class _Server(uvicorn.Server):
    """uvicorn's server without its signal handling, which this process does itself."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Do nothing."""
        yield


def serve(
    listening: socket.socket, endpoint: str, rig: str | None, guard: Guard, operator: str | None = None
) -> NoReturn:
    """Serve until a signal of ``ENDING``, then end the process. ``operator``: name for commands, None: read-only."""
    picture, stop = Picture(endpoint), threading.Event()
    reader = RigReader(picture, rig, stop)
    commands = PageCommands(operator, rig, picture) if operator is not None else None
    page = Page(picture, guard, commands)
    config = uvicorn.Config(
        page.app,
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        ws_per_message_deflate=False,  # compression costs more than it saves on a local network
        ws_max_size=4096,
        timeout_graceful_shutdown=CLOSE_S,
        http=protocol(guard),
        h11_max_incomplete_event_size=HEADER_BYTES,
        backlog=BACKLOG,
    )
    server = _Server(config)

    async def until_signal() -> None:
        loop = asyncio.get_running_loop()
        for number in heeded(*ENDING):
            loop.add_signal_handler(number, setattr, server, "should_exit", True)
        await server.serve(sockets=[listening])

    reader.start()
    try:
        asyncio.run(until_signal())
    finally:
        stop.set()
        reader.join(CLOSE_S)
        page.close()
    # Not sys.exit: the interpreter would abort on a thread that is still opening a Zenoh session.
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(0)
