"""Local socket on which a page server makes another one-time link for its own user, for ``rigctl page --link``."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pathlib
import socket
import struct

from rigctl.page.guard import Guard

_CREDENTIALS = struct.Struct("3i")  # struct ucred: pid, uid, gid
_ANSWER_S = 5.0
_LONGEST = 4096


def path_in(folder: pathlib.Path, port: int) -> pathlib.Path:
    """The socket of the page server at ``port``."""
    return folder / f"page-{port}.sock"


def _uid_of(connection: socket.socket) -> int:
    return int(_CREDENTIALS.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))[1])


async def serve_links(path: pathlib.Path, guard: Guard) -> asyncio.Server:
    """Answer every connection of this user or root with a link.

    Raises:
        OSError: the socket cannot be made.
    """

    async def answer(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError), contextlib.closing(writer):
            if _uid_of(writer.get_extra_info("socket")) in (0, os.geteuid()):
                writer.write(guard.link().encode())
                await writer.drain()

    path.unlink(missing_ok=True)  # left by a killed server
    server = await asyncio.start_unix_server(answer, path)
    path.chmod(0o600)
    return server


def new_link(path: pathlib.Path) -> str | None:
    """A new link of the server at this socket; None if none of this user answers there."""
    with contextlib.suppress(OSError, UnicodeDecodeError), socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(_ANSWER_S)
        connection.connect(str(path))
        if _uid_of(connection) == os.geteuid():
            found = b""
            while len(found) < _LONGEST and (part := connection.recv(_LONGEST)):
                found += part
            return found.decode() or None
    return None
