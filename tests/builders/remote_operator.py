"""An operator with a key file on another computer: a process of another user, also in another network namespace.

``python remote_operator.py ENDPOINT RIG KEY`` prints ``ready``, then one line of JSON for each line of JSON on its
standard input: ``["command", VERB, VALUE]``, ``["take", REASON]``, ``["return"]``, ``["connected"]`` (wait for a
gateway that was started anew), ``["sent"]`` (the newest command as it was sent), or ``["raw", KEY, PAYLOAD]`` in
hexadecimal text.
"""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess
import sys
import time
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(pathlib.Path(__file__).parents[2]))

from rigctl.client.connection import Client, NoDaemonError
from rigctl.client.shapes import refusal
from tests.builders.intruder import NOBODY, become_nobody
from tests.builders.miniature import Daemon
from tests.builders.waiting import patience_s


class RemoteOperator:
    """The process, from the test's side."""

    def __init__(
        self, endpoint: str, rig: str, key: pathlib.Path, folder: pathlib.Path, namespace: tuple[str, ...] = ()
    ) -> None:
        """``folder``: for his copy of the key file."""
        folder.chmod(0o755)
        own = folder / key.name
        shutil.copy(key, own)
        os.chown(own, NOBODY, NOBODY)
        own.chmod(0o600)
        command = [*namespace, sys.executable, __file__, endpoint, rig, str(own)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd="/", bufsize=1
        )
        assert self.process.stdout is not None
        first = self.process.stdout.readline()
        assert first == "ready\n", first

    def do(self, *words: object) -> dict[str, Any]:
        """One line to the process; returns its answer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(words) + "\n")
        self.process.stdin.flush()
        return dict(json.loads(self.process.stdout.readline()))

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()

    def __enter__(self) -> RemoteOperator:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


class _Remembering(Client):
    """A client that keeps its newest command as it was sent."""

    sent: tuple[str, bytes] = ("", b"")

    def ask(self, selector: str, payload: bytes | None = None, *more: Any, **named: Any) -> tuple[bool, bytes]:
        if "/cmd/" in selector:
            self.sent = (selector, payload or b"")
        return super().ask(selector, payload, *more, **named)


def _raw(client: Client, key: str, payload: bytes) -> dict[str, Any]:
    for reply in client.session.get(key, payload=payload, timeout=patience_s()):
        if reply.ok is not None:
            return dict(json.loads(bytes(reply.ok.payload)))
        assert reply.err is not None
        return dict(refusal(bytes(reply.err.payload)))
    return {"accepted": False, "reason": "no answer"}


def _opened(endpoint: str, rig: str, key: str) -> _Remembering:
    """On a busy computer a session may need more than one try."""
    until = time.monotonic() + patience_s()
    while True:
        try:
            return _Remembering(endpoint, rig, key=key)
        except NoDaemonError:
            if time.monotonic() > until:
                raise


def main(endpoint: str, rig: str, key: str) -> None:
    become_nobody()
    client = _opened(endpoint, rig, key)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for line in sys.stdin:
        what, *words = json.loads(line)
        match what:
            case "connected":
                Daemon.answers(client)
                answer = {}
            case "command":
                answer = client.command(words[0], "", words[1])
            case "take":
                answer = client.take_lease("", words[0])
            case "return":
                answer = client.return_lease("")
            case "sent":
                sent, payload = client.sent
                answer = {"key": sent, "payload": payload.hex()}
            case _:
                answer = _raw(client, words[0], bytes.fromhex(words[1]))
        sys.stdout.write(json.dumps({**answer, "by_socket": client.route.is_local}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
