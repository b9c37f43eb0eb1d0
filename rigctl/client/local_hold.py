"""HOLD to a daemon of this computer that this user may command, without the network: see `rigctl.hold.service`."""

from __future__ import annotations

import contextlib
import pathlib
import socket
from typing import Any

import msgspec

from rigctl.config.address import EVERY_ADDRESS, NETWORK_PROTOCOLS, Address, is_address
from rigctl.ipc.folder_files import ACTIVE, FolderFiles, daemon_pid
from rigctl.ipc.trusted_folders import trusted_folders
from rigctl.wire.run_keys import PUBLIC_KEY

CONNECT_S = 0.5
ANSWER_S = 2.5  # the service answers within 1.5 s, even when the loop does not reply
_ANSWER_BYTES = 1 << 16
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


def socket_of(endpoint: str, rig: str | None) -> pathlib.Path | None:
    """Hold socket of the daemon of this computer that listens at ``endpoint``, named ``rig`` if given.

    Only a daemon whose folder this user may believe is found (`rigctl.ipc.trusted_folders`).

    None for a daemon elsewhere, so that a HOLD meant for it never reaches another daemon here.
    """
    for folder in trusted_folders():
        if not daemon_pid(folder):
            continue
        with contextlib.suppress(OSError, msgspec.MsgspecError, RecursionError, KeyError, TypeError):
            found = FolderFiles(folder)
            if rig not in (None, folder.name.removeprefix("rigctl-")):
                continue
            if same_endpoint(endpoint, _listen(found)):
                return found.hold_socket
    return None


def _listen(folder: FolderFiles) -> str:
    """The daemon's endpoint: from its settings, or, for operators of the installed service, from its public key."""
    with contextlib.suppress(OSError, msgspec.MsgspecError):
        if active := folder.read_json(ACTIVE):
            return str(active["settings"]["telemetry"]["listen"])
    return str(folder.read_json(PUBLIC_KEY)["listen"])


def hold(endpoint: str, rig: str | None, operator: str) -> dict[str, Any] | None:
    """Give HOLD on the local socket; returns the answer, or None without one: then give it over the network.

    A second HOLD does no harm if the first was carried out without an answer.
    """
    path = socket_of(endpoint, rig)
    if path is None:
        return None
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(CONNECT_S)
            connection.connect(str(path))
            connection.send(msgspec.json.encode({"operator": operator}))
            connection.settimeout(ANSWER_S)
            found = msgspec.json.decode(connection.recv(_ANSWER_BYTES))
    except (OSError, msgspec.MsgspecError):
        return None
    return found if isinstance(found, dict) and {"accepted", "text"} <= found.keys() else None
