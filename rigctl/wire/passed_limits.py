"""Limits of the rig file that are passed now, worked out of the events: the state does not say."""

from __future__ import annotations

from typing import Any

_HEADING = "limit: "  # of an event's text; what shows the limits has a heading of its own


class PassedLimits:
    """A limit is passed from its event on, until the one that says it is kept again or a new loop starts."""

    def __init__(self) -> None:
        self._passed: dict[tuple[Any, ...], str] = {}  # fault, row and limit -> in words, with the value

    @property
    def now(self) -> list[str]:
        """Those passed, in words with the value that passed them, oldest first."""
        return list(self._passed.values())

    def clear(self) -> None:
        """Forget them; the events come again."""
        self._passed.clear()

    def note(self, event: dict[str, Any]) -> None:
        """One event, in order."""
        kind, row = event.get("kind"), (event.get("a"), event.get("about"), event.get("limit"))
        if kind == "LIMIT":
            self._passed[row] = str(event.get("text", "")).removeprefix(_HEADING)
        elif kind == "LIMIT_OVER":
            self._passed.pop(row, None)
        elif kind == "STARTED":
            self._passed.clear()
