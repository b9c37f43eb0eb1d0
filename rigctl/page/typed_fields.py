"""The page's fields for a number: their text is read as the command line reads it, and their bounds in words."""

from __future__ import annotations

import math
from typing import Any

from rigctl.config.quantity import number, significant
from rigctl.control.modes import CARRY_S
from rigctl.control.safety import payable_mm
from rigctl.wire.trust import trusted
from rigctl.wire.typed_values import LENGTH, SECONDS, SHELF_MINUTES, TARGET

REQUIRED = {"target": TARGET, "carry": SECONDS}
OPTIONAL = {"release": LENGTH}
"""Commands with a number, and those that may have one."""


def value_of(verb: str, given: str | float | None) -> float | None:
    """The number of a command: of a field's text, or as a program sends it.

    Raises:
        TypedNumberError: other text.
    """
    return None if given is None else (REQUIRED | OPTIONAL)[verb].read(given)


def bounds(state: dict[str, Any], settings: dict[str, Any]) -> dict[str, str]:
    """What each field takes, by the field's id in the page; "" where it is not known."""
    tension, cylinder = (settings.get(name) or {} for name in ("tension", "cylinder"))
    low_n, high_n = tension.get("target_min_n"), tension.get("target_max_n")
    end_mm, stroke_mm = cylinder.get("stroke_min_mm"), trusted(state, "stroke_mm")
    room_mm = None if end_mm is None or stroke_mm is None else payable_mm(stroke_mm, end_mm)
    return {
        "newtons": "" if low_n is None or high_n is None else f"{significant(low_n)} to {significant(high_n, 'N')}",
        "seconds": f"{significant(CARRY_S[0])} to {significant(CARRY_S[1], 's')}",
        "millimetres": "" if room_mm is None else f"up to {number(max(0, math.floor(room_mm)), 0, 'mm')}",
        "shelve-minutes": f"{SHELF_MINUTES.bounds} min",
    }
