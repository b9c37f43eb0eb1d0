"""Idle, slow and watching connections: each ends in time, and the operator's HOLD is served."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from rigctl.page.browser_connection import CONNECTIONS, HEADER_BYTES, REQUEST_S, VIEWERS
from tests.builders.pages import Server
from tests.builders.waiting import patience_s

SILENT = {
    "nothing": b"",
    "half a request": b"POST /api/command HTTP/1.1\r\nHost: 127.0.0.1\r\n",
    "headers without their body": b"POST /api/command HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\n{",
}


@contextlib.contextmanager
def opened(server: Server, count: int, said: bytes) -> Iterator[list[socket.socket]]:
    with contextlib.ExitStack() as stack:
        found = []
        for _ in range(count):
            found.append(stack.enter_context(socket.create_connection(("127.0.0.1", server.port), patience_s())))
            with contextlib.suppress(OSError):
                found[-1].sendall(said)
        yield found


def is_ended(connection: socket.socket) -> bool:
    """Whether the server closes the connection; its earlier output is read."""
    try:
        while connection.recv(65536):
            pass
    except TimeoutError:
        return False
    except OSError:
        pass
    return True


@pytest.mark.parametrize("kind", SILENT)
def test_an_unfinished_request_ends_its_connection(commanding: Server, kind: str) -> None:
    with opened(commanding, 1, SILENT[kind]) as (one,):
        assert is_ended(one)


def test_a_request_a_byte_at_a_time_ends_its_connection(commanding: Server) -> None:
    with opened(commanding, 1, b"GET / HTTP/1.1\r\nX: ") as (one,):
        begun, until = time.monotonic(), time.monotonic() + patience_s()
        with contextlib.suppress(OSError):
            while time.monotonic() < until:
                one.sendall(b"x")
                time.sleep(0.1)
        assert REQUEST_S - 1.0 < time.monotonic() - begun < patience_s()


def test_headers_without_an_end_are_refused(commanding: Server) -> None:
    with opened(commanding, 1, b"GET / HTTP/1.1\r\nX: " + b"x" * 2 * HEADER_BYTES) as (one,):
        assert is_ended(one)


def viewers(server: Server, stack: contextlib.ExitStack) -> int:
    """As many streams as there is room for."""
    count = 0
    with contextlib.suppress(InvalidStatus):
        for _ in range(VIEWERS + 5):
            streams: ClientConnection = connect(
                f"ws://127.0.0.1:{server.port}/stream", origin=Origin(server.base), close_timeout=0.1
            )  # else each end waits until what has not been read is
            stack.enter_context(streams)
            count += 1
    return count


@pytest.mark.parametrize("kind", SILENT)
def test_hold_is_served_however_many_are_connected(commanding: Server, kind: str) -> None:
    with contextlib.ExitStack() as stack:
        assert viewers(commanding, stack) == VIEWERS
        stack.enter_context(opened(commanding, 2 * CONNECTIONS, SILENT[kind]))
        for _ in range(2):
            status, answer = commanding.command("command", {"verb": "hold"})
            assert status in (200, 409), answer
            assert answer["verb"] == "hold", answer
            stack.enter_context(opened(commanding, 100, SILENT[kind]))
    assert commanding.command("session", {})[1]["operator"] == "kim"
