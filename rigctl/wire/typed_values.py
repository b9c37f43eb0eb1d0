"""The numbers that an operator types with a command, on the command line or on the page."""

from __future__ import annotations

from rigctl.config.typed_number import TypedNumber
from rigctl.model.verbs import Option


def typed(option: Option) -> TypedNumber:
    """The number of a command as it is typed; what its bounds are now is the loop's to say."""
    return TypedNumber(option.noun, 0 if option.whole else None, whole=option.whole)


SHELF_MINUTES = TypedNumber("minutes", 0.1, 480)
"""Of an alarm that is shelved; the longest is `rigctl.wire.alarms.LONGEST_SHELF_S`."""


def shelf_s(minutes: float) -> int:
    """How long an alarm is shelved, as the wire has it."""
    return round(60 * minutes)
