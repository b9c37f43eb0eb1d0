"""HOLD to a daemon of this computer whose folder this user may believe, without the network."""

from __future__ import annotations

import contextlib
import json
import math
import os
import socket
from typing import Any

from rigctl.config.address import EVERY_ADDRESS, NETWORK_PROTOCOLS, Address, is_address
from rigctl.ipc import hold_socket
from rigctl.ipc.folder_places import ACTIVE, FORMER_PUBLIC, PUBLIC, FolderPlaces, daemon_pid
from rigctl.ipc.trusted_folders import trusted_folders

ANSWER_S = 1.5  # the loop answers in the tick that takes it; longer is for a busy computer
VIA = "local socket"
FORMER = "hold.sock"
FORMER_CONNECT_S = 0.5
FORMER_LATER_S = 1.0  # that service answers within 1.5 s, even when the loop does not reply
_FORMER_BYTES = 1 << 16
_USUAL = {"localhost", "127.0.0.1", "::1"}  # names of one computer, which the same daemon is reached at


def same_endpoint(connect: str, listen: str) -> bool:
    """Whether a client that connects to ``connect`` reaches the gateway listening at ``listen`` on this computer."""
    if connect == listen:
        return True
    (protocol, _, to), (listening, _, where) = connect.partition("/"), listen.partition("/")
    if protocol != listening or protocol not in NETWORK_PROTOCOLS or not (is_address(to) and is_address(where)):
        return False
    ours, daemons = Address.parse(to), Address.parse(where)
    return ours.port == daemons.port and ours.host in _USUAL and daemons.host in _USUAL | EVERY_ADDRESS.keys()


def folder_of(endpoint: str, rig: str | None) -> FolderPlaces | None:
    """Run-time folder of the daemon of this computer that listens at ``endpoint``, named ``rig`` if given.

    Only a daemon whose folder this user may believe is found (`rigctl.ipc.trusted_folders`).

    None for a daemon elsewhere, so that a HOLD meant for it never reaches another daemon here.
    """
    for folder in trusted_folders():
        if not daemon_pid(folder):
            continue
        with contextlib.suppress(OSError, ValueError, RecursionError, KeyError, TypeError):
            found = FolderPlaces(folder)
            if rig not in (None, folder.name.removeprefix("rigctl-")):
                continue
            if same_endpoint(endpoint, _listen(found)):
                return found
    return None


def _listen(folder: FolderPlaces) -> str:
    """The daemon's endpoint: from its settings, or, for operators of the installed service, from its public file."""
    with contextlib.suppress(OSError, ValueError):
        return str(json.loads(folder.sealed(ACTIVE))["settings"]["telemetry"]["listen"])
    with contextlib.suppress(OSError, ValueError):
        return str(json.loads(folder.sealed(PUBLIC))["listen"])
    return str(json.loads(folder.sealed(FORMER_PUBLIC))["listen"])


def hold(endpoint: str, rig: str | None, operator: str, answer_s: float = ANSWER_S) -> dict[str, Any] | None:
    """Give HOLD on a local socket; returns the answer, or None without one: then give it over the network.

    A second HOLD does no harm if the first was carried out without an answer. ``answer_s``: limit for the loop's.
    """
    if (folder := folder_of(endpoint, rig)) is None:
        return None
    for uid in (os.geteuid(), None):
        with contextlib.suppress(OSError):  # this user has no socket of his own, or the loop is just being replaced
            given = hold_socket.give(folder.place(hold_socket.socket_name(uid)), operator, answer_s)
            return None if given is None else _worded(given, operator)
    return _former(folder, operator, answer_s + FORMER_LATER_S)


def _worded(given: hold_socket.HoldAnswer, operator: str) -> dict[str, Any]:
    """The answer as the gateway gives it."""
    value = given.tension_n if math.isfinite(given.tension_n) else None
    about = {"mode": given.mode, "t_ns": given.t_ns, "value": value, "via": VIA}
    if given.accepted:
        done = hold_socket.HELD.format(stroke=f"{given.stroke_mm:z.2f} mm", tension=f"{given.tension_n:z.1f} N")
        return {"accepted": True, "verb": "hold", "operator": operator, "text": f"HOLD: {done}", **about}
    from rigctl.wire.command_request import hold_refused  # slow: a refusal has time

    return hold_refused(given, operator) | about


def _former(folder: FolderPlaces, operator: str, answer_s: float) -> dict[str, Any] | None:
    """HOLD to a daemon of the version before, which may be armed while the package is upgraded: by its hold service."""
    place = folder.directory / "hold" / FORMER if folder.is_shared else folder.directory / FORMER
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(FORMER_CONNECT_S)
            connection.connect(str(place))
            connection.send(json.dumps({"operator": operator}).encode())
            connection.settimeout(answer_s)
            found = json.loads(connection.recv(_FORMER_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and {"accepted", "text"} <= found.keys() else None
