"""What the gateway's liveliness token promises: who has a certificate and sees it can give a command."""

from __future__ import annotations

import contextlib
import pathlib
import socket
import threading
import time
from collections.abc import Iterator

import pytest
import zenoh

from rigctl.client.liveliness import Liveliness
from rigctl.gateway import gateway_process
from rigctl.identity import credentials
from rigctl.identity.credentials import Credentials
from rigctl.wire.keys import Keys
from rigctl.wire.session import SessionError, close, open_client
from tests.builders.certified import CertifiedDaemon, certified
from tests.builders.waiting import patience_s, until

DELAY_S = 0.3


@contextlib.contextmanager
def slow_relay(path: pathlib.Path, target: pathlib.Path) -> Iterator[None]:
    """A socket at ``path`` that relays one connection to ``target``, and sends on what it receives ``DELAY_S`` late."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()

        def copy(source: socket.socket, sink: socket.socket) -> None:
            with contextlib.suppress(OSError):
                while data := source.recv(1 << 16):
                    time.sleep(DELAY_S)
                    sink.sendall(data)
                sink.shutdown(socket.SHUT_WR)

        def relay() -> None:
            client, _ = listener.accept()
            with client, socket.socket(socket.AF_UNIX) as router:
                router.connect(str(target))
                back = threading.Thread(target=copy, args=(router, client), daemon=True)
                back.start()
                copy(client, router)
                back.join()

        threading.Thread(target=relay, daemon=True).start()
        yield


@pytest.fixture
def own() -> Iterator[CertifiedDaemon]:
    yield from certified()


def connected(endpoint: str, owned: Credentials) -> zenoh.Session:
    def attempt() -> zenoh.Session | None:
        with contextlib.suppress(SessionError):
            return open_client(endpoint, owned)
        return None

    session: zenoh.Session = until(attempt, "the gateway's listener")
    return session


def test_whoever_sees_the_token_can_give_a_command_however_slow_the_session_of_the_commands(
    own: CertifiedDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    own.kill_gateway()
    keys, slow = Keys(own.settings.rig, "kim"), own.runtime.directory / "slow"
    answers: list[bool] = []

    def take_lease() -> None:
        session = connected(own.endpoint, credentials.read(own.key("kim")))
        alive = Liveliness(session, keys.daemon)
        if alive.wait(True, patience_s()):
            key, body = keys.command("lease_take"), b'{"operator":"kim"}'
            query = session.get(key, payload=body, timeout=patience_s())
            answers.extend(answer.ok is not None for answer in query)
        alive.close()
        close(session)

    monkeypatch.setattr(
        gateway_process, "open_client", lambda _socket, **own: open_client(f"unixsock-stream/{slow}", **own)
    )
    with slow_relay(slow, pathlib.Path(own.runtime.gateway_socket)):
        client = threading.Thread(target=take_lease)
        client.start()
        gateway = gateway_process.Gateway(own.runtime, own.settings)
        client.join(patience_s())
        gateway.close()
    assert answers == [True]
