"""Answers of the gateway to queries; every function may be called from any thread."""

from __future__ import annotations

import contextlib
from typing import Any

import msgspec
import zenoh

from rigctl.wire.session import finish

_JSON = zenoh.Encoding.APPLICATION_JSON


def refuse(query: zenoh.Query, message: dict[str, Any]) -> None:
    """Answer a query with an error reply.

    Raises:
        zenoh.ZError: the querier has gone.
    """
    query.reply_err(msgspec.json.encode(message), encoding=_JSON)


def answer_command(query: zenoh.Query, message: dict[str, Any]) -> None:
    """Answer a command and finish it; a querier that has disconnected is no error."""
    with contextlib.suppress(zenoh.ZError):
        if message["accepted"]:
            query.reply(str(query.key_expr), msgspec.json.encode(message), encoding=_JSON)
        else:
            refuse(query, message)
    finish(query)
