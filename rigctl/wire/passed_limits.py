"""Limits of the rig file that are passed now, worked out of the events: the state does not say."""

from __future__ import annotations

from typing import Any

_BEGINS, _ENDS = "limit: ", "limit: no longer "


class PassedLimits:
    """A limit is passed from its event on, until the one that says it is kept again or a new loop starts."""

    def __init__(self) -> None:
        self._passed: dict[str, str] = {}  # limit in words -> with the value that passed it

    @property
    def now(self) -> list[str]:
        """Those passed, in words with the value that passed them, oldest first."""
        return list(self._passed.values())

    def clear(self) -> None:
        """Forget them; the events come again."""
        self._passed.clear()

    def note(self, event: dict[str, Any]) -> None:
        """One event, in order."""
        kind, text = event.get("kind"), str(event.get("text", ""))
        if kind == "LIMIT":
            words = text.removeprefix(_BEGINS)
            self._passed[words.rpartition(" (")[0]] = words
        elif kind == "LIMIT_OVER":
            self._passed.pop(text.removeprefix(_ENDS), None)
        elif kind == "STARTED":
            self._passed.clear()
