"""An operator with a key file on another computer: a process of another user, also in another network namespace.

``python remote_operator.py ENDPOINT RIG KEY`` prints ``ready``, then one line of JSON for each line of JSON on its
standard input: ``["command", VERB, VALUE]``, ``["take", REASON]``, ``["return"]``, ``["connected"]`` (wait for a
gateway that was started anew), ``["sent"]`` (the newest command as it was sent), or ``["raw", KEY, PAYLOAD,
ATTACHMENT]`` in hexadecimal text.
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

import msgspec

from rigctl.client.connection import Client, NoDaemonError
from rigctl.client.shapes import refusal
from rigctl.wire.proof import unsealed
from tests.builders.intruder import NOBODY, PATIENCE_S, become_nobody
from tests.builders.miniature import Daemon

OTHER_CLOCK_NS = 10**15  # another computer's monotonic clock has another origin


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

    sent: tuple[str, bytes, bytes] = ("", b"", b"")

    def ask(self, selector: str, payload: bytes | None = None, *more: Any, **named: Any) -> tuple[bool, bytes]:
        if "/cmd/" in selector:
            attachment = more[2] if len(more) > 2 else named.get("attachment")
            self.sent = (selector, payload or b"", msgspec.json.encode(attachment))
        return super().ask(selector, payload, *more, **named)


def _raw(client: Client, key: str, payload: bytes, attachment: bytes) -> dict[str, Any]:
    for reply in client.session.get(key, payload=payload, attachment=attachment, timeout=5.0):
        if reply.ok is not None:
            return dict(json.loads(bytes(reply.ok.payload)))
        assert reply.err is not None
        return dict(refusal(unsealed(bytes(reply.err.payload))[0]))
    return {"accepted": False, "reason": "no answer"}


def _opened(endpoint: str, rig: str, key: str) -> _Remembering:
    """On a busy computer a session may need more than one try."""
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            return _Remembering(endpoint, rig, key=key)
        except NoDaemonError:
            if time.monotonic() > until:
                raise


def main(endpoint: str, rig: str, key: str) -> None:
    become_nobody()
    client = _opened(endpoint, rig, key)
    client.trust._clock_ns = OTHER_CLOCK_NS
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
                sent, payload, attachment = client.sent
                answer = {"key": sent, "payload": payload.hex(), "attachment": attachment.hex()}
            case _:
                answer = _raw(client, words[0], bytes.fromhex(words[1]), bytes.fromhex(words[2]))
        has_key = client.trust.secret is not None
        sys.stdout.write(json.dumps({**answer, "has_operator_key": has_key}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
