"""Since when the rig is in its mode, and who or what began it: from the events, since the state does not say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rigctl.model.states import Event

_TAKEN = ("LEASE_TAKEN", "LEASE_TAKEN_OVER")
_LEFT = ("LEASE_RETURNED", "LEASE_LAPSED")
_BY_COMMAND = frozenset(
    {Event.ENABLED, Event.TENSION, Event.RELEASE, Event.HOLD, Event.DISARM, Event.RESET_HELD, Event.RESET_OFF,
     Event.LOWER}
)  # fmt: skip


@dataclass(frozen=True)
class Origin:
    """``since_ns``: wall clock in ns. ``by``: who or what began the mode, in words."""

    since_ns: int
    by: str


class ModeOrigin:
    """Follows the events in order; None before the first change of mode is known."""

    def __init__(self) -> None:
        self.now: Origin | None = None
        self._holder = self._held_by = self._mode = ""

    def clear(self) -> None:
        """Forget all, before the events are replayed."""
        self.now, self._holder, self._held_by, self._mode = None, "", "", ""

    def note(self, event: dict[str, Any]) -> None:
        """Take one event."""
        kind = event.get("kind")
        if kind in _TAKEN:
            self._holder = str(event.get("operator", ""))
        elif kind in _LEFT:
            self._holder = ""
        elif kind == "LOCAL_HOLD":
            self._held_by = str(event.get("about", ""))
        elif kind == "HOLD_WITHOUT_LEASE":
            self._held_by = str(event.get("operator", ""))
        elif kind == "STARTED":
            by = f"the loop started anew, out of {self._mode}" if self._mode else "the daemon started"
            self.now, self._mode = Origin(int(event.get("wall_ns") or 0), by), ""
        elif kind == "MODE":
            modes, _, why = str(event.get("text", "")).partition(": ")
            self._mode = modes.rpartition(" -> ")[2]
            commanded = event.get("value") in _BY_COMMAND
            holder = self._held_by if event.get("value") == Event.HOLD and self._held_by else self._holder
            by = f"{holder}: {why}" if commanded and holder else why
            self.now, self._held_by = Origin(int(event.get("wall_ns") or 0), by), ""
