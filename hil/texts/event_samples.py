"""Values of events, so many of each kind that every branch of its wording is reached."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from enum import IntEnum, IntFlag
from itertools import product
from typing import Any, NamedTuple

from rigctl.model import emergency
from rigctl.model.device_states import STATUSWORD, DriveState
from rigctl.model.event_row import EventField
from rigctl.model.events import Kind
from rigctl.model.fault_words import MOVES_OFF, POSITION, RUNAWAY, SPEED
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action, Symptom
from rigctl.model.signals import NEVER_AGE_NS, WATCHED
from rigctl.model.states import EndStep, EStop, Event, HeldBy, LoadAtRest, Mode, PowerOff, Witness
from rigctl.model.unmeasured import Unmeasured


class EventSample(NamedTuple):
    """An event by the values of its slot, see `rigctl.model.events.Kind`."""

    kind: Kind
    a: int = 0
    b: int = 0
    value: float = 0.0
    limit: float = 0.0
    text: str = ""

    @property
    def name(self) -> str:
        """Its values, members of enumerations by their names."""
        figures = " ".join(map(in_name, (self.a, self.b, self.value, self.limit)))
        return f"event {self.kind.name} {figures} {self.text}".rstrip()


def in_name(value: float) -> str:
    """A value as part of a name."""
    return str(value.name) if isinstance(value, IntEnum | IntFlag) and value.name else f"{value:.10g}"


_UNKNOWN = 99
_NEVER = 2.0 * NEVER_AGE_NS
_FIGURES = ((12.5, 5.0), (12.5e6, 5e6), (_NEVER, 5e6), (math.nan, 0.0), (0.0, 0.0), (-0.04, 0.5))
"""Value and limit in any unit: small numbers, ages in ns, one of a device that was never heard, none."""
_CODES = (0x0000, 0x0010, *emergency.CODES, *(upper << 8 | 1 for upper in emergency.CLASSES), 0x3401, 0xA001)
_MANUFACTURER = ("", "0102030405", "no hex")
_NODE, _INDEX = 4, 0x6085

_PLAIN = (
    EventSample(Kind.EXCEPTION, text="ValueError in speed_of:12: no value"),
    EventSample(Kind.SEND_FAILED, text="No buffer space available"),
    EventSample(Kind.RECEIVE_FAILED, text="Network is down"),
    EventSample(Kind.STARTED, 2, 1),
    EventSample(Kind.STOPPED, value=52.345, limit=-0.01),
    EventSample(Kind.STOPPED, value=-0.001, limit=300.04),
    EventSample(Kind.CLOCK, 1),
    EventSample(Kind.CLOCK, 2),
    EventSample(Kind.CORRECTION, value=1.2345, limit=1.00002),
    EventSample(Kind.CORRECTION, value=-0.0001, limit=1.0),
    EventSample(Kind.SECOND_FORCE, value=1.2345, limit=1.00002),
    EventSample(Kind.SECOND_FORCE, value=-0.0001, limit=1.0),
    EventSample(Kind.GAINS, text="0.4, 0.2, 1"),
    EventSample(Kind.DRIVE_CREEPS, value=0.25, limit=0.05),
    EventSample(Kind.DRIVE_CREEPS, value=-0.25, limit=0.05),
    EventSample(Kind.FOREIGN_SDO, _NODE, _INDEX << 8, text="reads 0x6085 of the drive"),
    EventSample(Kind.SETTING_LOST, _NODE, _INDEX << 8, 5.0, 7.0, "0x6085 of the drive is 5, expected 7"),
    EventSample(Kind.READ_BACK, 1, value=0.02),
    EventSample(Kind.READ_BACK, 2, value=1.25),
    EventSample(Kind.STROKE, 1, value=52.345, limit=52.3, text="it is the last one known"),
    EventSample(Kind.STROKE, 0, value=-0.001, limit=math.nan, text="no stroke is known"),
    EventSample(Kind.BRAKE_FLAG, 1, 0, 300.04, 240.0, "the stroke moved by 0.60 mm"),
    EventSample(Kind.BRAKE_FLAG, 1, 1, 0.0, 240.0, "last_stroke.json cannot be read"),
    EventSample(Kind.BRAKE_FLAG, 0, 0, text="a test of 10 s with 300 N"),
    EventSample(Kind.BRAKE_TEST, 1, value=0.0123, limit=300.04),
    EventSample(Kind.BRAKE_TEST, 0),
    EventSample(Kind.LOAD_STEP, 1, 25000, 300.04, -1.5, "0.01"),
    EventSample(Kind.LOAD_STEP, 2, 0, 300.04, 60.0, "0.01"),
    EventSample(Kind.CREEP),
    EventSample(Kind.CREEP, 1, value=1e-4, text="0.0001, 60"),
    EventSample(Kind.CREEP, 0, value=-1e-9, text="0.0001, 60"),
    EventSample(Kind.MOVE, 0),
    EventSample(Kind.MOVE, 1, 0),
    EventSample(Kind.MOVE, 1, 1),
    EventSample(Kind.MOVE, 2, 2),
    EventSample(Kind.LEARNT, 1, 1, 0.5, 1.5),
    EventSample(Kind.LEARNT, 2, 2, 0.5, 1.5),
    EventSample(Kind.NOT_LEARNT, 1, 1, 0.5, 1.5, "it was cut short"),
    EventSample(Kind.NOT_LEARNT, 1, 0, text="it was cut short"),
    EventSample(Kind.MARGINS_DIFFER, value=1.5, limit=1.3),
    EventSample(Kind.LOCAL_HOLD, 1000, 4711, text="kim"),
    EventSample(Kind.HOLD_SOCKET_CLOSED, 1000, 4711),
    EventSample(Kind.FOUND_AT_START, _NODE, _INDEX << 8, 5.0, 0.0),
    EventSample(Kind.FOUND_AT_START, _NODE, _INDEX << 8, 5.0, 7.0),
    EventSample(Kind.SIGNS, value=6.04, limit=6.0),
    EventSample(Kind.SIGNS, 1, value=3.6, limit=6.0),
)


def samples() -> Iterator[EventSample]:
    """All of them: those below, and for every other kind what its row says."""
    found = [*_PLAIN, *_of_modes(), *_of_faults(), *_of_devices(), *_of_load()]
    by_hand = {sample.kind for sample in found}
    yield from found
    for kind in Kind:
        if kind not in by_hand:
            yield from of_row(kind)


def of_row(kind: Kind) -> Iterator[EventSample]:
    """A sample for each combination of the members of its fields."""
    values = {field.slot: _values(field) for field in kind.fields}
    for chosen in product(*values.values()):
        yield EventSample(kind, **dict(zip(values, chosen, strict=True)))


def _values(field: EventField) -> Sequence[Any]:
    if field.members is not None:
        return tuple(field.members)
    if field.of is bool:
        return (0, 1)
    return {"text": (field.name,), "value": (12.5,), "limit": (5.0,)}.get(field.slot, (2,))


def _of_modes() -> Iterator[EventSample]:
    for event in Event:
        yield EventSample(Kind.MODE, Mode.HOLD, Mode.HOLD, event)
    for mode in Mode:
        yield EventSample(Kind.MODE, mode, mode, Event.STOP)
        yield EventSample(Kind.STROKE_LEFT, mode, value=0.345, limit=0.3)
        yield EventSample(Kind.STROKE_LEFT, mode, value=-0.345, limit=0.3)


def _of_faults() -> Iterator[EventSample]:
    for fault, (value, limit), text in product(Fault, _FIGURES, ("", "tension_n above")):
        yield EventSample(Kind.TRIP, fault, Action.HOLD, value, limit, text)
    for fault, action in product((Fault.CELL_STALE, Fault.LIMIT), Action):
        yield EventSample(Kind.TRIP, fault, action, 12.5e6, 5e6, "tension_n above")
    for kind, fault in product((Kind.LIMIT, Kind.LIMIT_OVER, Kind.CAUSE, Kind.CAUSE_OVER), Fault):
        for value, text in ((12.5, ""), (math.nan, "tension_n per second above")):
            yield EventSample(kind, fault, Action.LOG, value, 5.0, text)
    for signal in WATCHED:
        yield EventSample(Kind.LIMIT, Fault.LIMIT, Action.LOG, 12.5, 5.0, f"{signal} above")
    for pressed in (*EStop, EStop.DRIVE | EStop.IO_NODE):
        yield EventSample(Kind.TRIP, Fault.E_STOP, Action.QUICK_STOP, pressed)
    for missed in (SPEED, POSITION, RUNAWAY, MOVES_OFF):
        yield EventSample(Kind.TRIP, Fault.DRIVE_NOT_FOLLOWING, Action.POWER_OFF, 12.5, 5.0, missed)
    for state in (0, 4, 5, 127):
        yield EventSample(Kind.TRIP, Fault.NODE_NOT_OPERATIONAL, Action.HOLD, state)
    for fault, code in product((Fault.SENSOR_EMERGENCY, Fault.DRIVE_EMERGENCY), _CODES):
        yield EventSample(Kind.TRIP, fault, Action.HOLD, _NODE << 16 | code)
    for kind, fault in product((Kind.RESET, Kind.START_ANEW), Fault):
        yield EventSample(kind, fault)
    for symptom, brake_fails in product(Symptom, ("", "brake")):
        yield EventSample(Kind.ESCALATION, Fault.CELL_STALE, symptom, 12.5, 5.0, brake_fails)
    for fault in Fault:
        yield EventSample(Kind.ESCALATION, fault, Symptom.HOLD_MOVES, 12.5, 5.0)


def _of_devices() -> Iterator[EventSample]:
    for code, register, manufacturer in product(_CODES, (0x00, 0x81), _MANUFACTURER):
        yield EventSample(Kind.EMERGENCY, _NODE, code | register << 16, text=manufacturer)
    for bit in range(8):
        yield EventSample(Kind.EMERGENCY, _NODE, 0x1000 | 1 << bit + 16)
        yield EventSample(Kind.BUS_ERROR, 1 << bit)
        yield EventSample(Kind.BUS_ERROR, 0x04, 1 << bit)
        yield EventSample(Kind.BUS_ERROR, 0x08, 1 << bit + 8)
    yield from (EventSample(Kind.BUS_ERROR, classes, 0x0808) for classes in (0x100, 0x200, 0x4C))
    for state in (0, 4, 5, 127, _UNKNOWN):
        yield EventSample(Kind.NODE_STATE, _NODE, state)
    for state in (*DriveState, _UNKNOWN):
        yield EventSample(Kind.FOUND_AT_START, _NODE, STATUSWORD << 8, state, DriveState.READY_TO_SWITCH_ON)


def _of_load() -> Iterator[EventSample]:
    for held, longest_s in product(HeldBy, (0.0, 65.0)):
        yield EventSample(Kind.HELD, held, held, longest_s, text="HOLD")
    for power, brake_fails in product((*PowerOff, _UNKNOWN), (0, 1)):
        yield EventSample(Kind.POWER_OFF, power, brake_fails, 1.25)
    for rest in (*LoadAtRest, _UNKNOWN):
        yield EventSample(Kind.LOAD_AT_REST, rest, rest, text="HOLD")
    for step in (*EndStep, _UNKNOWN):
        yield EventSample(Kind.ENDING, step, value=10.0, limit=300.04)
    for witness in Witness:
        yield EventSample(Kind.WITNESS, witness, text="carry")
    for why in (*Unmeasured, _UNKNOWN):
        yield EventSample(Kind.NO_MARGINS, why)
