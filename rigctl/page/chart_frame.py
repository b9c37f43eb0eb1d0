"""Binary frames of the charts: a header of 32 bytes, then buckets, all little-endian.

======  ====  ====================================================
offset  type  meaning
======  ====  ====================================================
0       u16   window, its number in ``history.WINDOWS_S``
2       u16   signals
4       u32   buckets
8       f64   number of the first bucket, in its widths since 1970
16      f64   width of a bucket in ms
24      f64   wall clock of the newest record in ms
======  ====  ====================================================

A bucket is two f32 for each signal: smallest and largest value, NaN for none. The last bucket of a frame is incomplete
and comes again in the next frame.
"""

from __future__ import annotations

import struct

from rigctl.page.history import History

HEADER = struct.Struct("<HHIddd")


def frame(history: History, window: int, since: int) -> tuple[bytes, int]:
    """Buckets of a window from number ``since`` on, and the number for the next call."""
    level = history.levels[window]
    first, buckets = level.since(since)
    count, signals = buckets.shape[:2]
    head = HEADER.pack(window, signals, count, float(first), level.width_ns / 1e6, history.newest_ns / 1e6)
    return head + buckets.astype("<f4").tobytes(), level.newest
