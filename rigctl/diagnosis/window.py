"""What a diagnosis looks at: the records and events around the trip of the fault that is latched now."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.model.events import Kind
from rigctl.model.loop_event import LoopEvent

BEFORE_NS, AFTER_NS = 2_500_000_000, 1_200_000_000
"""Records from this long before the trip until this long after it; what comes later is the rig's reaction."""
_BEGINS, _ENDS = (Kind.TRIP, Kind.EXCEPTION), (Kind.RESET, Kind.STARTED, Kind.START_ANEW)


@dataclass(frozen=True)
class TripWindow:
    """A trip with its surroundings. ``records``: ``RECORD`` slots; there may be none, then the events alone decide."""

    settings: RigSettings
    trip: LoopEvent
    events: tuple[LoopEvent, ...]
    records: npt.NDArray[Any]


def trips(events: Iterable[LoopEvent]) -> list[LoopEvent]:
    """The first trip of every time that a fault was latched, oldest first."""
    found: list[LoopEvent] = []
    latched = False
    for event in events:
        if event.kind in _ENDS:
            latched = False
        elif event.kind in _BEGINS and not latched:
            latched = True
            found.append(event)
    return found


def latched(events: Sequence[LoopEvent]) -> LoopEvent | None:
    """The trip behind the fault that is latched after ``events``; None without one."""
    last = max((i for i, event in enumerate(events) if event.kind in _ENDS), default=-1)
    return next((event for event in events[last + 1 :] if event.kind in _BEGINS), None)


def around(
    trip: LoopEvent, settings: RigSettings, events: Iterable[LoopEvent], records: npt.NDArray[Any]
) -> TripWindow:
    """The window of a trip, cut out of longer series."""
    first, last = trip.t_ns - BEFORE_NS, trip.t_ns + AFTER_NS
    near = tuple(event for event in events if first <= event.t_ns <= last)
    times = records["t_ns"]
    return TripWindow(
        settings, trip, near, records[np.searchsorted(times, first) : np.searchsorted(times, last, "right")]
    )
