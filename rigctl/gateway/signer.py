"""Signs what the gateway answers and publishes, so that no other session of the network can pass for it."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import msgspec
import zenoh
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from rigctl.wire.proof import Attachment, answer_signature, attachment_of, message_seal, sealed
from rigctl.wire.session import finish

_JSON = zenoh.Encoding.APPLICATION_JSON


def query_attachment(query: zenoh.Query) -> Attachment | None:
    """The attachment of a query, if it is one of a client's."""
    return attachment_of(bytes(query.attachment)) if query.attachment is not None else None


class Signer:
    """Answers queries and publishes under the key of the run; every method may be called from any thread."""

    def __init__(self, private: Ed25519PrivateKey) -> None:
        self._private = private

    def reply(self, query: zenoh.Query, key: str, payload: bytes, encoding: zenoh.Encoding | None = None) -> None:
        """Answer a query; the signature is the answer's attachment.

        Raises:
            zenoh.ZError: the querier has gone.
        """
        given = query_attachment(query)
        attachment = answer_signature(self._private, given.nonce, key, payload, good=True) if given else None
        query.reply(key, payload, encoding=encoding, attachment=attachment)

    def reply_error(self, query: zenoh.Query, message: dict[str, Any], *, signed: bool = True) -> None:
        """Refuse a query; the signature is the first value of the message.

        Raises:
            zenoh.ZError: the querier has gone.
        """
        payload, given = msgspec.json.encode(message), query_attachment(query) if signed else None
        if given is not None:
            signature = answer_signature(self._private, given.nonce, str(query.key_expr), payload, good=False)
            payload = sealed(payload, signature)
        query.reply_err(payload, encoding=_JSON)

    def answer_command(self, query: zenoh.Query, message: dict[str, Any], *, signed: bool = True) -> None:
        """Answer a command and finish it; a querier that has disconnected is no error. ``signed``: also a refusal."""
        with contextlib.suppress(zenoh.ZError):
            if message["accepted"]:
                self.reply(query, str(query.key_expr), msgspec.json.encode(message), _JSON)
            else:
                self.reply_error(query, message, signed=signed)
        finish(query)

    def publish(self, publisher: zenoh.Publisher, payload: bytes) -> None:
        """Publish; the signature is the message's attachment."""
        key = str(publisher.key_expr)
        publisher.put(payload, attachment=message_seal(self._private, time.monotonic_ns(), key, payload))
