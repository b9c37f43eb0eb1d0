"""Messages on the gateway's command socket: a length of four bytes, big-endian, then so many bytes: a line of JSON that
says what the message is, and its payload.

A question names what it is for by the end of its key, ``cmd/arm`` or ``tele/state``; its payload and the answer's are
those of the Zenoh query on that key. An answer has the question's number. One with number 0 answers no question: the
gateway ends the connection with it. Pure functions of bytes and values.
"""

from __future__ import annotations

import struct
from typing import TypeVar

import msgspec

from rigctl.config.built_type import built
from rigctl.config.one_line import on_one_line
from rigctl.wire.session import MESSAGE_BYTES

COMMAND, STATE = "cmd/", "tele/state"
LONGEST_QUESTION = MESSAGE_BYTES + 1024
LONGEST_ANSWER = 1 << 20
_LENGTH = struct.Struct(">I")


class SocketMessageError(ValueError):
    """Bytes that are no message; ``str()`` is one line."""


@built
class SocketQuestion(msgspec.Struct, forbid_unknown_fields=True):
    """``key``: end of the key; ``follow``: an empty answer, and each state from now on in a further one."""

    number: int
    key: str
    follow: bool = False


@built
class SocketAnswer(msgspec.Struct):
    """``good``: answered, else refused. ``again``: with number 0, a question that was sent meanwhile was not taken."""

    number: int
    good: bool
    again: bool = False


def packed(message: SocketQuestion | SocketAnswer, payload: bytes = b"") -> bytes:
    """The bytes of a message."""
    head = msgspec.json.encode(message)
    return b"".join((_LENGTH.pack(len(head) + 1 + len(payload)), head, b"\n", payload))


_Some = TypeVar("_Some", SocketQuestion, SocketAnswer)


def unpacked(data: bytes, kind: type[_Some]) -> tuple[_Some, bytes]:
    """A message and its payload, from its bytes without the length.

    Raises:
        SocketMessageError: it is none.
    """
    head, _, payload = data.partition(b"\n")
    try:
        return msgspec.json.decode(head, type=kind), payload
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise SocketMessageError(on_one_line(str(error))) from None


class Splitter:
    """Bytes as they arrive to whole messages; at most ``longest`` bytes and one receive are kept."""

    def __init__(self, longest: int) -> None:
        self._longest, self._held = longest, bytearray()

    def feed(self, data: bytes) -> None:
        """Take bytes."""
        self._held += data

    def take(self) -> bytes | None:
        """The next message without its length, None until it is whole.

        Raises:
            SocketMessageError: it is longer than allowed.
        """
        if len(self._held) < _LENGTH.size:
            return None
        (size,) = _LENGTH.unpack_from(self._held)
        if size > self._longest:
            raise SocketMessageError(f"found a message of {size} bytes, expected at most {self._longest}")
        end = _LENGTH.size + size
        if len(self._held) < end:
            return None
        found = bytes(self._held[_LENGTH.size : end])
        del self._held[:end]
        return found
