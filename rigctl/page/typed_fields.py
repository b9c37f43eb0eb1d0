"""The page's fields for a number: their text is read as the command line reads it, and their bounds in words."""

from __future__ import annotations

import math
from typing import Any

from rigctl.model.quantity import number, significant
from rigctl.model.verbs import CARRY_S
from rigctl.wire.offers import PAY_OUT, bounds_of
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


def bounds(state: dict[str, Any]) -> dict[str, str]:
    """What each field takes, by the field's id in the page; "" where it is not known."""
    target, room = bounds_of(state, "target"), bounds_of(state, PAY_OUT)
    return {
        "newtons": "" if target is None else f"{significant(target[0])} to {significant(target[1], 'N')}",
        "seconds": f"{significant(CARRY_S[0])} to {significant(CARRY_S[1], 's')}",
        "millimetres": "" if room is None else f"up to {number(math.floor(room[1]), 0, 'mm')}",
        "shelve-minutes": f"{SHELF_MINUTES.bounds} min",
    }
