"""glibc's heap in a process of many threads, which would grow for hours without anything being lost.

By default glibc has up to eight arenas for each processor, one for each thread that allocates, and keeps blocks of up
to 32 MiB in them once such a block was freed. Zenoh's threads free what others allocated, so free memory stays in all
arenas, between blocks in use: 11 MiB in a gateway after ten minutes of clients that come and go, and still growing,
beside 15 MiB in use, which stayed the same. With few arenas and fixed sizes 1 MiB is free, at the same processor time.
A recorder kept what had waited in memory for a full disk, 15 MiB, until its end.
"""

from __future__ import annotations

import contextlib
import ctypes

# malloc.h
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_ARENAS = 2
_MAPPED_BYTES = 1 << 16  # larger blocks have memory of their own, which is given back when they are freed
_KEPT_BYTES = 1 << 17  # free memory at the end of an arena above this is given back


def limit() -> None:
    """Limit the heap of this process, before it starts threads; without glibc nothing happens."""
    with contextlib.suppress(AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_ARENA_MAX, _ARENAS)
        mallopt(_M_MMAP_THRESHOLD, _MAPPED_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
