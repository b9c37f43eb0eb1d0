"""Connections of a revoked key, of another user and of nobody take no place of an operator's, and are on record."""

from __future__ import annotations

import contextlib
import os
import resource
from collections.abc import Iterator

import numpy as np
import pytest

from rigctl.client.connection import Client
from rigctl.gateway.places import SHARE, Why
from rigctl.identity import credentials
from rigctl.ipc.notes import Note
from rigctl.wire.session import SessionError, close, open_client
from tests.builders.certified import CertifiedDaemon, certified
from tests.builders.crowd import crowd
from tests.builders.miniature import Daemon, running
from tests.builders.waiting import until


@pytest.fixture
def descriptors() -> Iterator[None]:
    """As many as the system allows this process: each session of a client needs several."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.fixture
def own(descriptors: None) -> Iterator[CertifiedDaemon]:  # noqa: ARG001 - the daemon's processes inherit it
    yield from certified()


@pytest.fixture
def plain(descriptors: None) -> Iterator[Daemon]:  # noqa: ARG001
    """Without certificates."""
    yield from running()


def of_max(note: np.void) -> bool:
    return int(note["kind"]) == Note.CONNECTION_CLOSED and note["operator"].item().startswith(b"max")


def test_127_idle_sessions_of_a_revoked_key_shut_nobody_out(own: CertifiedDaemon) -> None:
    own.client_of("kim").close()
    own.keys.revoke("max")
    own.renewed_gateway()
    own.client_of("vera").close()
    notes = own.runtime.notes.reader(from_start=True)
    key = credentials.read(own.key("max"))
    idle = []
    for _ in range(127):
        with contextlib.suppress(SessionError):  # of a session that is closed while it opens
            idle.append(open_client(own.endpoint, key))
    assert len(idle) > 100
    with own.client_of("kim") as kim:
        assert kim.command("arm", "kim")["accepted"]
        assert kim.command("hold", "kim")["accepted"]
        assert kim.return_lease("kim")["accepted"]
    until(lambda: any(of_max(one) for one in notes.read()), "the record names whose sessions were closed")
    for session in idle:
        close(session)


def test_the_own_share_of_a_person_closes_the_oldest_and_never_the_newest(own: CertifiedDaemon) -> None:
    """Sixteen sessions of one key and one more: the one that commands is the newest, and is served."""
    own.client_of("kim").close()
    notes = own.runtime.notes.reader(from_start=True)
    key = credentials.read(own.key("kim"))
    idle = [open_client(own.endpoint, key) for _ in range(SHARE)]
    with own.client_of("kim") as kim:
        assert kim.command("arm", "kim")["accepted"]
        assert kim.command("hold", "kim")["accepted"]
        until(lambda: any(Why.SHARE in note["reason"].item().decode() for note in notes.read()), "the record")
        assert kim.return_lease("kim")["accepted"]
    for session in idle:
        close(session)


def commands(daemon: Daemon) -> None:
    """One session commands and holds, of three that are tried, since this computer may be busy."""
    for tries_left in (2, 1, 0):
        try:
            client = Client(daemon.endpoint, daemon.settings.rig)
        except RuntimeError:
            assert tries_left
            continue
        with client as kim:
            assert kim.command("target", "kim", 290.0)["accepted"]
            assert kim.command("hold", "kim")["text"]
            assert kim.return_lease("kim")["accepted"]
        return


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")
@pytest.mark.parametrize(
    ("kind", "number", "why"), [("sessions", 126, Why.SHARE), ("half_open", 1800, Why.OPENING_OF_SOURCE)]
)
def test_another_users_connections_shut_nobody_out(plain: Daemon, kind: str, number: int, why: Why) -> None:
    plain.client().close()
    notes = plain.runtime.notes.reader(from_start=True)
    reasons: list[str] = []

    def noted() -> bool:
        reasons.extend(one["reason"].item().decode() for one in notes.read() if b"uid 65534" in one["other"].item())
        return any(why in reason for reason in reasons)

    with crowd(kind, number, plain.endpoint):
        until(noted, "the record names whose connections were closed")
        for _ in range(3):
            commands(plain)
