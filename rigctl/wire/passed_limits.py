"""Limits of the rig file that are exceeded now, derived from the events because the state does not carry them."""

from __future__ import annotations

from typing import Any

_HEADING = "limit: "  # of an event's text; removed, since a display of the limits has its own heading


class PassedLimits:
    """A limit is exceeded from its LIMIT event on, until its LIMIT_OVER event or the start of a new loop."""

    def __init__(self) -> None:
        self._passed: dict[tuple[Any, ...], str] = {}  # fault, row and limit -> in words, with the value

    @property
    def now(self) -> list[str]:
        """The exceeded limits in words, each with the value that exceeded it, oldest first."""
        return list(self._passed.values())

    def clear(self) -> None:
        """Forget all of them, before the events are replayed."""
        self._passed.clear()

    def note(self, event: dict[str, Any]) -> None:
        """Take one event; events come in order."""
        kind, row = event.get("kind"), (event.get("a"), event.get("about"), event.get("limit"))
        if kind == "LIMIT":
            self._passed[row] = str(event.get("text", "")).removeprefix(_HEADING)
        elif kind == "LIMIT_OVER":
            self._passed.pop(row, None)
        elif kind == "STARTED":
            self._passed.clear()
