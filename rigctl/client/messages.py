"""JSON messages as they arrive: states, configurations. A missed message is not queried."""

from __future__ import annotations

from collections.abc import Callable

from rigctl.client.mailbox import Mailbox
from rigctl.client.shapes import Message, MessageRefusedError, active, event, message, state
from rigctl.wire.keys import Keys

Decode = Callable[[bytes], Message]


def shape_of(keys: Keys, key: str) -> Decode:
    """The function that decodes and checks messages of a key."""
    return {keys.state: state, keys.active: active, keys.event("*"): event}.get(key, message)


class MessageSource:
    """Every message that arrived, oldest first; see `rigctl.client.stream_source.StreamSource`."""

    def __init__(self, mailbox: Mailbox, decode: Decode) -> None:
        self.mailbox, self._decode = mailbox, decode

    def poll(self) -> Message | None:
        """The next message, or None."""
        while (payload := self.mailbox.take()) is not None:
            try:
                return self._decode(payload)
            except MessageRefusedError as error:
                self.mailbox.refuse(error)
        return None

    def answer(self, _payload: bytes | None) -> None:
        """Unused: this source asks no question."""
