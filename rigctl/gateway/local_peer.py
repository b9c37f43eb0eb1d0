"""Who is at the other end of a Unix stream socket, and whether he is admitted: as the kernel says.

The groups are those of his process, not of the user database: to look them up there may wait for a server, and a
service unit's ``SupplementaryGroups=`` would not count. The database is asked only where the kernel does not say.
"""

from __future__ import annotations

import os
import pwd
import socket
import struct
from typing import NamedTuple

from rigctl.wire.user_name import user_name

_CREDENTIALS = struct.Struct("3i")  # struct ucred: pid, uid, gid
_SO_PEERGROUPS = 59  # <asm-generic/socket.h>, Linux 4.13
_GROUPS_BYTES = 1024  # the most that Python asks for: 256 groups
_NOT_KNOWN = 0xFFFFFFFF


class LocalPeer(NamedTuple):
    """A process of this computer that has connected."""

    pid: int
    uid: int
    groups: frozenset[int]

    @property
    def name(self) -> str:
        """The user's name."""
        return user_name(self.uid)


def peer_of(connection: socket.socket) -> LocalPeer:
    """The process that has opened a connection.

    Raises:
        OSError: it is no Unix socket, or closed.
    """
    pid, uid, gid = _CREDENTIALS.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
    uid, gid = uid & _NOT_KNOWN, gid & _NOT_KNOWN
    try:
        found = connection.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _GROUPS_BYTES)
        groups = {one for (one,) in struct.iter_unpack("I", found)}
    except OSError:  # an older kernel, or more groups than fit
        groups = _in_database(uid, gid)
    return LocalPeer(pid, uid, frozenset(groups | {gid}))


def _in_database(uid: int, gid: int) -> set[int]:
    try:
        return set(os.getgrouplist(pwd.getpwuid(uid).pw_name, gid))
    except KeyError:
        return set()


def is_admitted(peer: LocalPeer, own_uid: int, *groups: int) -> bool:
    """Whether he is the daemon's user, root, or a member of one of ``groups`` (-1: there is none)."""
    return peer.uid in (0, own_uid) or not peer.groups.isdisjoint(groups)
