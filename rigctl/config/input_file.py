"""Files a process reads at start and did not just write itself: in their place may stand anything.

A pipe that nobody writes to, a folder, a link to somewhere else, gigabytes: each is an error of reading, none is waited
for, followed or loaded.
"""

from __future__ import annotations

import errno
import os
import pathlib
import stat
from typing import Any

import msgspec

LARGEST_BYTES = 4 << 20
"""Ten times the longest file of a runtime folder."""


def read(path: pathlib.Path, *, largest: int = LARGEST_BYTES, links: bool = False) -> bytes:
    """Content of a regular file of at most ``largest`` bytes. ``links``: a link in its place is followed.

    Raises:
        OSError: it is not there, cannot be read, is no regular file or is larger.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if links else os.O_NOFOLLOW)
    fd = os.open(path, flags)
    try:
        if not stat.S_ISREG(os.fstat(fd).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        parts, size = [], 0
        while part := os.read(fd, 1 << 20):
            parts.append(part)
            size += len(part)
            if size > largest:
                raise OSError(errno.EFBIG, f"more than {largest} bytes", str(path))
        return b"".join(parts)
    finally:
        os.close(fd)


def decoded(data: bytes, kind: Any = Any) -> Any:
    """JSON as a value of ``kind``.

    Raises:
        msgspec.MsgspecError: it is none, whatever is wrong with it.
    """
    try:
        return msgspec.json.decode(data, type=kind)
    except (UnicodeDecodeError, RecursionError) as error:
        what = "not UTF-8 text" if isinstance(error, UnicodeDecodeError) else "nested too deeply"
        raise msgspec.DecodeError(what) from None
