"""What a display shows of a rig: newest state, active configuration, events, alarms, exceeded limits, kept up to date.

`rigctl watch` and the page show the same view.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Iterable
from typing import Any

from rigctl.client.connection import Client, NoDaemonError
from rigctl.client.shapes import Message
from rigctl.wire.alarms import Alarms
from rigctl.wire.mode_origin import ModeOrigin
from rigctl.wire.passed_limits import PassedLimits

EVENTS_HELD = 200
SILENT_S = 1.0


class RigView:
    """The data of a display; ``lock`` guards it where one thread writes and another reads."""

    def __init__(self, endpoint: str, rig: str = "") -> None:
        self.lock = threading.Lock()
        self.endpoint, self.rig = endpoint, rig
        self.state: Message | None = None
        self.active: Message = {}
        self.active_serial = 0  # changes with ``active``
        self.events: deque[Message] = deque(maxlen=EVENTS_HELD)
        self.events_serial = 0  # changes with ``events``
        self.limits = PassedLimits()
        self.alarms = Alarms()
        self.origin = ModeOrigin()
        self.refused = ""  # number of messages without the shape of a daemon's, in words
        self._state_at = time.monotonic()

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the active configuration, empty before there is one."""
        return self.active.get("settings") or {}

    @property
    def silent_s(self) -> float:
        """Seconds since the newest state arrived, before the first since the view was made."""
        return time.monotonic() - self._state_at

    @property
    def is_silent(self) -> bool:
        """Whether no state has arrived for ``SILENT_S``."""
        return self.silent_s > SILENT_S

    def take_state(self, state: Message) -> None:
        """Store the newest state message."""
        with self.lock:
            self.state, self._state_at = state, time.monotonic()

    def take_active(self, active: Message) -> None:
        """Store the active configuration."""
        with self.lock:
            self.active = active
            self.active_serial += 1

    def add_events(self, events: Iterable[Message], *, anew: bool = False) -> None:
        """Add events, oldest first; ``anew``: they replace all held."""
        with self.lock:
            if anew:
                self.events.clear()
                self.events_serial += 1
                self.limits.clear()
                self.alarms.clear()
                self.origin.clear()
            known = {(event["t_ns"], event["seq"]) for event in self.events}
            for event in events:
                if (event["t_ns"], event["seq"]) not in known:
                    self.events.append(event)
                    self.limits.note(event)
                    self.alarms.note(event)
                    self.origin.note(event)
                    self.events_serial += 1


class RigFollower:
    """Keeps a view up to date; from a gateway that has just started it queries configuration and past events."""

    def __init__(self, client: Client, view: RigView) -> None:
        self.view = view
        self._client = client
        self._states = client.follow(client.keys.state)
        self._events = client.follow(client.keys.event("*"), EVENTS_HELD)
        self._gateway_wall_ns = 0

    def update(self) -> list[Message]:
        """Take all data that arrived; returns the states, oldest first."""
        states = list(self._states.arrived())
        if states:
            self.view.take_state(states[-1])
            if (started := states[-1].get("gateway_wall_ns", 0)) != self._gateway_wall_ns:
                with contextlib.suppress(NoDaemonError):  # repeated with the next state
                    self.view.take_active(self._client.active())
                    self.view.add_events(self._client.past_events(), anew=True)
                    self._gateway_wall_ns = started
        if events := list(self._events.arrived()):
            self.view.add_events(events)
        self.view.refused = self._client.refusals.words
        return states
