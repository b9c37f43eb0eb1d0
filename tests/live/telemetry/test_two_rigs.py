"""Two rigs on one network of routers: each stream, state and command belongs to its own rig."""

from __future__ import annotations

import contextlib
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

import rigctl.client
from rigctl.client import Rig, Samples, connect, route
from tests.builders.miniature import Daemon, free_port
from tests.builders.operators import LEE
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until


@pytest.fixture
def two() -> Iterator[tuple[Daemon, Daemon]]:
    """Each joins the other one's router; they differ in their targets."""
    port = free_port()
    first = Daemon("north_rig", join=[f"tcp/127.0.0.1:{port}"])
    second = Daemon("south_rig", port, join=[first.endpoint])
    try:
        for daemon in (first, second):
            daemon.start_loop()
            daemon.start_gateway()
        until(lambda: _rigs(first) == ["north_rig", "south_rig"], "both to be seen")
        yield first, second
    finally:
        first.close()
        second.close()


@pytest.fixture(params=["by the rig's own socket", "by the routers"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where clients find the rigs: by their folders, or as from another computer."""
    if "routers" in request.param:
        monkeypatch.setattr(route, "local_daemons", list)


def _rigs(daemon: Daemon) -> list[str]:
    try:
        return rigctl.client.rigs(daemon.endpoint)
    except rigctl.client.NoDaemonError:
        return []


def commands(daemon: Daemon) -> int:
    return daemon.runtime.commands.reader().head


def read_on(samples: Samples, more: int) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """Sequence numbers of at least ``more`` further records."""
    numbers: list[int] = []
    end = time.monotonic() + patience_s()
    while len(numbers) < more:
        assert time.monotonic() < end
        block = samples.read(patience_s())
        assert block is not None
        numbers += block["seq"].tolist()
    return np.array(numbers)


@pytest.mark.usefixtures("way")
def test_a_client_of_either_router_chooses_by_name(two: tuple[Daemon, Daemon]) -> None:
    first, second = two
    for endpoint in (first.endpoint, second.endpoint):
        with pytest.raises(rigctl.client.ChoiceError, match=r"several rigs answer at .*: north_rig, south_rig"):
            connect(endpoint)
        for daemon in two:
            with connect(endpoint, daemon.settings.rig) as rig, rig.fast() as samples:
                assert rig.state()["rig"] == rig.name == rig.config()["settings"]["rig"] == daemon.settings.rig
                assert rig.schema()["fast"]["key"] == f"rigctl/{daemon.settings.rig}/tele/fast"
                assert rig.alive or rig.wait_alive(patience_s())
                numbers = read_on(samples, 500)
                assert np.all(np.diff(numbers) == 1)
                held = daemon.runtime.records.reader(from_start=True).read()
                block = samples.read(patience_s())
                assert block is not None
                mine = held["t_ns"][held["seq"] == numbers[-1]]
                assert mine == block["t_ns"][0] - 1_000_000  # of this loop's grid, not the other's


def test_a_command_reaches_only_the_rig_it_names(two: tuple[Daemon, Daemon]) -> None:
    first, second = two
    with connect(first.endpoint, "north_rig") as north, connect(first.endpoint, "south_rig") as south:
        given = commands(first)
        events = north.events()
        assert events.read(0.2) is None
        assert (armed := south.command("arm", operator="kim"))["accepted"], armed  # by the other rig's router
        assert south.command("target", 222.0, operator="kim")["accepted"]  # the stand-in trips
        trip = south.wait_event(kind="TRIP", timeout_s=patience_s())
        assert trip is not None
        there, here = second.state(south.connection), first.state(north.connection)
        assert (there["rig"], there["mode"]) == ("south_rig", "FAULT")
        assert (here["rig"], here["mode"]) == ("north_rig", "DISARMED")
        assert (here["lease"], here["target_n"]) == (None, 300.0)
        assert commands(first) == given
        assert events.read(0.3) is None
        assert north.take_lease("lee")["lease"]["holder"] == LEE  # each rig has a lease of its own


def test_the_joined_router_dies_and_the_other_rig_streams_on(two: tuple[Daemon, Daemon]) -> None:
    first, second = two
    with connect(second.endpoint, "south_rig") as south, south.fast() as samples:
        start = read_on(samples, 200)
        first.kill_gateway()
        numbers = np.concatenate([start, read_on(samples, 1500)])
        assert np.all(np.diff(numbers) == 1)
        assert (samples.count.recovered, samples.count.lost) == (0, 0)  # the lost router had no effect on the stream
        assert _rigs(second) == ["south_rig"]
        first.start_gateway()
        until(lambda: _rigs(second) == ["north_rig", "south_rig"], "the other rig to be back, by itself")
        until(lambda: _rigs(first) == ["north_rig", "south_rig"], "and seen from its side")


@pytest.mark.usefixtures("way")
def test_the_joining_gateway_dies_and_its_clients_behind_the_other_router_lose_nothing(
    two: tuple[Daemon, Daemon],
) -> None:
    first, second = two

    def both(rigs: tuple[Rig, Rig]) -> None:
        north, south = rigs
        with north.fast() as healthy, south.fast() as interrupted:
            read_on(interrupted, 200)
            start = read_on(healthy, 200)
            second.kill_gateway()
            until(lambda: not south.alive, "it to be missed")
            assert north.alive
            second.start_gateway()
            on = read_on(healthy, 1000)
            read_on(interrupted, 1500)
            assert np.all(np.diff(np.concatenate([start, on])) == 1)
            assert (healthy.count.recovered, healthy.count.lost) == (0, 0)
            assert (interrupted.count.lost, interrupted.count.streams) == (0, 1)

    with connect(first.endpoint, "north_rig") as north, connect(first.endpoint, "south_rig") as south:
        both((north, south))


@contextlib.contextmanager
def answering_late(endpoint: str, seconds: float) -> Iterator[str]:
    """Another address of an endpoint, which connects its clients after a delay."""
    host, port = endpoint.removeprefix("tcp/").split(":")

    def through(visitor: socket.socket) -> None:
        time.sleep(seconds)
        with visitor, socket.create_connection((host, int(port))) as behind:
            while ready := select.select([visitor, behind], [], [], patience_s())[0]:
                for one in ready:
                    if not (data := one.recv(65536)):
                        return
                    (behind if one is visitor else visitor).sendall(data)

    def serve() -> None:
        with contextlib.suppress(OSError):  # closed
            while True:
                threading.Thread(target=through, args=(door.accept()[0],), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as door:
        threading.Thread(target=serve, daemon=True).start()
        try:
            yield f"tcp/127.0.0.1:{door.getsockname()[1]}"
        finally:
            door.shutdown(socket.SHUT_RDWR)


@pytest.mark.parametrize("late_s", [0.0, 0.8])
def test_a_duplicate_rig_name_behind_the_joined_router_is_refused(two: tuple[Daemon, Daemon], late_s: float) -> None:
    """A command would reach both daemons. On a busy computer the router connects late."""
    first, _ = two
    with answering_late(first.endpoint, late_s) as way:
        twin = Daemon("north_rig", join=[way])
        try:
            command = [sys.executable, "-m", "rigctl.gateway.gateway_process", str(twin.runtime.directory)]
            done = subprocess.run(
                command, cwd=ROOT, capture_output=True, text=True, timeout=patience_s() * 2, check=False
            )
        finally:
            twin.close()
    assert done.returncode == 1
    assert done.stderr == (f"gateway: another daemon named north_rig answers behind {way}: rename one\n")


def test_a_router_to_join_that_is_not_there_yet_is_joined_later() -> None:
    port = free_port()
    second = Daemon("south_rig", join=[f"tcp/127.0.0.1:{port}"])
    first = Daemon("north_rig", port, join=[second.endpoint])
    try:
        second.start_loop()
        second.start_gateway()
        with second.rig() as rig:
            assert rig.state()["loop_alive"]
        first.start_loop()
        first.start_gateway()
        until(lambda: _rigs(first) == ["north_rig", "south_rig"], "the second to join")
    finally:
        first.close()
        second.close()
