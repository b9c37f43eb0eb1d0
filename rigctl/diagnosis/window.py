"""What a diagnosis looks at: the records and events around the trip of the fault that is latched now."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.model.events import Kind

BEFORE_NS, AFTER_NS = 2_500_000_000, 1_200_000_000
"""Records from this long before the trip until this long after it; what comes later is the rig's reaction."""
_BEGINS, _ENDS = (Kind.TRIP, Kind.EXCEPTION), (Kind.RESET, Kind.STARTED, Kind.START_ANEW)


class Noted(NamedTuple):
    """An event of the loop; see `rigctl.model.events.Kind` for the meaning of its numbers."""

    t_ns: int
    kind: int
    a: int = 0
    b: int = 0
    value: float = 0.0
    limit: float = 0.0
    text: str = ""


def noted(events: npt.NDArray[Any]) -> list[Noted]:
    """Slots of the ring ``events``."""
    return [
        Noted(int(e["t_ns"]), int(e["kind"]), int(e["a"]), int(e["b"]), float(e["value"]), float(e["limit"]),
              bytes(e["text"]).decode(errors="replace"))
        for e in events
    ]  # fmt: skip


@dataclass(frozen=True)
class TripWindow:
    """A trip with its surroundings. ``records``: ``RECORD`` slots; there may be none, then the events alone decide."""

    settings: RigSettings
    trip: Noted
    events: tuple[Noted, ...]
    records: npt.NDArray[Any]


def trips(events: Iterable[Noted]) -> list[Noted]:
    """The first trip of every time that a fault was latched, oldest first."""
    found: list[Noted] = []
    latched = False
    for event in events:
        if event.kind in _ENDS:
            latched = False
        elif event.kind in _BEGINS and not latched:
            latched = True
            found.append(event)
    return found


def latched(events: Sequence[Noted]) -> Noted | None:
    """The trip behind the fault that is latched after ``events``; None without one."""
    last = max((i for i, event in enumerate(events) if event.kind in _ENDS), default=-1)
    return next((event for event in events[last + 1 :] if event.kind in _BEGINS), None)


def around(trip: Noted, settings: RigSettings, events: Iterable[Noted], records: npt.NDArray[Any]) -> TripWindow:
    """The window of a trip, cut out of longer series."""
    first, last = trip.t_ns - BEFORE_NS, trip.t_ns + AFTER_NS
    near = tuple(event for event in events if first <= event.t_ns <= last)
    times = records["t_ns"]
    return TripWindow(
        settings, trip, near, records[np.searchsorted(times, first) : np.searchsorted(times, last, "right")]
    )
