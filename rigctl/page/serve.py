"""Runs the page's server in this process."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import pathlib
import socket
import ssl
import sys
import threading
from collections.abc import Callable, Iterator
from typing import NoReturn

import uvicorn

from rigctl.ipc import heap
from rigctl.ipc.async_termination import run_until_signal
from rigctl.page.browser_connection import BACKLOG, HEADER_BYTES, protocol
from rigctl.page.guard import Guard
from rigctl.page.link_socket import serve_links
from rigctl.page.page_commands import PageCommands
from rigctl.page.picture import Picture
from rigctl.page.rig_reader import RigReader
from rigctl.page.server import Page

CLOSE_S = 1  # for browsers to close their connections
TURN_S = 0.2


class _Server(uvicorn.Server):
    """uvicorn's server without its signal handling, which this process does itself."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Do nothing."""
        yield


def _is_ours(record: logging.LogRecord) -> bool:
    """Whether a log line is about this server, not about text of a client that is not UTF-8, whose stream it ends."""
    return record.exc_info is None or not isinstance(record.exc_info[1], UnicodeDecodeError)


async def _take_turns(turn: Callable[[], None]) -> None:
    while True:
        turn()
        await asyncio.sleep(TURN_S)


def serve(
    listening: socket.socket,
    endpoint: str,
    rig: str | None,
    guard: Guard,
    *,
    tls: ssl.SSLContext | None = None,
    links: pathlib.Path | None = None,
    turn: Callable[[], None] = lambda: None,
) -> NoReturn:
    """Serve until a signal of ``ENDING``, then end the process.

    Args:
        listening: the socket of ``guard.address``.
        endpoint: the daemon's endpoint.
        rig: its rig, None for the only one there.
        guard: who may read and command.
        tls: for HTTPS.
        links: place of the socket that makes further one-time links; without one there are no others.
        turn: called five times a second while the server makes progress.
    """
    heap.limit()
    picture, stop = Picture(endpoint), threading.Event()
    reader = RigReader(picture, rig, stop)
    commands = PageCommands(guard.operator, rig, picture) if guard.operator is not None else None
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
        http=protocol(guard, tls),
        h11_max_incomplete_event_size=HEADER_BYTES,
        backlog=BACKLOG,
    )
    server = _Server(config)

    async def until_signal() -> None:
        more = None
        if links is not None and guard.needs_links:
            try:
                more = await serve_links(links, guard)
            except OSError as error:
                sys.stderr.write(f"page: no further links: {links}: {error.strerror}\n")
        turns = asyncio.create_task(_take_turns(turn))
        await server.serve(sockets=[listening])
        turns.cancel()
        if more is not None and links is not None:
            more.close()
            links.unlink(missing_ok=True)

    logging.getLogger("uvicorn.error").addFilter(_is_ours)
    reader.start()
    try:
        run_until_signal(until_signal(), lambda _task: setattr(server, "should_exit", True))
    finally:
        stop.set()
        reader.join(CLOSE_S)
        page.close()
    # Not sys.exit: the interpreter would abort on a thread that is still opening a Zenoh session.
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(0)
