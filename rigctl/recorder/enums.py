"""Slot fields that are enumerations, and the names of their numbers in recordings and exports."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag

from rigctl.ipc.record import RECORD, Slot
from rigctl.model.faults import Fault
from rigctl.model.samples import Quality, Verdict
from rigctl.model.signals import ENUMS
from rigctl.model.states import Mode
from rigctl.wire.record_names import quality_words

Names = Mapping[int, str]


def _of(kind: type[IntEnum]) -> Names:
    return {int(member): member.name for member in kind}


_KINDS: dict[type[IntEnum | IntFlag], Names] = {
    Mode: _of(Mode),
    Fault: {0: "NONE", **_of(Fault)},
    Verdict: _of(Verdict),
    Quality: {bits: quality_words(bits).replace("+", "_").upper() for bits in range(2 * max(Quality))},
}
"""Names of the enumerations that a recording names, by number; it has the others as numbers. Quality is a set of bits,
so every combination has a name."""


def name_of(kind: type[IntEnum], number: int) -> str:
    """A member's name; its number if this version does not know it."""
    return kind(number).name if number in kind._value2member_map_ else str(number)


def enum_of(slot: Slot, field: str) -> tuple[str, Names] | None:
    """The enumeration of a field and its names; None for a plain number."""
    if slot.name != RECORD.name:
        return None
    enum = ENUMS.get(field)
    return None if enum is None or enum.kind not in _KINDS else (enum.kind.__name__, _KINDS[enum.kind])
