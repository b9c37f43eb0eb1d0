"""With certificates: each thing that the access list or TLS refuses is one line for the audit log, however often."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import json
import pathlib
import socket
import ssl
from collections.abc import Iterator

import pytest
import zenoh

from rigctl.client.connection import NoDaemonError
from rigctl.identity import credentials
from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.roles import Role
from rigctl.wire.keys import Keys
from rigctl.wire.session import SessionError, close, open_client
from tests.builders.certified import CertifiedDaemon, certified
from tests.builders.refusals import Refused
from tests.builders.waiting import patience_s, until

KEYS = Keys("paper_rig")


@pytest.fixture
def own() -> Iterator[CertifiedDaemon]:
    yield from certified()


def forge(query: zenoh.Query) -> None:
    query.reply(query.key_expr, b"forged")


def test_each_message_that_a_viewer_may_not_send_is_one_line_with_who_what_and_from_where(own: CertifiedDaemon) -> None:
    own.client_of("vera").close()
    refused = Refused(own)
    session, answering = (open_client(own.endpoint, credentials.read(own.key("vera"))) for _ in range(2))
    hers = Keys("paper_rig", "vera")
    certificate = next(one for one in own.keys.folder.certificates() if one.name == "vera").common_name
    single = [
        f"delete of {KEYS.state}", f"liveliness token of {KEYS.daemon}", "declare subscriber of **",
        f"declare queryable of {KEYS.command('**')}",
    ]  # fmt: skip
    session.delete(KEYS.state)
    session.liveliness().declare_token(KEYS.daemon)
    session.declare_subscriber("**", lambda _sample: None)
    answering.declare_queryable(KEYS.command("**"), forge, complete=True)  # a session answers its own queries itself
    for words in single:  # before the flood, which displaces what is not read in time
        refused.line(words)
    flood = [f"query of {hers.command('hold')}", f"put of {KEYS.state}"]
    for _ in range(50):
        assert list(session.get(hers.command("hold"), timeout=patience_s())) == []
        session.put(KEYS.state, b"forged")
    for words in flood + single:
        line = refused.line(words)
        assert line.startswith(words)
        assert f" by vera (certificate {certificate}, tls/127.0.0.1:" in line
        assert line.endswith(") refused: not allowed")
    assert len(refused.read()) == 6  # fifty of a kind are not fifty lines
    assert {one["operator"] for one in refused.found} == {"vera"}
    close(session)
    close(answering)


def test_a_key_with_a_line_end_accuses_nobody_else(own: CertifiedDaemon) -> None:
    """Zenoh allows it in a key, and writes keys to its log as they are."""
    own.client_of("vera").close()
    refused = Refused(own)
    session = open_client(own.endpoint, credentials.read(own.key("vera")))
    false = (
        "x\n2026-01-01T00:00:00.000000Z TRACE rx-0 ThreadId(07) zenoh::net::routing::interceptor::access_control: 1a on"
        " CertCommonName(kim.00)+1a is unauthorized to Put (ingress) on y\n2026-01-01T00:00:00.000000Z TRACE rx-0 "
        "ThreadId(07) zenoh::net::routing::interceptor: Msg intercepted!"
    )
    session.put(false, b"")
    line = refused.line("put of x\\n2026-01-01")
    assert " by vera (certificate vera." in line
    assert {one["operator"] for one in refused.found} == {"vera"}
    close(session)


def test_each_connection_that_tls_refuses_is_one_line_with_the_reason(
    own: CertifiedDaemon, tmp_path: pathlib.Path
) -> None:
    own.client_of("kim").close()
    refused = Refused(own)
    stranger = KeyIssuer(tmp_path / "keys", datetime.datetime.now(datetime.UTC))
    stranger.init([])
    stranger.add("kim", Role.MAINTAINER)
    foreign, mine = credentials.read(stranger.folder.issued("kim")), credentials.read(own.key("kim"))
    late = KeyIssuer(own.keys.folder.path, datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=9))
    late.add("eva", Role.VIEWER, days=1)
    own.renewed_gateway()
    own.client_of("kim").close()
    plain = own.endpoint.replace("tls/", "tcp/")
    trusting = dataclasses.replace(foreign, authority=mine.authority)
    attempts: list[tuple[str, credentials.Credentials | None, str]] = [
        (own.endpoint, foreign, "it does not accept the certificate of this rig"),
        (own.endpoint, trusting, "its certificate is of another authority"),
        (own.endpoint, credentials.read(own.key("eva")), "its certificate has expired"),
        (plain, None, "it speaks no TLS"),
    ]
    for endpoint, owned, why in attempts:
        for _ in range(5):
            with pytest.raises(SessionError):
                close(open_client(endpoint, owned))
        assert refused.line(why) == f"connection of an unknown client refused: {why}"
    host, _, port = own.endpoint.removeprefix("tls/").rpartition(":")
    anonymous = ssl.create_default_context(cafile=str(own.keys.folder.path / "authority.pem"))
    with (
        contextlib.suppress(OSError),
        socket.create_connection((host, int(port)), patience_s()) as connection,
        anonymous.wrap_socket(connection, server_hostname=host) as secure,
    ):
        secure.recv(1)
    refused.line("it has no certificate")
    assert len(refused.read()) == len(attempts) + 1


def test_what_people_may_do_leaves_no_such_line(own: CertifiedDaemon) -> None:
    """Every command of the command line, and streams; and it outlives a renewed access list."""
    refused = Refused(own)
    with own.client_of("max") as client:
        states, samples, events = client.follow(client.keys.state), client.samples(past=True), client.events(past=True)
        assert client.take_lease("max")["accepted"]
        assert client.command("target", "max", 300.0)["accepted"]
        assert states.read(patience_s()) is not None
        samples.read(0.1)
        events.read(0.1)
        client.active()
        client.schema()
        for name, words in (("vera", ["status"]), ("kim", ["hold"]), ("vera", ["status", "--json"])):
            own.cli("--key", str(own.key(name)), *words)
        own.keys.add("eva", Role.VIEWER)
        own.renewed_gateway()
        own.client_of("eva").close()

        def returned() -> bool:
            with contextlib.suppress(NoDaemonError):  # the session finds the next gateway by itself
                return bool(client.return_lease("max")["accepted"])
            return False

        until(returned, "the lease to be given back")
        until(lambda: states.read(0.1), "a state of the next gateway")
    assert refused.read() == []


def test_a_revoked_person_is_on_record_with_each_kind_of_message(own: CertifiedDaemon) -> None:
    own.client_of("kim").close()
    own.keys.revoke("kim")
    own.renewed_gateway()
    own.client_of("vera").close()
    refused = Refused(own)
    session = open_client(own.endpoint, credentials.read(own.key("kim")))
    key = Keys("paper_rig", "kim").command("hold")
    assert list(session.get(key, payload=json.dumps({"operator": "kim"}).encode(), timeout=patience_s())) == []
    assert "by kim (certificate kim." in refused.line(f"query of {key}")
    close(session)
