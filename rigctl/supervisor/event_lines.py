"""The loop's events as the lines that the daemon prints."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rigctl.model.events import EACH_SECOND, Kind, worded

AGAIN_NS = 60_000_000_000
"""After which a failure that the loop reports every second is printed again while it lasts."""
KEPT = 100


class EventLines:
    """Makes the lines; of a failure that lasts, one a minute: the others would push everything else off the screen."""

    def __init__(self) -> None:
        self._next_ns: dict[str, int] = {}

    def of(self, slots: np.ndarray) -> Iterator[str]:
        """A line for each event of the ring ``events`` that is printed, with its severity unless that is ``info``."""
        for slot in slots:
            kind, a, b, value, limit, text = (slot[n].item() for n in ("kind", "a", "b", "value", "limit", "text"))
            event = worded(kind, a, b, value, limit, text.decode(errors="replace"))
            if Kind(kind).name in EACH_SECOND and not self._is_due(event.text, int(slot["t_ns"])):
                continue
            yield event.text if event.severity == "info" else f"{event.severity.upper()}: {event.text}"

    def _is_due(self, text: str, t_ns: int) -> bool:
        if t_ns < self._next_ns.get(text, 0):
            return False
        if len(self._next_ns) >= KEPT:
            self._next_ns.clear()
        self._next_ns[text] = t_ns + AGAIN_NS
        return True
