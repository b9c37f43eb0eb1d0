"""Invalid messages by kind, and a session that sends them: on every key of a rig, and as its answers."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from typing import Any

import zenoh

from rigctl.wire import block
from rigctl.wire.keys import Keys
from rigctl.wire.session import close, finish, open_client

ESCAPES = "\x1b]0;owned\x07\x1b[2J\x1b[31mOWNED\x9b2J\r\n\u202eDENWO"
NOT_JSON: dict[str, bytes] = {
    "nothing": b"",
    "100 kB of [": b"[" * 100_000,
    "deep objects": b'{"a":' * 20_000,
    "deep, closed": b"[" * 500 + b"]" * 500,
    "no text": b"\xff\xfe\x00\x80" * 100,
    "cut off": b'{"mode": "HO',
    "bare escapes": ESCAPES.encode(),
    "null": b"null",
    "a number": b"1e400",
    "a list": b"[1, 2, 3]",
    "an empty object": b"{}",
    "half a surrogate": b'{"mode": "\\ud800"}',
    "a long number": b'{"mode": ' + b"9" * 5000 + b"}",
    "1 MB of text": b'{"mode": "' + b"x" * 1_000_000 + b'"}',
}
WRONG: tuple[Any, ...] = (
    None, True, -1, 10**30, -1e308, 1e308, "", ESCAPES, "x" * 10_000, [], [[]], [None], {}, {"a": None},
    {"holder": ESCAPES, "held_s": 1e300, "left_s": -1e300}, [ESCAPES] * 10_000,
)  # fmt: skip
"""Replacements for a valid value."""


def wronged(message: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """A valid message with one value missing or replaced, for each value at any depth: place and message."""
    for path in _paths(message, ()):
        where = ".".join(map(str, path))
        yield f"{where} missing", _changed(message, path, None, drop=True)
        for wrong in WRONG:
            yield f"{where} = {str(wrong)[:20]!r}", _changed(message, path, wrong)


def _paths(value: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in pairs:
        yield from _paths(item, (*path, key))


def _changed(value: Any, path: tuple[Any, ...], wrong: Any, *, drop: bool = False) -> Any:
    made = dict(value) if isinstance(value, dict) else list(value)
    if len(path) > 1:
        made[path[0]] = _changed(made[path[0]], path[1:], wrong, drop=drop)
    elif drop:
        del made[path[0]]
    else:
        made[path[0]] = wrong
    return made


def blocks(record_size: int, stream: int) -> dict[str, bytes]:
    """Invalid blocks of the fast stream."""
    head = block.HEADER.pack
    return {
        "not a block": b"RGF1" * 30,
        "no room for its records": head(b"RGF1", 1, 48, record_size, 2**31, 1, 0, stream, 1),
        "records of nothing": head(b"RGF1", 1, 48, 0, 2**32 - 1, 1, 0, stream, 1),
        "from the end of numbers": block.encode(
            bytes(record_size), record_size, first_seq=2**64 - 1, lost=0, stream=stream, head_seq=2**64 - 1
        ),
        "from a far future": block.encode(
            bytes(record_size), record_size, first_seq=2**60, lost=0, stream=stream, head_seq=2**60
        ),
        "of another daemon": block.encode(
            b"\xff" * record_size, record_size, first_seq=1, lost=0, stream=stream + 1, head_seq=1
        ),
        "records of one byte": block.encode(bytes(900), 1, first_seq=5, lost=0, stream=stream, head_seq=905),
    }


def schemas(schema: dict[str, Any]) -> dict[str, bytes]:
    """Schemas that a client must refuse."""
    record = schema["fast"]["record"]

    def changed(**values: Any) -> bytes:
        fields = [{**record["fields"][0], **values}, *record["fields"][1:]]
        return json.dumps({**schema, "fast": {"record": {**record, "fields": fields}}}).encode()

    def whole(**values: Any) -> bytes:
        return json.dumps({**schema, "fast": {"record": {**record, **values}}}).encode()

    return {
        "objects": changed(type="O"),
        "objects in a struct": changed(type="u4,O"),
        "a type of 2 GB": changed(type="S2147483647", size=2147483647),
        "a shape of 2 GB": changed(shape=[2**20, 2**20]),
        "a negative shape": changed(shape=[-1]),
        "a negative offset": changed(offset=-8),
        "beyond the record": changed(offset=16_000),
        "a record of 1 GB": whole(size=2**30),
        "a record of no size": whole(size=-1),
        "two of a name": changed(name="tick"),
        "escapes for a name": changed(name=ESCAPES),
        "no fields": whole(fields=[]),
        "a million fields": whole(fields=[{"name": "a"}] * 20_000),
        "words for fields": whole(fields="fields"),
        "another version": json.dumps({**schema, "version": 99}).encode(),
        **{name: payload for name, payload in NOT_JSON.items() if name != "nothing"},
    }


class Hostile:
    """A session that publishes and answers what no daemon does."""

    def __init__(self, endpoint: str, rig: str) -> None:
        self.keys = Keys(rig)
        self._session = open_client(endpoint)
        self._declared: list[Any] = []

    def put(self, key: str, payload: bytes) -> None:
        """Publish; the message is not dropped where the link is busy."""
        self._session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)

    def answer(self, key: str, payloads: list[bytes]) -> None:
        """Answer every query on a key with these payloads and as many error replies; claim to know all."""

        def take(query: zenoh.Query) -> None:
            with contextlib.suppress(zenoh.ZError):
                for payload in payloads:
                    query.reply(key, payload)
                    query.reply_err(payload)
            finish(query)

        self._declared.append(self._session.declare_queryable(key, take, complete=True))

    def appear(self, name: str) -> None:
        """Appear as the daemon of a rig of that name."""
        self._declared.append(self._session.liveliness().declare_token(f"rigctl/{name}/live/daemon"))

    def close(self) -> None:
        close(self._session)


@contextlib.contextmanager
def hostile(endpoint: str, rig: str) -> Iterator[Hostile]:
    found = Hostile(endpoint, rig)
    try:
        yield found
    finally:
        found.close()
