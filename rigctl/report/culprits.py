"""The culprits of a recording's trips: the diagnosis of a running rig, on what was recorded of it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from rigctl.config.settings import RigSettings
from rigctl.diagnosis.diagnose import Culprit, diagnose
from rigctl.diagnosis.window import around, trips
from rigctl.model.events import Kind
from rigctl.model.loop_event import LoopEvent
from rigctl.recorder.recording import Recording, Said


class RecordedCulprit(NamedTuple):
    """The culprit of the trip at ``t_ns`` (CLOCK_MONOTONIC)."""

    t_ns: int
    culprit: Culprit


def culprits(recording: Recording, settings: RigSettings) -> list[RecordedCulprit]:
    """The culprit of every time that a fault was latched, oldest first."""
    events = list(_noted(recording.events))
    return [
        RecordedCulprit(trip.t_ns, diagnose(around(trip, settings, events, recording.records)))
        for trip in trips(events)
    ]


def _noted(said: Iterable[Said]) -> Iterable[LoopEvent]:
    """Recorded events as the loop wrote them."""
    for item in said:
        kind = Kind.__members__.get(item.what.upper())
        if kind is not None:
            details = item.details
            a, b, value, limit = (details.get(name) for name in ("a", "b", "value", "limit"))
            about = str(details.get("about", ""))
            yield LoopEvent.of(item.t_ns, kind, _whole(a), _whole(b), _real(value), _real(limit), about)


def _whole(found: object) -> int:
    return found if isinstance(found, int) else 0


def _real(found: object) -> float:
    return float(found) if isinstance(found, int | float) else 0.0
