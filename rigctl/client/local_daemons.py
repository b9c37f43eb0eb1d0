"""The daemons of this computer, by their run-time folders, and which of them an endpoint and a rig's name mean.

It loads no msgspec: the way of ``rigctl hold`` costs little more than the interpreter's start.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from rigctl.config.address import EVERY_ADDRESS, NETWORK_PROTOCOLS, Address, is_address
from rigctl.ipc.folder_places import ACTIVE, PUBLIC, FolderPlaces, daemon_pid
from rigctl.ipc.trusted_folders import entered_folders

_USUAL = {"localhost", "127.0.0.1", "::1"}  # names of one computer, which the same daemon is reached at


class LocalDaemon(NamedTuple):
    """A daemon of this computer; ``owner``: user of its folder, ``join``: routers that its own one joins."""

    place: FolderPlaces
    owner: int
    rig: str
    listen: str
    join: tuple[str, ...] = ()

    @property
    def runs(self) -> bool:
        """Whether it runs: a daemon that was killed leaves its folder."""
        return daemon_pid(self.place.directory) > 0


def local_daemons(*, of_others: bool = False) -> list[LocalDaemon]:
    """Those whose folder this user believes, or ``of_others``: those whose folder he may only enter."""
    found = []
    for folder, owner in entered_folders(of_others=of_others):
        if (about := next(_described(place := FolderPlaces(folder)), None)) is not None:
            found.append(LocalDaemon(place, owner, *about))
    return found


def _described(place: FolderPlaces) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Rig, endpoint and routers to join: from the settings, or, for who may not read these, from the public file."""
    for name in (ACTIVE, PUBLIC):
        with contextlib.suppress(OSError, ValueError, RecursionError, KeyError, TypeError):
            found = json.loads(place.sealed(name))
            settings = found["settings"] if name == ACTIVE else found
            telemetry = settings["telemetry"] if name == ACTIVE else found
            rig, listen, join = str(settings["rig"]), str(telemetry["listen"]), telemetry.get("join") or ()
            if rig.isidentifier():  # anything else would be printed
                yield rig, listen, tuple(map(str, join))


def same_endpoint(connect: str, listen: str) -> bool:
    """Whether a client that connects to ``connect`` reaches the gateway listening at ``listen`` on this computer."""
    if connect == listen:
        return True
    (protocol, _, to), (listening, _, where) = connect.partition("/"), listen.partition("/")
    if protocol != listening or protocol not in NETWORK_PROTOCOLS or not (is_address(to) and is_address(where)):
        return False
    ours, daemons = Address.parse(to), Address.parse(where)
    return ours.port == daemons.port and ours.host in _USUAL and daemons.host in _USUAL | EVERY_ADDRESS.keys()


def meant(daemons: Sequence[LocalDaemon], endpoint: str, rig: str | None) -> list[LocalDaemon]:
    """Those of this name, if one is given, that listen at ``endpoint``, else those that join the router there."""
    here = [one for one in daemons if rig in (None, one.rig) and same_endpoint(endpoint, one.listen)]
    return here or [
        one for one in daemons if one.rig == rig and any(same_endpoint(endpoint, joined) for joined in one.join)
    ]
