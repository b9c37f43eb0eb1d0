"""What the page's server refuses: commands without rights, other sites' pages, foreign names, bad addresses."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from typing import Any

import pytest
from starlette.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from rigctl.config.address import Address, AddressError
from rigctl.page.guard import HEADERS, Guard
from tests.builders.miniature import Daemon, free_port
from tests.builders.pages import Server, serving
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

COMMANDS = [
    ("lease", {"act": "take"}),
    ("command", {"verb": "arm"}),
    ("command", {"verb": "hold"}),
    ("command", {"verb": "target", "value": 200}),
    ("confirm", {"confirm": "0"}),
]


def leases_and_orders(daemon: Daemon) -> tuple[Any, int]:
    """Holder of the lease, and the number of commands given to the loop (except HOST_CHECKS of the gateway)."""
    with daemon.client() as client:
        state = client.state()
    commands = daemon.runtime.requests.reader(from_start=True)
    commands.cursor = 0
    return state["lease"], len(commands.read())


@pytest.mark.parametrize(("what", "body"), COMMANDS)
def test_a_read_only_page_refuses_every_command(
    readonly: Server, daemon: Daemon, what: str, body: dict[str, Any]
) -> None:
    before = leases_and_orders(daemon)
    status, answer = readonly.command(what, body, session={"X-Rigctl-Key": "anything"})
    assert status == 403
    assert "read-only" in answer["text"]
    assert leases_and_orders(daemon) == before


@pytest.mark.parametrize(("what", "body"), COMMANDS)
@pytest.mark.parametrize("wrong", ["http://evil.example", "null", "", "http://127.0.0.1:1"])
def test_from_another_site_nothing_is_commanded(
    commanding: Server, daemon: Daemon, what: str, body: dict[str, Any], wrong: str
) -> None:
    before = leases_and_orders(daemon)
    status, answer = commanding.command(what, body, origin=wrong)
    assert status == 403
    assert not answer["accepted"]
    assert leases_and_orders(daemon) == before


@pytest.mark.parametrize("method", ["GET", "PUT", "DELETE", "OPTIONS"])
def test_commands_are_posted_or_nothing(commanding: Server, method: str) -> None:
    status, headers, _ = commanding.ask(method, "/api/command", {"verb": "hold"}, **commanding.session)
    assert status == 405
    assert "access-control-allow-origin" not in headers


def test_a_name_made_to_point_here_gets_nothing(commanding: Server) -> None:
    """DNS rebinding: for the browser, evil.example is this host, and Origin and Host agree."""
    evil = f"evil.example:{commanding.port}"
    for method, path in (("GET", "/"), ("GET", "/static/page.js"), ("POST", "/api/command")):
        status, _, body = commanding.ask(
            method, path, {"verb": "hold"}, **commanding.session, host=evil, origin=f"http://{evil}"
        )
        assert status == 421
        assert b"rigctl" not in body


@pytest.mark.parametrize("origin", ["http://evil.example", None])
def test_the_stream_is_for_our_own_page_alone(readonly: Server, origin: Any) -> None:
    with pytest.raises(InvalidStatus), connect(f"ws://127.0.0.1:{readonly.port}/stream", origin=origin):
        pass
    with connect(f"ws://127.0.0.1:{readonly.port}/stream", origin=Origin(readonly.base)) as stream:
        assert '"hello"' in str(stream.recv(timeout=patience_s()))


NO_REQUESTS = {
    "text that is not UTF-8": (b'{"window": "\xff"}', True), "bytes": (b"\xff\xfe", False),
    "a window that is none": (b'{"window": [1]}', True), "no object": (b"7", True), "no JSON": (b"{", True),
    "deep": (b"[" * 4000, True), "a large number": (b'{"window": 1e999}', True), "empty": (b"", True),
}  # fmt: skip


def test_what_a_browser_sends_on_the_stream_ends_in_no_traceback(daemon: Daemon) -> None:
    """Text that is not UTF-8 ends its own stream (RFC 6455, 8.1); the server has nothing on standard error."""
    with serving(daemon.endpoint) as server:
        where, own = f"ws://127.0.0.1:{server.port}/stream", Origin(server.base)
        for what, (data, text) in NO_REQUESTS.items():
            with connect(where, origin=own) as stream:
                stream.recv(timeout=patience_s())
                stream.send(data, text=text)
                if what == "text that is not UTF-8":
                    with pytest.raises(ConnectionClosed):
                        while True:
                            stream.recv(timeout=patience_s())
                    continue
                stream.send('{"window": 1}')
                while not isinstance(stream.recv(timeout=patience_s()), bytes):
                    pass
        assert server.process.poll() is None
        assert server.end() == (0, "")


def test_every_answer_forbids_what_does_not_come_from_here(readonly: Server) -> None:
    for path in ("/", "/static/page.css", "/static/nothing.js", "/nothing"):
        _, headers, _ = readonly.ask("GET", path)
        for name, value in HEADERS.items():
            assert headers[name] == value
    policy = HEADERS["content-security-policy"]
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe" not in policy


@pytest.mark.parametrize(
    ("what", "body", "said"),
    [
        ("command", {"verb": "tare"}, "expected hold, release"),
        ("command", {"verb": "arm", "value": 3}, "expected with target and carry alone"),
        ("command", {"verb": "carry"}, "found no value"),
        ("command", {"verb": "target"}, "found no value"),
        (
            "command",
            {"verb": "target", "value": "290,5"},
            "TARGET: found '290,5', expected a number of newtons with a ",
        ),
        ("command", {"verb": "target", "value": "3_00"}, "expected a number of newtons such as 290.5"),
        ("command", {"verb": "target", "value": ""}, "expected a number of newtons such as 290.5"),
        ("command", {"verb": "carry", "value": "1,5"}, "CARRY: found '1,5', expected a number of seconds with a "),
        ("command", {"verb": "release", "value": "10,5"}, "RELEASE: found '10,5', expected a number of millimetres "),
        ("command", {"verb": "target", "value": [290]}, "not a command"),
        ("alarm", {"act": "shelve", "cause": "X", "reason": "r", "minutes": "1,5"}, "SHELVE: found '1,5', expected a "),
        ("alarm", {"act": "shelve", "cause": "X", "reason": "r", "minutes": "481"}, "found 481, expected 0.1 to 480 "),
        ("alarm", {"act": "shelve", "cause": "X", "reason": "r"}, "SHELVE: found '', expected a number of minutes"),
        ("command", {"verb": "arm", "force": True}, "unknown field"),
        ("command", {}, "missing required field"),
        ("command", [1], "not a command"),
        ("confirm", {"confirm": "ä"}, "ask again"),
        ("lease", {"act": "steal"}, "expected take, return"),
        ("command", {"verb": "x" * 5000}, "found more than 4096 bytes"),
    ],
)
def test_what_is_no_command_is_refused_in_words(commanding: Server, what: str, body: Any, said: str) -> None:
    status, answer = commanding.command(what, body)
    assert status in (400, 409)
    assert said in answer["text"]


def page(*options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rigctl", "page", *options],
        capture_output=True, text=True, timeout=patience_s(), check=False, cwd=ROOT, env={**os.environ},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--listen", "8080"], 2, "found '8080', expected HOST:PORT"),
        (["--listen", "127.0.0.1:99999"], 2, "found '127.0.0.1:99999'"),
        (["--listen", "1.2.3:80"], 2, "found '1.2.3:80'"),
        (["--listen", "192.0.2.1:8080"], 1, "cannot listen on 192.0.2.1:8080"),
        (["--listen", "0.0.0.0:0", "--operator", "kim"], 2, "allowed with --remote-operator"),
        (["--remote-operator"], 2, "expected with --operator"),
        (["--operator", " "], 2, "found operator"),
        (["--tls-cert", "cert.pem"], 2, "expected both or neither"),
        (["--tls-cert", "none.pem", "--tls-key", "none.key"], 2, "none.pem: cannot be read: No such file"),
        (["--link", "--listen", "127.0.0.1:1"], 1, "no page server of this user with sign-in listens at port 1"),
        (["--connect", "nonsense"], 2, "found endpoint 'nonsense'"),
        (["--rig", "NOT A RIG"], 2, "found rig"),
    ],
    ids=str,
)
def test_what_cannot_be_served_is_one_line(options: list[str], code: int, said: str) -> None:
    connect = [] if "--connect" in options else ["--connect", f"tcp/127.0.0.1:{free_port()}"]
    answer = page(*options, *connect)
    assert answer.returncode == code
    assert said in answer.stderr
    assert answer.stderr.count("\n") == 1
    assert answer.stdout == ""


def test_a_port_in_use_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        answer = page("--listen", listen, "--connect", f"tcp/127.0.0.1:{free_port()}")
    assert answer.returncode == 1
    assert answer.stderr == f"rigctl: cannot listen on {listen}: it is in use\n"


def test_rights_on_the_network_are_warned_of() -> None:
    nobody = f"tcp/127.0.0.1:{free_port()}"
    with serving(nobody, "--listen", "0.0.0.0:0", "--operator", "kim", "--remote-operator") as server:
        assert server.process.stdout is not None
        assert "can command the rig" in server.process.stdout.readline()
        assert server.command("lease", {"act": "take"}, session={})[0] == 403
        assert server.end() == (0, "")


@pytest.mark.parametrize(
    ("listen", "host", "ours"),
    [
        ("127.0.0.1", "127.0.0.1:8080", True),
        ("127.0.0.1", "localhost:8080", True),
        ("127.0.0.1", "[::1]:8080", True),
        ("127.0.0.1", "192.0.2.7:8080", False),
        ("127.0.0.1", "evil.example", False),
        ("127.0.0.1", "", False),
        ("0.0.0.0", "192.0.2.7:8080", True),
        ("0.0.0.0", f"{socket.gethostname()}:8080", True),
        ("0.0.0.0", f"{socket.gethostname().partition('.')[0]}.local:8080", True),
        ("0.0.0.0", f"{socket.gethostname()}.evil.example:8080", False),
        ("127.0.0.1", f"{socket.gethostname()}.evil.example", False),
        ("127.0.0.1", "localhost.evil.example", False),
        ("127.0.0.1", "127.0.0.1.evil.example", False),
        ("127.0.0.1", "localhost:8080.evil.example", False),
        ("127.0.0.1", "[::1]evil.example", False),
        ("0.0.0.0", "evil.example:8080", False),
        ("rig-pc.lab", "RIG-PC.lab:8080", True),
    ],
)
def test_the_server_goes_by_its_own_names_alone(listen: str, host: str, ours: bool) -> None:
    assert Guard.of(Address(listen, 8080)).names_us(Headers({"host": host})) is ours


@pytest.mark.parametrize("text", ["", ":80", "a:", "a b:80", "[::1:80", "[nonsense]:80", "300.1.1.1:80", "host:-1"])
def test_text_that_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(AddressError, match="expected HOST:PORT"):
        Address.parse(text)


@pytest.mark.parametrize(
    ("text", "loopback"),
    [
        ("127.0.0.1:8080", True),
        ("[::1]:80", True),
        ("localhost:0", True),
        ("0.0.0.0:80", False),
        ("rig-pc.lab:1", False),
    ],
)
def test_an_address_is_read_and_written_the_same(text: str, loopback: bool) -> None:
    address = Address.parse(text)
    assert str(address) == text
    assert address.is_loopback is loopback
