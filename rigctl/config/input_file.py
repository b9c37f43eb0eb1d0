"""Reads files that another process may have replaced by anything.

A pipe without a writer, a folder, a link, or gigabytes of data is an error of reading; nothing of it is waited for,
followed or loaded.
"""

from __future__ import annotations

import codecs
import errno
import os
import pathlib
import stat
from typing import Any

LARGEST_BYTES = 4 << 20
"""Ten times the longest file of a runtime folder."""


def read(path: pathlib.Path, *, largest: int = LARGEST_BYTES, links: bool = False, alone: bool = False) -> bytes:
    """Content of a regular file of at most ``largest`` bytes.

    ``links``: a link in its place is followed. ``alone``: only a file of this user is read, and none that others may
    write.

    Raises:
        OSError: the file is missing, unreadable, larger, no regular file, or with ``alone`` another user's.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if links else os.O_NOFOLLOW)
    fd = os.open(path, flags)
    try:
        found = os.fstat(fd)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        if alone and (found.st_uid != os.geteuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
            raise OSError(errno.EPERM, "not this user's alone", str(path))
        parts, size = [], 0
        while part := os.read(fd, 1 << 20):
            parts.append(part)
            size += len(part)
            if size > largest:
                raise OSError(errno.EFBIG, f"more than {largest} bytes", str(path))
        return b"".join(parts)
    finally:
        os.close(fd)


def text(data: bytes) -> str:
    """Text in UTF-8, in UTF-16 by its mark, or in Windows' western code page, which most vendors' tools write."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def decoded(data: bytes, kind: Any = Any) -> Any:
    """JSON as a value of ``kind``.

    Raises:
        msgspec.MsgspecError: for any error in it.
    """
    import msgspec  # slow to load, and `rigctl hold` only reads

    try:
        return msgspec.json.decode(data, type=kind)
    except (UnicodeDecodeError, RecursionError) as error:
        what = "not UTF-8 text" if isinstance(error, UnicodeDecodeError) else "nested too deeply"
        raise msgspec.DecodeError(what) from None
