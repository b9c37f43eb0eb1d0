"""What a row of `rigctl.model.events.Kind` is made of: fields, and the alarm of an event."""

from __future__ import annotations

from enum import Enum, IntEnum, auto
from typing import Any, NamedTuple

from rigctl.model.faults import Fault
from rigctl.model.quantity import Number, unit_of


class EventField(NamedTuple):
    """What a kind has in a slot's value, or in some bits of it; the unit is the ending of the name."""

    slot: str
    name: str
    meaning: str
    """As ``meta/schema`` has it behind the letter of the slot."""
    of: type[IntEnum] | type[bool] | None = None
    """The enumeration that the number is a member of; bool for 1 and 0."""
    beyond: bool = False
    """A number that the enumeration does not have is worded too."""
    shift: int = 0
    bits: int = 0
    """Where several fields share a whole number: how many bits this one has, 0 for all above ``shift``."""

    @property
    def unit(self) -> str:
        """Its unit, "" for none."""
        return unit_of(self.name)

    @property
    def json(self) -> str:
        """Its type in JSON."""
        if self.of is bool:
            return "boolean"
        if self.members is not None or self.slot == "text":
            return "string"
        return "integer" if self.slot in ("a", "b") else "number?"

    @property
    def members(self) -> type[IntEnum] | None:
        """The enumeration, None for another field."""
        return self.of if self.of is not None and issubclass(self.of, IntEnum) else None

    def read(self, found: Any) -> Any:
        """The field in a slot's value: text, a number, a bool or a member; the number where it is no member."""
        if self.shift or self.bits:
            found = found >> self.shift
            found = found & (1 << self.bits) - 1 if self.bits else found
        if self.members is not None:
            return self.members(found) if self.fits(found) else found
        if self.of is not None:
            return bool(found)
        return Number(found) if isinstance(found, float) else found

    def fits(self, found: Any) -> bool:
        """Whether a number is a member, where the field is one of an enumeration."""
        return self.members is None or found in self.members._value2member_map_


class Priority(IntEnum):
    """How soon somebody has to act on an alarm."""

    URGENT = 1  # the rig commands the drive off, or has nothing stronger left
    HIGH = 2  # the rig holds or ramps down: it is out of service
    LOW = 3  # the rig goes on


class OfFault(Enum):
    """The alarm of an event is that of its field ``fault``."""

    BEGINS = auto()
    ENDS = auto()
    RESET = auto()


class OwnAlarm(NamedTuple):
    """The alarm of an event that is about no latched fault."""

    priority: Priority
    remedy_of: Fault
    lasts: bool = False
    """It is active until an event of severity info."""
    each_second: bool = False
    """The loop repeats the event every second while its cause is there."""
