"""The page and the rig's own authority: HTTPS with a key from `rigctl keys`, and telemetry with certificates."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from rigctl.identity import credentials
from rigctl.identity.roles import Role
from rigctl.ipc.notes import note_message
from rigctl.wire.session import SessionError, open_client
from tests.builders.certified import CertifiedDaemon, certified
from tests.builders.miniature import free_port
from tests.builders.pages import Server, look, serving
from tests.builders.waiting import patience_s, until


@pytest.fixture(scope="module")
def certified_daemon() -> Iterator[CertifiedDaemon]:
    for found in certified():
        found.client_of("kim").close()
        found.keys.add("page", Role.PAGE)
        found.renewed_gateway()
        found.client_of("kim").close()
        yield found


def authority(daemon: CertifiedDaemon) -> ssl.SSLContext:
    """Trusts the rig's authority and no other."""
    return ssl.create_default_context(cafile=str(daemon.keys.folder.path / "authority.pem"))


@pytest.fixture(scope="module")
def secured(certified_daemon: CertifiedDaemon) -> Iterator[Server]:
    """``rigctl page --connect tls/...`` of kim, who typed another name, served by HTTPS."""
    file = str(certified_daemon.key("page"))
    options = ("--operator", "the_boss", "--sign-in", "--tls-cert", file, "--tls-key", file)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RIGCTL_KEY", str(certified_daemon.key("kim")))
        with serving(certified_daemon.endpoint, *options, tls=authority(certified_daemon)) as server:
            yield server


def test_a_browser_that_trusts_the_rigs_authority_alone_is_served(
    certified_daemon: CertifiedDaemon, secured: Server
) -> None:
    assert secured.said.startswith(f"page: https://127.0.0.1:{secured.port}/")
    assert "(commands as kim)" in secured.said
    status, _, body = secured.ask("GET", "/")
    assert (status, b"<title>" in body) == (200, True)
    with (
        socket.create_connection(("127.0.0.1", secured.port), patience_s()) as plain,
        pytest.raises(ssl.SSLCertVerificationError),
    ):
        ssl.create_default_context().wrap_socket(plain, server_hostname="127.0.0.1")
    with (
        socket.create_connection(("127.0.0.1", secured.port), patience_s()) as plain,
        pytest.raises(ssl.SSLCertVerificationError, match="not valid for"),
    ):
        authority(certified_daemon).wrap_socket(plain, server_hostname="another-host")


def test_its_commands_are_the_persons_whose_key_it_has(certified_daemon: CertifiedDaemon, secured: Server) -> None:
    given = certified_daemon.runtime.requests.reader()
    status, taken = secured.command("lease", {"act": "take"})
    assert (status, taken["accepted"], taken["operator"]) == (200, True, "kim")
    status, proposed = secured.command("command", {"verb": "target", "value": 301.0})
    assert status == 200, proposed
    status, done = secured.command("confirm", {"confirm": proposed["confirm"]})
    assert (status, done["operator"]) == (200, "kim"), done
    assert secured.command("lease", {"act": "return"})[1]["accepted"]
    names: set[bytes] = set()

    def recorded() -> bool:
        names.update(bytes(slot["operator"]) for slot in given.read())
        return b"kim" in names

    until(recorded, "the record")
    assert names == {b"kim"}


def test_the_pages_key_opens_no_session_with_the_gateway(certified_daemon: CertifiedDaemon) -> None:
    with pytest.raises(SessionError):
        open_client(certified_daemon.endpoint, credentials.read(certified_daemon.key("page")))


def test_the_daemons_own_page_reads_by_the_socket_and_is_refused_nothing(
    certified_daemon: CertifiedDaemon, chromium: Browser
) -> None:
    """Without a key of its own."""
    daemon = certified_daemon
    written = daemon.runtime.read_json("active.json")
    port = free_port()
    settings = {**written["settings"], "page": {"listen": f"127.0.0.1:{port}"}}
    daemon.runtime.write_json("active.json", {**written, "settings": settings})
    page = daemon.spawn("-m", "rigctl.page", str(daemon.runtime.directory))
    assert page.stdout is not None
    said = page.stdout.readline()
    assert f"page: http://127.0.0.1:{port}/" in said
    seen = look(chromium, f"http://127.0.0.1:{port}/")
    seen.live()
    assert seen.text("#mode")
    seen.page.close()
    notes = [note_message(note, 0)[1] for note in daemon.runtime.notes.reader(from_start=True).read()]
    assert not [one for one in notes if one["kind"] == "MESSAGE_REFUSED" and "socket" in one["other"]]
