"""Keeps the places of the router's connections: looks at them, closes what `rigctl.gateway.places` names, notes it."""

from __future__ import annotations

import contextlib
import grp
import os
import pwd

import zenoh

from rigctl.gateway.accepted_sockets import AcceptedSockets, user
from rigctl.gateway.places import Connection, Rules, closed
from rigctl.gateway.refused_access import RefusedAccess
from rigctl.ipc.notes import Note


class KeptPlaces:
    """The places of one router."""

    def __init__(self, session: zenoh.Session, endpoints: list[str], rules: Rules) -> None:
        self._session, self._sockets, self._rules = session, AcceptedSockets(endpoints), rules

    @property
    def listens(self) -> bool:
        """Whether the router had its endpoint of the network when `keep` last looked."""
        return self._sockets.listens

    def keep(self, found: RefusedAccess, now_ns: int) -> None:
        """Close what has to be, one note for each kind and identity; call it every period."""
        now_s = now_ns * 1e-9
        try:
            connections = self._sockets.read(self._session.info, now_s)
        except OSError as error:  # the next period looks again
            found.add(Note.CONNECTION_CLOSED, "unseen", ("", "nobody", f"not looked at: {error.strerror}"), now_ns)
            return
        if self._rules.known is not None:
            # A handshake that is cut off has Zenoh's TLS listener wait 100 ms: it ends those that are late by itself.
            connections = [one for one in connections if one.identity is not None]
        for one, why in closed(connections, self._rules, now_s):
            self._sockets.close(one)
            who = f"{_shown(one)} at {one.source}" if _shown(one) != one.source else one.source
            name = (one.identity or "").rpartition(".")[0] if self._rules.known is not None else ""
            found.add(Note.CONNECTION_CLOSED, f"{why.name} of {_shown(one)}", (name, who, why.value), now_ns)


def _shown(one: Connection) -> str:
    if one.identity is None:
        return one.source
    return f"certificate {one.identity}" if "." in one.identity and one.identity != one.source else one.identity


def local_users(*groups: str) -> frozenset[str]:
    """Users of this computer who may open the router's socket as members of ``groups``, root and this user."""
    uids = {0, os.geteuid()}
    for group in groups:
        with contextlib.suppress(KeyError):  # no such group, or a member without an account
            uids |= {pwd.getpwnam(name).pw_uid for name in grp.getgrnam(group).gr_mem}
    return frozenset(map(user, uids))
