"""Looking at the connections of a real router leaves every descriptor as it was."""

from __future__ import annotations

import contextlib
import os
import pathlib
import resource
from collections.abc import Iterator

import pytest

from rigctl.gateway import tcp_table
from rigctl.gateway.accepted_sockets import AcceptedSockets, user
from rigctl.wire.session import SessionError, close, open_client, open_router
from tests.builders.miniature import free_port
from tests.builders.waiting import until


@contextlib.contextmanager
def no_descriptor_left() -> Iterator[None]:
    """As in a process whose limit a flood has reached: the limit lies above every descriptor that is open already."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken: list[int] = []
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(descriptors()) + 64, hard))
        with pytest.raises(OSError, match="Too many open files"):
            while True:
                taken.append(os.dup(0))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for one in taken:
            os.close(one)


def descriptors() -> set[int]:
    return {int(one.name) for one in pathlib.Path("/proc/self/fd").iterdir()}


def test_looking_at_the_connections_opens_no_descriptor_and_closing_one_ends_its_session(
    tmp_path: pathlib.Path,
) -> None:
    endpoint, socket = f"tcp/127.0.0.1:{free_port()}", f"unixsock-stream/{tmp_path}/gateway"
    router = open_router([endpoint, socket], ())
    pipe = os.pipe()  # descriptors that are no sockets
    try:
        sockets = AcceptedSockets([endpoint, socket])
        before = len(descriptors())
        for number in range(100):
            assert sockets.read(router.info, float(number)) == []
        assert len(descriptors()) == before
        client = open_client(endpoint)
        until(lambda: [one.identity for one in sockets.read(router.info, 100.0)] == [user(os.geteuid())], "its session")
        before, (only,) = len(descriptors()), sockets.read(router.info, 101.0)
        for number in range(100):
            assert sockets.read(router.info, 201.0 + number) == [only]
        assert len(descriptors()) == before
        sockets.close(only)
        until(lambda: only not in sockets.read(router.info, 400.0), "the connection's end")
        close(client)
    finally:
        close(router)
        for end in pipe:
            os.close(end)


@pytest.mark.parametrize("host", ["127.0.0.1", "[::1]"])
def test_a_user_of_this_computer_is_known_on_an_endpoint_of_every_address(host: str) -> None:
    """A session by IPv4 arrives there as one of IPv6."""
    port = free_port()
    try:
        router = open_router([f"tcp/[::]:{port}"], ())
    except SessionError:
        pytest.skip("this computer has no IPv6")
    sockets = AcceptedSockets([f"tcp/[::]:{port}"])
    client = open_client(f"tcp/{host}:{port}")
    try:
        until(lambda: [one.identity for one in sockets.read(router.info, 0.0)] == [user(os.geteuid())], "its user")
    finally:
        close(client)
        close(router)


def test_a_socket_that_was_closed_is_not_roots_nor_anothers(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its port may be bound again at once: the row of user 0 and inode 0 would lend the next socket root's places."""
    rows = (
        " 0: 0100007F:9C40 0100007F:1D17 01 00000000:00000000 00:00000000 00000000  1000        0 77 1 x 20 4 30 10 -1",
        " 1: 0100007F:9C40 0900007F:1D17 06 00000000:00000000 03:00000000 00000000     0        0 0 3 x",
        " 2: 0100007F:9C41 0100007F:1D17 05 00000000:00000000 03:00000000 00000000     0        0 0 3 x",
        " 3: 0100007F:9C40 0100007F:1D18 01 00000000:00000000 00:00000000 00000000     0        0 78 1 x 20 4 30 10 -1",
    )
    table = tmp_path / "tcp"
    table.write_text("\n".join(["  sl  local_address rem_address ...", *rows]) + "\n")
    monkeypatch.setattr(tcp_table, "_TABLES", ((table, 4),))
    here = ("127.0.0.1", 7447)
    assert tcp_table.owners({7447}) == {(("127.0.0.1", 40000), here): 1000}


def test_a_flood_that_uses_every_descriptor_is_seen_and_closed() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = open_router([endpoint], ())
    client = open_client(endpoint)
    try:
        sockets = AcceptedSockets([endpoint])
        with no_descriptor_left():
            (only,) = sockets.read(router.info, 0.0)
            sockets.close(only)
        assert only.source == "127.0.0.1", "without a descriptor the table of users cannot be read"
        until(lambda: only not in sockets.read(router.info, 1.0), "the connection's end")
    finally:
        close(client)
        close(router)
