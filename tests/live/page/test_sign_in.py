"""Sign-in by a one-time link: over real requests, web sockets, a browser, plain HTTP and HTTPS."""

from __future__ import annotations

import contextlib
import os
import pathlib
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import trustme
from playwright.sync_api import Browser, Error
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from rigctl.page.browser_connection import CONNECTIONS
from tests.builders.miniature import Daemon, free_port
from tests.builders.pages import Server, look, new_page, serving
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s, until

SIGNED = ("--sign-in",)


@pytest.fixture(scope="module")
def signed(daemon: Daemon) -> Iterator[Server]:
    """A read-only page that shows nothing without a session."""
    with serving(daemon.endpoint, *SIGNED) as server:
        yield server


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture(scope="module")
def files(authority: trustme.CA, tmp_path_factory: pytest.TempPathFactory) -> tuple[pathlib.Path, pathlib.Path]:
    folder = tmp_path_factory.mktemp("tls")
    issued, cert, key = authority.issue_cert("127.0.0.1"), folder / "page.pem", folder / "page.key"
    cert.write_bytes(b"".join(pem.bytes() for pem in issued.cert_chain_pems))
    key.touch(0o600)
    key.write_bytes(issued.private_key_pem.bytes())
    return cert, key


@pytest.fixture(scope="module")
def secured(daemon: Daemon, authority: trustme.CA, files: tuple[pathlib.Path, pathlib.Path]) -> Iterator[Server]:
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)
    options = ("--operator", "kim", "--sign-in", "--tls-cert", str(files[0]), "--tls-key", str(files[1]))
    with serving(daemon.endpoint, *options, tls=trusting) as server:
        yield server


def stream(server: Server, session: dict[str, str], tls: ssl.SSLContext | None = None) -> ClientConnection:
    """The page's web socket, as a browser opens it."""
    protocols = ["rigctl", f"rigctl.key.{session.get('X-Rigctl-Key', '')}"]
    cookie = {"Cookie": session["Cookie"]} if "Cookie" in session else {}
    return connect(
        f"{server.base.replace('http', 'ws', 1)}/stream",
        origin=Origin(server.base),
        subprotocols=[Subprotocol(name) for name in protocols],
        additional_headers=cookie,
        ssl=tls,
    )


def test_a_link_is_good_for_one_sign_in(signed: Server) -> None:
    code = signed.new_code()
    assert signed.sign_in(code)
    status, headers, body = signed.ask("POST", "/api/sign-in", {"link": code})
    assert status == 403
    assert b"used before" in body
    assert "set-cookie" not in headers


@pytest.mark.parametrize("body", [{}, [], {"link": 1}, {"link": "x" * 5000}, {"link": "ä", "more": 1}, None])
def test_what_is_no_link_is_refused_in_words(signed: Server, body: Any) -> None:
    status, _, answer = signed.ask("POST", "/api/sign-in", body)
    assert status == 400
    assert b"not a link" in answer


def test_a_link_is_not_taken_from_another_sites_page(signed: Server) -> None:
    """Otherwise that page could sign a browser in as somebody else."""
    code = signed.new_code()
    for origin in ("http://evil.example", "null", f"http://127.0.0.1:{free_port()}"):
        assert signed.ask("POST", "/api/sign-in", {"link": code}, origin=origin)[0] == 403
    assert signed.sign_in(code)


def test_the_cookie_is_for_this_server_and_no_script(signed: Server) -> None:
    _, headers, _ = signed.ask("POST", "/api/sign-in", {"link": signed.new_code()})
    name, *attributes = headers["set-cookie"].split("; ")
    assert name.startswith(f"rigctl-{signed.port}=")
    assert set(attributes) == {"Path=/", "HttpOnly", "SameSite=Strict"}


def test_over_https_the_cookie_is_secure(secured: Server) -> None:
    _, headers, _ = secured.ask("POST", "/api/sign-in", {"link": secured.new_code()})
    assert headers["set-cookie"].startswith(f"__Host-rigctl-{secured.port}=")
    assert "Secure" in headers["set-cookie"].split("; ")


def stolen(session: dict[str, str]) -> dict[str, dict[str, str]]:
    """What a thief may have of a session: all of it is not among them."""
    return {
        "nothing": {},
        "the cookie, which browsers send to every port of this host": {"Cookie": session["Cookie"]},
        "the key": {"X-Rigctl-Key": session["X-Rigctl-Key"]},
        "another's key": {**session, "X-Rigctl-Key": "A" * 43},
        "another name": {**session, "Cookie": f"rigctl={session['Cookie'].partition('=')[2]}"},
        "no cookie at all": {**session, "Cookie": ";;=;rigctl=("},
    }


@pytest.mark.parametrize("what", list(stolen({"Cookie": "", "X-Rigctl-Key": ""})))
def test_half_a_session_sees_and_commands_nothing(signed: Server, commanding: Server, what: str) -> None:
    part = stolen(commanding.session)[what]
    status, answer = commanding.command("command", {"verb": "hold"}, session=part)
    assert status == 403
    assert "has not signed in" in answer["text"]
    with pytest.raises(InvalidStatus), stream(signed, stolen(signed.session)[what]):
        pass


def test_a_session_is_one_servers(daemon: Daemon, commanding: Server) -> None:
    with serving(daemon.endpoint, "--operator", "kim") as other:
        cookie = commanding.session["Cookie"].replace(str(commanding.port), str(other.port))
        taken = {**commanding.session, "Cookie": cookie}
        assert other.command("command", {"verb": "hold"}, session=taken)[0] == 403
        assert other.command("session", {})[1]["operator"] == "kim"


def test_signing_out_ends_stream_and_rights(signed: Server) -> None:
    session = signed.sign_in(signed.new_code())
    with stream(signed, session) as one:
        assert '"hello"' in str(one.recv(timeout=patience_s()))
        assert one.subprotocol == "rigctl"
        assert signed.command("sign-out", {}, session=session)[0] == 200
        with pytest.raises(ConnectionClosed):
            while one.recv(timeout=patience_s()):
                pass
    with pytest.raises(InvalidStatus), stream(signed, session):
        pass
    assert signed.command("session", {}, session=session)[1]["signed_in"] is False


def test_the_session_of_another_page_is_not_ended_by_a_foreign_site(signed: Server) -> None:
    assert signed.command("sign-out", {}, origin="http://evil.example")[0] == 403
    assert signed.command("session", {})[1]["signed_in"]


def test_beyond_loopback_reading_needs_a_session(daemon: Daemon) -> None:
    with serving(daemon.endpoint, "--listen", "0.0.0.0:0") as server:
        assert "#link=" in server.said
        assert server.process.stdout is not None
        assert "whoever listens on the network" in server.process.stdout.readline()
        with pytest.raises(InvalidStatus), stream(server, {}):
            pass
        with stream(server, server.session) as one:
            assert '"hello"' in str(one.recv(timeout=patience_s()))


def test_on_loopback_reading_is_open_to_this_computers_users(readonly: Server) -> None:
    """As the telemetry itself; --sign-in closes it."""
    assert "#link=" not in readonly.said
    with stream(readonly, {}) as one:
        assert '"hello"' in str(one.recv(timeout=patience_s()))


def page_link(server: Server) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rigctl", "page", "--link", "--listen", f"127.0.0.1:{server.port}"],
        cwd=ROOT, env=server.environment, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip


def test_rigctl_page_prints_another_link(signed: Server) -> None:
    until(signed.new_code, "the socket")
    first, second = page_link(signed), page_link(signed)
    assert first.returncode == second.returncode == 0, first.stderr
    for answer in (first, second):
        address, _, code = answer.stdout.strip().partition("#link=")
        assert address == f"{signed.base}/"
        assert signed.sign_in(code)
    assert first.stdout != second.stdout


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")
def test_another_user_gets_no_link_even_where_the_socket_is_open_to_him(signed: Server) -> None:
    socket_file = signed.folder / "rigctl" / f"page-{signed.port}.sock"
    until(socket_file.exists, "the socket")
    for found in (signed.folder, socket_file.parent, socket_file):
        found.chmod(0o777)
    reading, writing = os.pipe()
    if not (child := os.fork()):
        try:
            os.setresuid(65534, 65534, 65534)
            with socket.socket(socket.AF_UNIX) as connection:
                connection.connect(str(socket_file))
                os.write(writing, b"connected, " + connection.recv(999))
        finally:
            os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with os.fdopen(reading, "rb") as answer:
        assert answer.read() == b"connected, "
    socket_file.parent.chmod(0o700)


def test_the_browser_signs_in_reads_and_signs_out(chromium: Browser, signed: Server) -> None:
    bare = look(chromium, f"{signed.base}/")
    bare.until("document.querySelector('#stale-what').textContent === 'SIGN IN'")
    assert "open a link of rigctl page" in bare.text("#stale-why")
    assert bare.run("rigctl.state === null")
    bare.page.close()

    link = signed.address
    seen = look(chromium, link)
    seen.live()
    assert "link=" not in seen.run("location.href")
    assert seen.run("document.cookie") == ""
    seen.page.reload()
    seen.live()  # the session outlives the link
    seen.until("!document.querySelector('#sign-out').hidden")
    seen.page.click("#sign-out")
    with contextlib.suppress(Error):  # the page is being loaded anew
        seen.until("window.rigctl && document.querySelector('#stale-what').textContent === 'SIGN IN'")
    seen.page.close()

    seen = look(chromium, link)
    seen.until("document.querySelector('#stale-why').textContent.includes('used before')")
    seen.page.close()


def test_the_browser_commands_over_https(chromium: Browser, secured: Server) -> None:
    page = new_page(chromium, ignore_https_errors=True)
    page.goto(secured.address)
    until(lambda: page.evaluate("window.rigctl && rigctl.draws > 1 && !rigctl.stale"), "charts")
    until(lambda: page.evaluate("!document.querySelector('#commands').hidden"), "the commands")
    assert page.evaluate("document.querySelector('#rights').textContent") == "commands as kim"
    page.click("#hold")
    until(lambda: page.evaluate("document.querySelector('#said').textContent.includes('HOLD refused: ')"), "the answer")
    assert {cookie["secure"] for cookie in page.context.cookies()} == {True}
    page.close()


def test_https_is_checked_against_its_authority(secured: Server, authority: trustme.CA) -> None:
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)
    with stream(secured, secured.session, trusting) as one:
        assert '"hello"' in str(one.recv(timeout=patience_s()))
    with socket.create_connection(("127.0.0.1", secured.port), patience_s()) as plain:
        plain.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        with pytest.raises(ssl.SSLCertVerificationError):
            ssl.create_default_context().wrap_socket(
                socket.create_connection(("127.0.0.1", secured.port), patience_s()), server_hostname="127.0.0.1"
            )
        assert b"rigctl" not in plain.recv(65536)


def test_over_https_hold_is_served_however_many_shake_no_hand(secured: Server) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(2 * CONNECTIONS):
            stack.enter_context(socket.create_connection(("127.0.0.1", secured.port), patience_s()))
        for _ in range(4):
            status, answer = secured.command("command", {"verb": "hold"})
            assert status in (200, 409), answer
            assert answer["verb"] == "hold"


@pytest.mark.parametrize("wrong", ["open to others", "another's key", "no PEM", "a folder"])
def test_a_certificate_that_gives_no_https_is_one_line(
    wrong: str, files: tuple[pathlib.Path, pathlib.Path], tmp_path: pathlib.Path
) -> None:
    cert, key = files[0], tmp_path / "key"
    key.touch(0o600)
    key.write_bytes(files[1].read_bytes())
    said = {
        "open to others": "found mode 0644, expected 0600",
        "another's key": "is not the key of the certificate",
        "no PEM": "gives no PEM key for the certificate",
        "a folder": "is no file",
    }[wrong]
    if wrong == "open to others":
        key.chmod(0o644)
    elif wrong == "another's key":
        key.write_bytes(trustme.CA().issue_cert("127.0.0.1").private_key_pem.bytes())
    elif wrong == "no PEM":
        key.write_text("nothing")
    else:
        cert = tmp_path
    answer = subprocess.run(
        [sys.executable, "-m", "rigctl", "page", "--connect", f"tcp/127.0.0.1:{free_port()}", "--listen",
         "127.0.0.1:0", "--tls-cert", str(cert), "--tls-key", str(key)],
        cwd=ROOT, capture_output=True, text=True, timeout=patience_s(), check=False,
    )  # fmt: skip
    assert answer.returncode == 2
    assert said in answer.stderr
    assert answer.stderr.count("\n") == 1
