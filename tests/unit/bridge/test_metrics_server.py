"""The server of the Prometheus bridge: whom it answers, and how many at a time."""

from __future__ import annotations

import contextlib
import http.client
import socket
from collections.abc import Iterator

import pytest
from prometheus_client import CollectorRegistry, Gauge

from rigctl.bridge.metrics_server import CONNECTIONS, MetricsServer
from rigctl.config.address import Address, CannotListenError
from tests.builders.waiting import patience_s, until


@pytest.fixture
def server() -> Iterator[MetricsServer]:
    registry = CollectorRegistry()
    Gauge("rigctl_tension_newtons", "tension", registry=registry).set(300.0)
    found = MetricsServer(Address("127.0.0.1", 0), registry)
    yield found
    found.close()


def asked(server: MetricsServer, host: str | None) -> tuple[int, bytes]:
    with contextlib.closing(http.client.HTTPConnection(*server.address, timeout=patience_s())) as one:
        one.putrequest("GET", "/metrics", skip_host=True)
        if host is not None:
            one.putheader("Host", host)
        one.endheaders()
        reply = one.getresponse()
        return reply.status, reply.read()


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.1:9477", "localhost:1", "LOCALHOST", "[::1]:80"])
def test_it_answers_to_the_names_of_this_computer(server: MetricsServer, host: str) -> None:
    status, body = asked(server, host)
    assert status == 200
    assert b"rigctl_tension_newtons 300.0" in body


@pytest.mark.parametrize("host", [None, "", "rig.attacker.example", "192.0.2.1", "localhost.attacker.example", "a b"])
def test_a_foreign_name_that_points_here_reads_nothing(server: MetricsServer, host: str | None) -> None:
    """DNS rebinding: the browser sends the name of the attacker's page."""
    status, body = asked(server, host)
    assert status == 421
    assert b"rigctl_" not in body


def test_connections_without_a_request_are_bounded(server: MetricsServer, capfd: pytest.CaptureFixture[str]) -> None:
    with contextlib.ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection(server.address)) for _ in range(CONNECTIONS)]
        beyond = stack.enter_context(socket.create_connection(server.address, patience_s()))
        assert beyond.recv(1) == b""
        idle[0].close()
        until(lambda: _answers(server), "an answer in the place of a connection that has ended")
    assert capfd.readouterr().err == ""


def _answers(server: MetricsServer) -> bool:
    with contextlib.suppress(OSError, http.client.HTTPException):
        return asked(server, "localhost")[0] == 200
    return False


def test_a_port_in_use_is_one_line(server: MetricsServer) -> None:
    with pytest.raises(CannotListenError, match="in use"):
        MetricsServer(server.address, CollectorRegistry())
