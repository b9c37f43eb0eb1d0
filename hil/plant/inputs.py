"""The plant's prescribed inputs as the kernel reads them: cubic segments and tones per channel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.plant.layout import CHANNELS

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

SEGMENT_COLUMNS = 5
"""start, c0, c1, c2, c3: the value is c0 + c1 d + c2 d^2 + c3 d^3 at d past the start, until the next one starts."""
TONE_COLUMNS = 5
"""amplitude, w (rad/s), phase (rad), start, end: amplitude sin(w (t - start) + phase) from start to end."""


class Track(NamedTuple):
    """One channel: segments in ascending order of start (the first one's c0 holds before it) and tones on top."""

    segments: Floats = np.zeros((0, SEGMENT_COLUMNS))
    tones: Floats = np.zeros((0, TONE_COLUMNS))
    end: float = 0.0
    """End of the last change; s, or rad for the run-out."""


class Inputs(NamedTuple):
    """All channels, packed. ``spans[c]`` is the first row of channel c and the row after its last one."""

    segments: Floats
    spans: Integers
    tones: Floats
    tone_spans: Integers
    cursor: Integers


def pack(tracks: Mapping[int, Track]) -> Inputs:
    """Pack tracks by channel; a channel without one is at rest at 0.

    Raises:
        ValueError: segments out of order.
    """
    segments: list[Floats] = []
    tones: list[Floats] = []
    spans, tone_spans = np.zeros((CHANNELS, 2), np.int64), np.zeros((CHANNELS, 2), np.int64)
    for channel in range(CHANNELS):
        track = tracks.get(channel, Track())
        if np.any(np.diff(track.segments[:, 0]) < 0.0):
            raise ValueError(f"channel {channel}: segments out of order")
        for rows, span, new in ((segments, spans, track.segments), (tones, tone_spans, track.tones)):
            first = sum(map(len, rows))
            span[channel] = first, first + len(new)
            rows.append(np.asarray(new, np.float64))
    return Inputs(
        np.ascontiguousarray(np.concatenate(segments)),
        spans,
        np.ascontiguousarray(np.concatenate(tones)),
        tone_spans,
        spans[:, 0].copy(),
    )
