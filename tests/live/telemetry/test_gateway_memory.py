"""The gateway's heap and the page's descriptors stay bounded, whatever comes and goes."""

from __future__ import annotations

import pathlib
import threading
from collections.abc import Iterator

import msgspec
import pytest
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as open_socket
from websockets.typing import Origin

from rigctl.client import connect
from tests.builders.miniature import Daemon, running
from tests.builders.pages import serving
from tests.builders.waiting import patience_s, until

CLIENTS = 240
ARENA_BYTES = 64 << 20
"""glibc aligns every arena but the first to this."""


@pytest.fixture
def daemon() -> Iterator[Daemon]:
    for found in running():
        found.client().close()
        yield found


def arenas(pid: int) -> int:
    """Arenas of glibc's heap, with other mappings that happen to be aligned like one."""
    ranges = (line.split() for line in pathlib.Path(f"/proc/{pid}/maps").read_text().splitlines())
    return sum(
        int(words[0].partition("-")[0], 16) % ARENA_BYTES == 0 and words[1] == "rw-p" and len(words) == 5
        for words in ranges
    )


def descriptors(pid: int) -> int:
    return len(list(pathlib.Path(f"/proc/{pid}/fd").iterdir()))


def test_clients_that_come_and_go_leave_no_memory_in_arenas(daemon: Daemon) -> None:
    """Free memory in the arenas of Zenoh's threads is no leak, but looks like one for hours."""
    assert daemon.gateway is not None
    before = descriptors(daemon.gateway.pid)

    def come_and_go() -> None:
        for _ in range(CLIENTS // 4):
            with connect(daemon.endpoint, daemon.settings.rig, timeout_s=patience_s()) as rig:
                rig.fast().read(1.0)
                rig.connection.past_events()

    threads = [threading.Thread(target=come_and_go) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert arenas(daemon.gateway.pid) <= 4  # 16 on two processors without a limit
    until(lambda: descriptors(daemon.gateway.pid) <= before + 1, "the clients' sockets to be closed")  # type: ignore[union-attr]


def wait_for_page(stream: ClientConnection, silent: bool) -> None:
    """Wait until the page has had no state for a second (``silent``), or has one of now."""

    def is_so() -> bool:
        message = stream.recv(patience_s())
        shown = msgspec.json.decode(message) if isinstance(message, str) else {}
        if shown.get("kind") != "state":
            return False
        age_s = shown["silent_s"]
        return age_s is None or age_s > 1.0 if silent else age_s is not None and age_s < 0.5

    until(is_so, "the page to fall silent" if silent else "the page to show data")


def test_the_page_keeps_its_descriptors_over_restarts_of_the_gateway(daemon: Daemon) -> None:
    """At the first end of a link Zenoh starts a runtime, with three descriptors; later ends take none."""
    with (
        serving(f"unixsock-stream/{daemon.runtime.gateway_socket}") as server,
        open_socket(f"ws://127.0.0.1:{server.port}/stream", origin=Origin(server.base)) as stream,
    ):
        found = []
        for _ in range(6):
            wait_for_page(stream, silent=False)
            daemon.kill_gateway()
            wait_for_page(stream, silent=True)
            daemon.start_gateway()
            wait_for_page(stream, silent=False)
            found.append(descriptors(server.process.pid))
        assert max(found[1:]) <= found[0] + 1, found
