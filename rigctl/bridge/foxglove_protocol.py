"""The Foxglove WebSocket protocol: messages of the server, and requests of its clients. Bytes in, values out.

Lichtblick and older Foxglove ask for ``foxglove.websocket.v1``, Foxglove's own library for ``foxglove.sdk.v1``; what is
said under either name is the same (github.com/foxglove/ws-protocol, "spec.md").
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
CAPABILITIES = ("parameters", "parametersSubscribe")
INFO, WARNING, ERROR = 0, 1, 2
"""Levels of a status message."""
_MESSAGE = struct.Struct("<BIQ")
_MESSAGE_DATA = 1
_NAMES = 4096

_Number = Annotated[int, Meta(ge=0, le=2**32 - 1)]
_Id = Annotated[str, Meta(max_length=256)]
_Names = Annotated[list[Annotated[str, Meta(max_length=256)]], Meta(max_length=_NAMES)]

Parameters = Mapping[str, Any]
"""Values by name: numbers, texts, booleans and lists of them."""


class RequestRefusedError(ValueError):
    """A request that cannot be read, or that this server does not answer; ``str()`` is one line for the client."""


@dataclass(frozen=True)
class Channel:
    """A topic on offer. ``schema`` is text for JSON, base64 of a ``FileDescriptorSet`` for protobuf."""

    id: int
    topic: str
    encoding: str
    schema_name: str
    schema: str
    schema_encoding: str


class Subscription(msgspec.Struct):
    """A client's number for a channel."""

    id: _Number
    channel: Annotated[_Number, Meta()] = msgspec.field(name="channelId")


class Subscribe(msgspec.Struct, tag_field="op", tag="subscribe"):
    """Send these channels from now on."""

    subscriptions: Annotated[list[Subscription], Meta(max_length=_NAMES)]


class Unsubscribe(msgspec.Struct, tag_field="op", tag="unsubscribe"):
    """Send these no more."""

    ids: Annotated[list[_Number], Meta(max_length=_NAMES)] = msgspec.field(name="subscriptionIds")


class GetParameters(msgspec.Struct, tag_field="op", tag="getParameters"):
    """Send the values; no names: of all."""

    names: _Names = msgspec.field(name="parameterNames")
    id: _Id | None = None


class SetParameters(msgspec.Struct, tag_field="op", tag="setParameters"):
    """Change values, which the rig refuses."""

    parameters: Annotated[list[Any], Meta(max_length=_NAMES)]
    id: _Id | None = None


class SubscribeParameters(msgspec.Struct, tag_field="op", tag="subscribeParameterUpdates"):
    """Send the values whenever they change; no names: of all."""

    names: _Names = msgspec.field(name="parameterNames")


class UnsubscribeParameters(msgspec.Struct, tag_field="op", tag="unsubscribeParameterUpdates"):
    """Send them no more; no names: none."""

    names: _Names = msgspec.field(name="parameterNames")


Request = Subscribe | Unsubscribe | GetParameters | SetParameters | SubscribeParameters | UnsubscribeParameters
_requests: msgspec.json.Decoder[Request] = msgspec.json.Decoder(Request)


def request_of(message: str | bytes) -> Request:
    """A client's request.

    Raises:
        RequestRefusedError: it is none that this server answers.
    """
    if isinstance(message, bytes):
        raise RequestRefusedError("found a message of data, expected none: this server takes no data from clients")
    try:
        return _requests.decode(message)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise RequestRefusedError(f"not understood: {' '.join(str(error).split())}") from None


def server_info(name: str, session: str) -> str:
    """What a client is told first; ``session`` changes when the bridge was started anew."""
    return _text(op="serverInfo", name=name, capabilities=CAPABILITIES, supportedEncodings=[], metadata={},
                 sessionId=session)  # fmt: skip


def advertise(channels: Iterable[Channel]) -> str:
    """Channels on offer."""
    return _text(op="advertise", channels=[
        {"id": one.id, "topic": one.topic, "encoding": one.encoding, "schemaName": one.schema_name,
         "schema": one.schema, "schemaEncoding": one.schema_encoding} for one in channels
    ])  # fmt: skip


def unadvertise(ids: Sequence[int]) -> str:
    """Channels that are no longer on offer."""
    return _text(op="unadvertise", channelIds=ids)


def parameter_values(values: Parameters, request: str | None = None) -> str:
    """Values of parameters, as an answer to ``request`` or by themselves."""
    answer: dict[str, Literal["parameterValues"] | str | list[Any]] = {"op": "parameterValues"}
    answer["parameters"] = [_parameter(name, value) for name, value in values.items()]
    return _text(**answer, **({} if request is None else {"id": request}))


def _parameter(name: str, value: Any) -> dict[str, Any]:
    """A value with its type where JSON does not say it: a whole number that is a float."""
    kind = {}
    if isinstance(value, float):
        kind = {"type": "float64"}
    elif isinstance(value, list) and value and all(isinstance(one, float) for one in value):
        kind = {"type": "float64_array"}
    return {"name": name, "value": value, **kind}


def status(level: int, text: str) -> str:
    """A line for the person at the client."""
    return _text(op="status", level=level, message=text)


def message_data(subscription: int, wall_ns: int, payload: bytes) -> bytes:
    """One message of a channel, under the client's number."""
    return _MESSAGE.pack(_MESSAGE_DATA, subscription, wall_ns) + payload


def _text(**message: Any) -> str:
    return msgspec.json.encode(message).decode()
