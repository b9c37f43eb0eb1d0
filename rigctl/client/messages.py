"""JSON messages as they arrive: states, configurations. A missed message is not queried."""

from __future__ import annotations

import time
from collections.abc import Callable

import zenoh

from rigctl.client.mailbox import Mailbox
from rigctl.client.shapes import LONGEST_DOCUMENT, Message, MessageRefusedError, Refusals, active, event, message, state
from rigctl.wire.keys import Keys

Decode = Callable[[bytes], Message]


def shape_of(keys: Keys, key: str) -> Decode:
    """The function that decodes and checks messages of a key."""
    return {keys.state: state, keys.active: active, keys.event("*"): event}.get(key, message)


class MessageSource:
    """Every message that arrived, oldest first; see `rigctl.client.source.Source`."""

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


class Feed:
    """Messages of a subscription, taken one by one."""

    def __init__(self, session: zenoh.Session, key: str, depth: int, refusals: Refusals, decode: Decode) -> None:
        self._mailbox = Mailbox(session, key, depth, refusals, LONGEST_DOCUMENT)
        self._source = MessageSource(self._mailbox, decode)

    def take(self) -> Message | None:
        """The next message that has arrived, or None."""
        return self._source.poll()

    def newest(self) -> Message | None:
        """The last message that has arrived, or None; those before it are skipped."""
        last = None
        while (message := self.take()) is not None:
            last = message
        return last

    def wait(self, timeout_s: float) -> Message | None:
        """The next message, or None after ``timeout_s``."""
        until = time.monotonic() + timeout_s
        while (message := self.take()) is None:
            left_s = until - time.monotonic()
            if left_s <= 0:
                return None
            self._mailbox.wait(left_s)
        return message
