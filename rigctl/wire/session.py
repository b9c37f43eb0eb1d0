"""Zenoh sessions with this project's configuration, and their errors in one line."""

from __future__ import annotations

import base64
import errno
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import zenoh

from rigctl.identity.credentials import Credentials

MESSAGE_BYTES = 1 << 16
"""The longest message the daemon accepts: a command has at most 16 KiB, and fragments are collected in memory."""
_RELAYED_BYTES = 1 << 22  # a router that joins others relays their answers: the events held are up to 3 MB
# Who gets which place is decided in `rigctl.gateway.places`. Zenoh knows only one number for all clients, which has to
# be above what can come between two looks of the gateway at its connections.
_SESSIONS_MAX = 2048
_ACCEPTING_MAX = 2048
_HANDSHAKES_MAX = 512  # over TLS, where each that fails has Zenoh wait 100 ms before it takes the next
_LISTEN_MS = 2000
_BATCHES = 16  # of 64 KB per client and priority before DROP drops: bridges 1 s of a busy client at 4 kHz


class SessionError(RuntimeError):
    """A session that could not be opened; ``str()`` is one line."""


class EndpointTakenError(SessionError):
    """Another program has the endpoint."""


def _tls(owned: Credentials | None) -> dict[str, Any]:
    """Mutual certificates for both ends; a link ends when the certificate of the other end does."""
    if owned is None:
        return {}
    key, certificate, authority = (
        base64.b64encode(text.encode()).decode() for text in (owned.key, owned.certificate, owned.authority)
    )
    own = {f"{end}_private_key_base64": key for end in ("listen", "connect")}
    own |= {f"{end}_certificate_base64": certificate for end in ("listen", "connect")}
    return {
        "root_ca_certificate_base64": authority, **own,
        "enable_mtls": True, "verify_name_on_connect": True, "close_link_on_expiration": True,
    }  # fmt: skip


def _config(
    mode: str,
    listen: list[str],
    connect: list[str],
    rx_bytes: int = 0,
    owned: Credentials | None = None,
    access_control: Mapping[str, Any] | None = None,
    zid: str = "",
    *,
    patient: bool = False,
) -> zenoh.Config:
    """``rx_bytes``: the longest message accepted, 0 for Zenoh's own limit. ``patient``: see `open_router`."""
    if patient:
        # Only the first: Zenoh opens an endpoint with this word in a task, so the others would not be there yet.
        listen = [f"{listen[0]}#exit_on_failure=false", *listen[1:]]
    tree: dict[str, Any] = {
        **({"id": zid} if zid else {}),
        "mode": mode,
        "listen": {
            "endpoints": listen,
            "timeout_ms": _LISTEN_MS if patient else 0,  # of the others; with 0 the first is tried once
            "exit_on_failure": True,
            "retry": {"period_init_ms": 500, "period_max_ms": 1000, "period_increase_factor": 1.5},
        },
        "connect": {
            "endpoints": connect,
            # A router joins others whenever they appear; a client without its router is of no use and fails at once.
            "timeout_ms": 0 if mode == "client" else -1,
            "exit_on_failure": mode == "client",
            # A killed gateway is back within a second, so clients retry often.
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
        },
        "scouting": {"delay": 0, "multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "shared_memory": {"enabled": False},  # loses messages over 3 KB without an error
            "unicast": {
                "open_timeout": 1500,
                "accept_timeout": 1500,
                "accept_pending": _ACCEPTING_MAX if owned is None else _HANDSHAKES_MAX,
                "max_sessions": _SESSIONS_MAX,
            },
            "link": {
                "tls": _tls(owned),
                **({"rx": {"max_message_size": rx_bytes}} if rx_bytes else {}),
                "tx": {
                    "queue": {
                        "size": {"data_high": _BATCHES, "data": _BATCHES, "data_low": _BATCHES},
                        "congestion_control": {
                            "drop": {"wait_before_drop": 0},
                            # An answer blocks if the querier chose so; one that does not read is cut off (time in us).
                            "block": {"wait_before_close": 200_000},
                        },
                    },
                },
            },
        },
        **({"access_control": access_control} if access_control is not None else {}),
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
    """Finish a query: the querier learns that no more answers come. (zenoh's stub leaves this untyped.)"""
    query.drop()  # type: ignore[no-untyped-call]


def open_router(
    listen: list[str],
    join: Sequence[str] = (),
    owned: Credentials | None = None,
    access_control: Mapping[str, Any] | None = None,
    *,
    patient: bool = False,
) -> zenoh.Session:
    """The gateway's session: clients connect to it, and it relays between them.

    ``join``: other routers to form one network with; the connection is retried for ever. ``owned``: the gateway's key,
    for endpoints ``tls/``. ``access_control``: see `rigctl.wire.access_control`; None: everyone may do everything, as
    in a test's network. ``patient``: the first endpoint is tried until it is free, should another program have it.

    Raises:
        EndpointTakenError: another program has the first endpoint.
        SessionError: the endpoint cannot be opened; the message names it and the reason.
    """
    try:
        longest = _RELAYED_BYTES if join else MESSAGE_BYTES
        return zenoh.open(_config("router", listen, list(join), longest, owned, access_control, patient=patient))
    except zenoh.ZError as error:
        kind = EndpointTakenError if f"(os error {errno.EADDRINUSE})" in str(error) else SessionError
        raise kind(f"cannot listen on {listen[0]}: {_reason(error)}") from None


def open_client(endpoint: str, owned: Credentials | None = None, zid: str = "") -> zenoh.Session:
    """A client session of the router at ``endpoint``; once open it reconnects by itself.

    ``owned``: the key of who connects, for an endpoint ``tls/``. ``zid``: Zenoh's id of the session, else a random one.

    Raises:
        SessionError: no router answers, or ``endpoint`` is not valid.
    """
    try:
        return zenoh.open(_config("client", [], [endpoint], owned=owned, zid=zid))
    except zenoh.ZError as error:
        raise SessionError(f"cannot connect to {endpoint}: {_reason(error)}") from None
