"""The culprit of the fault that is latched now, from the rings of a running loop."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.diagnosis.diagnose import Culprit, diagnose
from rigctl.diagnosis.window import AFTER_NS, BEFORE_NS, around, latched
from rigctl.ipc.ring import RingReader
from rigctl.model.loop_event import LoopEvent

AGAIN_NS = 200_000_000
"""Between two looks while the signals after the trip still come."""


class LatchedCulprit:
    """Looks again until the window of the trip is complete, and keeps what it has found until the reset."""

    def __init__(self, records: RingReader, settings: RigSettings) -> None:
        """``records``: a reader of its own."""
        self._records, self._settings = records, settings
        self._events: list[LoopEvent] = []
        self._found: Culprit | None = None
        self._trip: LoopEvent | None = None
        self._due_ns = 0

    def note(self, events: npt.NDArray[Any]) -> None:
        """Take new events."""
        self._events += LoopEvent.of_slots(events)
        trip = latched(self._events)
        if trip != self._trip:
            self._trip, self._found, self._due_ns = trip, None, 0
        if self._events:
            from_ns, to_ns = (self._events[-1].t_ns - BEFORE_NS, self._events[-1].t_ns)
            if trip is not None:
                from_ns, to_ns = trip.t_ns - BEFORE_NS, trip.t_ns + AFTER_NS
            self._events = [event for event in self._events if from_ns <= event.t_ns <= to_ns]

    def of(self, record: np.void | None) -> Culprit | None:
        """The culprit at the newest record; None where no fault is latched."""
        trip = self._trip
        if record is None or not record["fault"] or trip is None:
            return None
        t_ns = int(record["t_ns"])
        if self._found is None or (t_ns >= self._due_ns and self._due_ns <= trip.t_ns + AFTER_NS):
            self._records.seek(trip.t_ns - BEFORE_NS)
            self._found = diagnose(around(trip, self._settings, self._events, self._records.read()))
            self._due_ns = t_ns + AGAIN_NS
        return self._found
