"""Everything the page shows of the rig. The client's thread writes it, the server's thread reads it."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from rigctl.page.history import History, Ids
from rigctl.page.lateness import Lateness
from rigctl.page.signals import values_of
from rigctl.wire.passed_limits import PassedLimits

EVENTS_HELD = 200
SILENT_S = 1.0


class Picture:
    """History, newest state, events, and state of the connection; guarded by ``lock``."""

    def __init__(self, endpoint: str) -> None:
        self.lock = threading.Lock()
        self.endpoint = endpoint
        self.history = History()
        self.lateness = Lateness()
        self.limits = PassedLimits()
        self.state: dict[str, Any] | None = None
        self.active: dict[str, Any] = {}
        self.active_serial = 0  # changes with ``active``
        self.events: deque[dict[str, Any]] = deque(maxlen=EVENTS_HELD)
        self.events_serial = 0  # changes with ``events``
        self.samples_lost = 0  # of the fast stream, between gateway and page
        self.refused = ""  # number of messages without the shape of a daemon's, in words
        self.trouble = f"no daemon has answered at {endpoint} yet"  # why no data comes
        self._heard: float | None = None

    @property
    def silent_s(self) -> float:
        """Seconds since the last data from the daemon; infinite before the first."""
        return math.inf if self._heard is None else time.monotonic() - self._heard

    def add_records(self, records: npt.NDArray[Any], wall_offset_ns: int) -> None:
        """Add records of the fast stream; ``wall_offset_ns``: wall clock less the records' clock."""
        wall_ns: Ids = records["t_ns"].astype(np.int64) + wall_offset_ns
        values = values_of(records)
        with self.lock:
            self.history.add(wall_ns, values)
            self.lateness.add(wall_ns, records)

    def take_state(self, state: dict[str, Any]) -> None:
        """Store the newest state message."""
        with self.lock:
            self.state, self._heard = state, time.monotonic()

    def take_active(self, active: dict[str, Any]) -> None:
        """Store the active configuration."""
        with self.lock:
            self.active = active
            self.active_serial += 1

    def add_events(self, events: Iterable[dict[str, Any]], *, anew: bool = False) -> None:
        """Add events, oldest first; ``anew``: they replace all held."""
        with self.lock:
            if anew:
                self.events.clear()
                self.events_serial += 1
                self.limits.clear()
            known = {(event["t_ns"], event["seq"]) for event in self.events}
            for event in events:
                if (event["t_ns"], event["seq"]) not in known:
                    self.events.append(event)
                    self.limits.note(event)
                    self.events_serial += 1
