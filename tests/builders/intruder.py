"""A local user without rights (uid 65534) who attacks a daemon: a process of his own with a real Zenoh session.

``python intruder.py ENDPOINT RIG TASK...`` prints ``ready``, then one line of JSON for each thing it sees, until its
standard input ends. Lines on its standard input are queries to send: key and payload as hexadecimal text.

Tasks: ``answers`` (a complete queryable on every key of the rig, with well-shaped forged answers), ``publishes``
(forged states and events, also on the keys of every rig at once), ``replays`` (every state again), ``tokens``
(liveliness tokens of rigs that do not exist), ``token=RIG``, ``takes_port`` (a router of his own at the endpoint, as
soon as that is free, with answers, token and states).
"""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import subprocess
import sys
import threading
import time
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(pathlib.Path(__file__).parents[2]))

import zenoh

from rigctl.wire.keys import Keys
from rigctl.wire.session import SessionError, open_client, open_router
from tests.builders.waiting import FACTOR, patience_s

NOBODY = 65534
FORGED = "stroke held at 12.34 mm, tension 56.7 N"


def become_nobody() -> None:
    """Give up root for another user. After the imports, since the checkout may be closed to him."""
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)


class Intruder:
    """The process, from the test's side.

    ``namespace``: words before its command, for another network namespace; ``patience``: how many times as long as
    usual it waits for the daemon.
    """

    def __init__(
        self, endpoint: str, rig: str, *tasks: str, namespace: tuple[str, ...] = (), patience: float = 1.0
    ) -> None:
        command = [*namespace, sys.executable, __file__, endpoint, rig, *tasks]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd="/", bufsize=1,
            env={**os.environ, FACTOR: str(float(os.environ.get(FACTOR, "1")) * patience)},
        )  # fmt: skip
        self.seen: list[dict[str, Any]] = []
        self._come = threading.Condition()
        assert self.process.stdout is not None
        first = self.process.stdout.readline()
        assert first == "ready\n", first
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._come:
                self.seen.append(json.loads(line))
                self._come.notify_all()

    def wait(self, what: str, after: int = 0, key: str = "") -> dict[str, Any]:
        """The first thing of this kind, and on this key if given, that he sees after as many things."""

        def found() -> dict[str, Any] | None:
            fits = (one for one in self.seen[after:] if one["what"] == what and key in ("", one.get("key")))
            return next(fits, None)

        with self._come:
            assert self._come.wait_for(lambda: found() is not None, patience_s()), (what, self.seen)
        result = found()
        assert result is not None
        return result

    @property
    def was_asked(self) -> bool:
        """Whether a query has come to him."""
        return any(one["what"] == "query" for one in self.seen)

    def ask(self, key: str, payload: bytes) -> dict[str, Any]:
        """Send a query; returns the first answer: ``good`` and ``text``, which is empty without one."""
        before = len(self.seen)
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps([key, payload.hex()]) + "\n")
        self.process.stdin.flush()
        return self.wait("answer", before)

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            self.process.wait(patience_s())
        finally:
            self.process.kill()

    def __enter__(self) -> Intruder:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


def _say(**what: Any) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def _forged(key: str, keys: Keys, genuine: dict[str, bytes]) -> bytes:
    if "/cmd/" in key:
        verb = key.split("/")[3]
        lease = {"holder": "anna", "held_s": 1.0, "left_s": 299.0, "id": "0" * 32}
        text = f"{verb.upper()}: {FORGED}"
        return json.dumps({"accepted": True, "verb": verb, "operator": "anna", "text": text, "lease": lease}).encode()
    found = genuine.get(key)
    if found is not None and key == keys.state:
        return json.dumps(json.loads(found) | {"mode": "RELEASING", "tension_n": 1.0}).encode()
    return found if found is not None else b"{}"


def _genuine(session: zenoh.Session, keys: Keys) -> dict[str, bytes]:
    """The daemon's own answers, whose shape his have."""
    found: dict[str, bytes] = {}
    for key in (keys.state, keys.schema, keys.active):
        for reply in session.get(key, timeout=patience_s()):
            if reply.ok is not None:
                found[key] = bytes(reply.ok.payload)
    return found


def _answer_all(session: zenoh.Session, keys: Keys, genuine: dict[str, bytes]) -> list[Any]:
    """Declare complete queryables, of the rig's keys and of every rig's."""

    def take(query: zenoh.Query) -> None:
        key = str(query.key_expr)
        payload = bytes(query.payload) if query.payload is not None else b""
        with contextlib.suppress(zenoh.ZError):
            query.reply(key, _forged(key, keys, genuine))
        query.drop()  # type: ignore[no-untyped-call]
        _say(what="query", key=key, payload=payload.hex())

    declared = (keys.command("**"), keys.state, keys.schema, keys.active, Keys("*").command("**"), Keys("*").state)
    return [session.declare_queryable(key, take, complete=True) for key in declared]


def _publish(session: zenoh.Session, keys: Keys, state: bytes) -> None:
    """Publish forged states and events for ever."""
    forged = json.loads(state)
    while True:
        forged |= {"mode": "FAULT", "fault": "TENSION_HIGH", "seq": forged["seq"] + 1, "t_ns": time.monotonic_ns()}
        for key in (keys.state, Keys("*").state):
            session.put(key, json.dumps(forged).encode())
        event = {"seq": forged["event_seq"] + 1, "t_ns": forged["t_ns"], "wall_ns": time.time_ns(), "severity": "error"}
        event |= {"source": "loop", "kind": "TRIP", "text": "forged", "stream": forged["stream"]}
        for key in (keys.event("error"), Keys("*").event("error")):
            session.put(key, json.dumps(event).encode())
        time.sleep(0.002)


def _replay(session: zenoh.Session, keys: Keys) -> list[Any]:
    """Publish every state of the daemon again, a while later."""
    kept: list[bytes] = []

    def take(sample: zenoh.Sample) -> None:
        kept.append(bytes(sample.payload))

    def again() -> None:
        while True:
            if len(kept) > 50:
                session.put(keys.state, kept[0])
            time.sleep(0.002)

    threading.Thread(target=again, daemon=True).start()
    return [session.declare_subscriber(keys.state, take)]


def _opened(endpoint: str) -> zenoh.Session:
    """A session; a busy computer may not answer the first time."""
    end = time.monotonic() + patience_s()
    while True:
        try:
            return open_client(endpoint)
        except SessionError:
            if time.monotonic() > end:
                raise


def _take_port(endpoint: str, keys: Keys, genuine: dict[str, bytes], kept: list[Any]) -> None:
    """Wait until the endpoint is free, and be the daemon there."""
    while True:
        try:
            router = open_router([endpoint])
            break
        except SessionError:
            time.sleep(0.005)
    kept += [router, *_answer_all(router, keys, genuine), router.liveliness().declare_token(keys.daemon)]
    _say(what="port")
    _publish(router, keys, genuine[keys.state])


def main(endpoint: str, rig: str, *tasks: str) -> None:
    become_nobody()
    keys, session = Keys(rig), _opened(endpoint)
    genuine = _genuine(session, keys) if {"answers", "publishes", "takes_port"} & {*tasks} else {}
    kept: list[Any] = []
    if "answers" in tasks:
        kept += _answer_all(session, keys, genuine)
    if "publishes" in tasks:
        threading.Thread(target=_publish, args=(session, keys, genuine[keys.state]), daemon=True).start()
    if "takes_port" in tasks:
        threading.Thread(target=_take_port, args=(endpoint, keys, genuine, kept), daemon=True).start()
    if "replays" in tasks:
        kept += _replay(session, keys)
    if "tokens" in tasks:
        kept += [session.liveliness().declare_token(f"rigctl/{name}/live/daemon") for name in ("aaa_rig", "zzz_rig")]
        kept += [session.liveliness().declare_token(f"rigctl/r{number}/live/daemon") for number in range(500)]
    for task in tasks:
        if task.startswith("token="):
            kept.append(session.liveliness().declare_token(Keys(task.removeprefix("token=")).daemon))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for line in sys.stdin:
        key, payload = json.loads(line)
        replies = list(session.get(key, payload=bytes.fromhex(payload), timeout=patience_s()))
        good = any(reply.ok is not None for reply in replies)
        texts = [bytes(reply.ok.payload if reply.ok is not None else reply.err.payload) for reply in replies]  # type: ignore[union-attr]
        _say(what="answer", good=good, text=texts[0].decode(errors="replace") if texts else "")


if __name__ == "__main__":
    main(*sys.argv[1:])
    os._exit(0)  # its threads still send
