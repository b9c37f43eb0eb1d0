"""Which values of a state are not to be trusted, and why: no display shows one of them as a value."""

from __future__ import annotations

from typing import Any

from rigctl.diagnosis.part import FROM_BUS
from rigctl.model.faults import Fault, Trait, bits_of, having
from rigctl.model.parts import Part
from rigctl.model.signals import DEVICES, SIGNALS

DOUBTED_BY = {
    "tension": having(Trait.HIDES_TENSION),
    "drive": having(Trait.HIDES_DRIVE),
    "inclination": having(Trait.HIDES_INCLINATION),
}
"""Causes that make a device's value untrustworthy although its samples may arrive, and be good each by itself."""
_UNTIL_RESET = having(Trait.HIDES_UNTIL_RESET)
DEVICE_OF = {row.field: row.device for row in SIGNALS if row.device}
"""The device behind each value that a display shows."""


def doubted_bits(device: str) -> int:
    """The bits of ``cause_bits`` in a record that put a device's value in doubt."""
    return bits_of(DOUBTED_BY[device])


def doubts(state: dict[str, Any]) -> dict[str, str]:
    """Why a device's value is not to be trusted, by device; a device that is trusted is not in it."""
    if state.get("mode") is None or not state.get("loop_alive"):
        return dict.fromkeys(DEVICES, "the loop writes no records")
    found = state.get("causes")
    active = (
        {str(cause.get("fault")) for cause in found if isinstance(cause, dict)} if isinstance(found, list) else set()
    )
    latched, quality = str(state.get("fault")), state.get("quality") or {}
    result = {}
    for device in DEVICES:
        named = [
            fault.name
            for fault in sorted(DOUBTED_BY[device])
            if fault.name in active or (fault.name == latched and fault in _UNTIL_RESET)
        ]
        if quality.get(device, "good") != "good":
            result[device] = str(quality[device])
        elif named:
            result[device] = named[0]
    return result


def trusted(state: dict[str, Any], name: str) -> float | None:
    """A value of the state, None where it is not there or not to be trusted."""
    value = state.get(name)
    if DEVICE_OF.get(name) in doubts(state):
        return None
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def explained(state: dict[str, Any]) -> frozenset[str]:
    """Causes that the culprit brings about by its nature: they are named under it and have no steps of their own.

    A drive that is heard, and has not gone off, is a cause of its own.
    """
    culprit = state.get("culprit")
    if not isinstance(culprit, dict) or culprit.get("parts") != [Part.BUS]:
        return frozenset()
    return FROM_BUS if "drive" in doubts(state) else FROM_BUS - {Fault.DRIVE_UNASKED.name}
