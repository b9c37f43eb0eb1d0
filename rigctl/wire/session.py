"""Zenoh sessions as this project opens them, and their errors in one line."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

import zenoh

MESSAGE_BYTES = 1 << 16
"""The longest message the daemon takes: a command has 16 KiB at most, and what comes in fragments is held in memory."""
_RELAYED_BYTES = 1 << 22  # a router that joins others relays their answers: the events still held are up to 3 MB
_SESSIONS_MAX = 128  # a control room has ten; each costs the gateway 50 states and blocks a second
# Connections that are half open: each is closed after accept_timeout and costs a few KiB until then, and among a flood
# of them one that opens as it should must still find a place.
_ACCEPTING_MAX = 512
_BATCHES = 16  # of 64 KB per client and priority before DROP drops: rides out 1 s of a busy client at 4 kHz


class SessionError(RuntimeError):
    """A session that could not be opened; ``str()`` is one line."""


def _config(mode: str, listen: list[str], connect: list[str], rx_bytes: int = 0) -> zenoh.Config:
    """``rx_bytes``: the longest message that is taken in, 0 for Zenoh's own limit."""
    tree: dict[str, Any] = {
        "mode": mode,
        "listen": {"endpoints": listen, "timeout_ms": 0, "exit_on_failure": True},
        "connect": {
            "endpoints": connect,
            # A router joins others when they are there; a client without its router is no client.
            "timeout_ms": 0 if mode == "client" else -1,
            "exit_on_failure": mode == "client",
            # A killed gateway is back within a second: look for it often.
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
        },
        "scouting": {"delay": 0, "multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "shared_memory": {"enabled": False},  # loses messages over 3 KB without a word
            "unicast": {
                "open_timeout": 1500,
                "accept_timeout": 1500,
                "accept_pending": _ACCEPTING_MAX,
                "max_sessions": _SESSIONS_MAX,
            },
            "link": {
                **({"rx": {"max_message_size": rx_bytes}} if rx_bytes else {}),
                "tx": {
                    "queue": {
                        "size": {"data_high": _BATCHES, "data": _BATCHES, "data_low": _BATCHES},
                        "congestion_control": {
                            "drop": {"wait_before_drop": 0},
                            # An answer blocks if the asker chose so: one who does not read is cut off (microseconds).
                            "block": {"wait_before_close": 200_000},
                        },
                    },
                },
            },
        },
    }
    return zenoh.Config.from_json5(json.dumps(tree))


def _reason(error: Exception) -> str:
    """Zenoh's message without its source locations."""
    text = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error))
    inner = re.search(r"\[\S+: (.*?) \(os error \d+\)", text)
    return (inner.group(1) if inner else text.splitlines()[0]).strip(" .")


def close(session: zenoh.Session) -> None:
    """End a session. (zenoh's stub leaves this untyped.)"""
    session.close()  # type: ignore[no-untyped-call]


def finish(query: zenoh.Query) -> None:
    """Tell the asker that no more answers come. (zenoh's stub leaves this untyped.)"""
    query.drop()  # type: ignore[no-untyped-call]


def open_router(listen: list[str], join: Sequence[str] = ()) -> zenoh.Session:
    """The gateway's session: clients connect here and are relayed.

    ``join``: other routers to be one network with, tried again for ever while they are not there.

    Raises:
        SessionError: naming the endpoint and why.
    """
    try:
        return zenoh.open(_config("router", listen, list(join), _RELAYED_BYTES if join else MESSAGE_BYTES))
    except zenoh.ZError as error:
        raise SessionError(f"cannot listen on {listen[0]}: {_reason(error)}") from None


def open_client(endpoint: str) -> zenoh.Session:
    """A client of the router at ``endpoint``; once open it reconnects by itself.

    Raises:
        SessionError: nobody there, or not an endpoint.
    """
    try:
        return zenoh.open(_config("client", [], [endpoint]))
    except zenoh.ZError as error:
        raise SessionError(f"cannot connect to {endpoint}: {_reason(error)}") from None
