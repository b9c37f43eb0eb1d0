"""A client of the Foxglove WebSocket protocol, written from its description and not from our server."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Self

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from tests.builders.waiting import patience_s


@dataclass
class FoxgloveClient:
    """Connects, subscribes by topic, and decodes what comes by the schemas it was told."""

    port: int
    name: str = "foxglove.websocket.v1"
    origin: str | None = None
    host: str | None = None
    info: dict[str, Any] = field(default_factory=dict)
    channels: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __enter__(self) -> Self:
        self._opened = connect(
            f"ws://{self.host or f'127.0.0.1:{self.port}'}", sock=socket.create_connection(("127.0.0.1", self.port)),
            subprotocols=[Subprotocol(self.name)], origin=self.origin,  # type: ignore[arg-type]
            compression=None, max_size=None, open_timeout=patience_s(),
            close_timeout=0.5,  # messages of data that wait unread keep the answer to the close away
        )  # fmt: skip
        self.socket: ClientConnection = self._opened.__enter__()
        self._subscribed: dict[int, Any] = {}
        self.info = self.told("serverInfo")
        while not {"/records", "/bridge"} <= self.channels.keys():
            self.told("advertise")
        return self

    def __exit__(self, *_error: object) -> None:
        self._opened.__exit__(None, None, None)

    def send(self, **request: Any) -> None:
        self.socket.send(json.dumps(request))

    def told(self, op: str) -> dict[str, Any]:
        """The next text message of this kind; others are skipped."""
        until = time.monotonic() + patience_s()
        while time.monotonic() < until:
            message = self.socket.recv(patience_s())
            if isinstance(message, str) and (found := self._heard(message))["op"] == op:
                return found
        raise AssertionError(f"no {op}")

    def _heard(self, message: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(message)
        if found["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in found["channels"]}
        return found

    def subscribe(self, topic: str, number: int) -> None:
        self.send(op="subscribe", subscriptions=[{"id": number, "channelId": self.channels[topic]["id"]}])
        self._subscribed[number] = self._decoder(topic)

    def _decoder(self, topic: str) -> Any:
        channel = self.channels[topic]
        if channel["encoding"] == "json":
            assert json.loads(channel["schema"])["type"] == "object"
            return json.loads
        files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
        pool = descriptor_pool.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"])).FromString

    def raw(self) -> bytes:
        """The next message of data."""
        until = time.monotonic() + patience_s()
        while time.monotonic() < until:
            found = self.socket.recv(patience_s())
            if isinstance(found, bytes):
                return found
            self._heard(found)
        raise AssertionError("no data")

    def message(self) -> tuple[int, int, Any]:
        """Number of the subscription, wall time in ns and content of the next message of data."""
        found = self.raw()
        opcode, number, wall_ns = struct.unpack_from("<BIQ", found)
        assert opcode == 1
        return number, wall_ns, self._subscribed[number](found[13:])

    def messages(self, count: int) -> list[Any]:
        return [self.message()[2] for _ in range(count)]


@contextlib.contextmanager
def stalled(port: int, channel: int, times: int) -> Iterator[None]:
    """A client that subscribes so many times and reads nothing, on a socket that takes little."""
    with socket.socket() as wire:
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wire.settimeout(patience_s())
        wire.connect(("127.0.0.1", port))
        wire.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n".encode()
        )
        assert wire.recv(12) == b"HTTP/1.1 101"
        subscriptions = [{"id": number, "channelId": channel} for number in range(times)]
        text = json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode()
        wire.sendall(b"\x81\xfe" + len(text).to_bytes(2, "big") + bytes(4) + text)  # masked with zeros
        yield
