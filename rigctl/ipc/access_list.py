"""POSIX access lists: which users and groups beside its owner may open a socket's file, see acl(5)."""

from __future__ import annotations

import os
import pathlib
import struct
from collections.abc import Iterable, Mapping
from types import MappingProxyType

READ_WRITE = 6
_NAME = "system.posix_acl_access"
_ENTRY = struct.Struct("<HHI")  # struct posix_acl_xattr_entry: tag, permissions, id
_VERSION, _NO_ID = struct.pack("<I", 2), 0xFFFFFFFF
_OWNER, _USER, _OWN_GROUP, _GROUP, _MASK, _OTHER = 0x01, 0x02, 0x04, 0x08, 0x10, 0x20


def admit(
    place: pathlib.Path,
    *,
    users: Mapping[int, int] = MappingProxyType({}),
    groups: Iterable[int] = (),
    others: int = 0,
) -> None:
    """Let these groups read and write a file, users as given here, all others (and its own group) by ``others``.

    Its owner may set this, a member of the groups or not.

    Raises:
        OSError: a file system without access lists.
    """
    rows = (
        (_OWNER, READ_WRITE, _NO_ID), *((_USER, allowed, uid) for uid, allowed in sorted(users.items())),
        (_OWN_GROUP, others, _NO_ID), *((_GROUP, READ_WRITE, gid) for gid in sorted(groups)),
        (_MASK, READ_WRITE, _NO_ID), (_OTHER, others, _NO_ID),
    )  # fmt: skip
    os.setxattr(place, _NAME, _VERSION + b"".join(_ENTRY.pack(*row) for row in rows))
