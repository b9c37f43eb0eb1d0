"""The page's fields for a number: their text is read as the command line reads it, and their bounds in words."""

from __future__ import annotations

import math
from typing import Any

from rigctl.model.quantity import number as digits
from rigctl.model.quantity import significant
from rigctl.page.command_bar import number_of
from rigctl.wire.offers import BUTTONS, PAY_OUT, bounds_of
from rigctl.wire.typed_values import SHELF_MINUTES, typed

_NUMBERS = {verb.name.lower(): number for verb in BUTTONS if (number := number_of(verb)) is not None}
REQUIRED = tuple(name for name, number in _NUMBERS.items() if number.required)
"""Commands that have a number."""
OPTIONAL = tuple(name for name in _NUMBERS if name not in REQUIRED)
"""Those that may have one."""


def value_of(verb: str, given: str | float | None) -> float | None:
    """The number of a command: of a field's text, or as a program sends it.

    Raises:
        TypedNumberError: other text.
    """
    return None if given is None else typed(_NUMBERS[verb]).read(given)


def bounds(state: dict[str, Any]) -> dict[str, str]:
    """What each field takes, by the field's id in the page; "" where it is not known."""
    room = bounds_of(state, PAY_OUT)
    words = {
        number.noun: "" if (found := number.bounds or bounds_of(state, name)) is None else
        f"{significant(found[0])} to {significant(found[1], number.field.unit if number.field else '')}"
        for name, number in _NUMBERS.items()
    }  # fmt: skip
    return words | {
        "millimetres": "" if room is None else f"up to {digits(math.floor(room[1]), 0, 'mm')}",
        "shelve-minutes": f"{SHELF_MINUTES.bounds} min",
    }
