"""Events of the loop with their values by name, from the slots of a ring: the one decoder of whoever reads them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from rigctl.model.events import Kind


class LoopEvent(NamedTuple):
    """An event of the loop at ``t_ns`` (CLOCK_MONOTONIC), with its number in the ring; ``fields``: see `Kind.read`."""

    t_ns: int
    kind: Kind
    fields: Mapping[str, Any]
    seq: int = 0

    @classmethod
    def of(
        cls, t_ns: int, kind: int, a: int = 0, b: int = 0, value: float = 0.0, limit: float = 0.0, text: str = ""
    ) -> LoopEvent:
        """The event of a slot's values.

        Raises:
            ValueError: there is no such kind.
        """
        row = Kind(kind)
        return cls(t_ns, row, row.read(a, b, value, limit, text))

    @classmethod
    def of_slots(cls, slots: Iterable[Any]) -> list[LoopEvent]:
        """The events in ``EVENT`` slots; those of a kind that this version does not have are left out."""
        known = [slot for slot in slots if int(slot["kind"]) in Kind._value2member_map_]
        return [cls.of(*_values(slot))._replace(seq=int(slot["seq"])) for slot in known]


def _values(slot: Any) -> tuple[int, int, int, int, float, float, str]:
    t_ns, kind, a, b = (int(slot[name]) for name in ("t_ns", "kind", "a", "b"))
    return t_ns, kind, a, b, float(slot["value"]), float(slot["limit"]), bytes(slot["text"]).decode(errors="replace")
