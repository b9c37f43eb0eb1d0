"""States of the rig, of what holds its load, and the events between its modes."""

from __future__ import annotations

from enum import IntEnum, IntFlag, StrEnum


class Mode(IntEnum):
    """What the rig is doing."""

    DISARMED = 0  # drive off, brake closed
    HOLD = 1  # stroke held: by the motor for hold.park_s, then by the brake with the drive off
    TENSIONING = 2  # bounded ramp to the target
    COMPENSATING = 3  # closed loop on the target
    RELEASING = 4  # bounded ramp to slack
    FAULT = 5  # stroke held, latched

    def __init__(self, _number: int) -> None:
        name = self._name_
        self.moves_stroke = name in ("TENSIONING", "COMPENSATING", "RELEASING")
        """The motor has the load, and the law moves the stroke; the other modes keep it where it is."""
        self.parks = name in ("HOLD", "FAULT")
        """The motor holds the stroke for some time at most, then the brake takes the load."""
        self.may_move = self.moves_stroke or name == "HOLD"
        """Armed: a stop ends in HOLD, and a fault may lower the load by a ramp."""
        self.reading_may_jump = name in ("DISARMED", "HOLD")
        """Nothing acts on the tension: zero, scale and creep of the cell may change."""


class Flag(IntFlag):
    """States of a tick."""

    LIMITED_SPEED = 1
    LIMITED_ACCELERATION = 2
    LIMITED_STROKE = 4
    ARMING = 16
    DRIVE_ENABLED = 32
    STOPPING = 64
    STROKE_UNCONFIRMED = 4096  # the drive's position is not confirmed as the stroke, see control.homed
    DRIVE_OFF = 8192  # the drive has reported a state without power for as long as its brake takes to close
    BRAKE_FAILS = 16384  # the brake is known not to hold, see control.brake_flag
    CARRIES = 32768  # the motor has a load that would sink without it; an end lowers it first, see control.ending


class HeldBy(IntEnum):
    """What carries the load; the first in a mode that moves the stroke."""

    NOTHING = 0
    MOTOR = 1  # IEC 61800-5-2: SOS, safe operating stop
    CLOSING = 2  # the drive stops, closes its brake and goes off; the load is not seen at rest yet
    BRAKE = 3  # SBC, safe brake control: the drive is off, its brake closed, and the load is at rest
    TAKING = 4  # the drive is being switched on, the motor takes the load from the brake
    UNKNOWN = 5  # the drive does not report its state, or the load is not seen at rest on the closed brake

    @property
    def words(self) -> str:
        """In the events."""
        return _HELD_WORDS[self]


_HELD_WORDS: dict[HeldBy, str] = {
    HeldBy.NOTHING: "the motor moves the load",
    HeldBy.MOTOR: "load held by the motor",
    HeldBy.CLOSING: "the drive stops and closes its brake",
    HeldBy.BRAKE: "load held by the brake, drive off",
    HeldBy.TAKING: "the motor takes the load from the brake",
    HeldBy.UNKNOWN: "not known what holds the load: the drive does not report, or the load is not seen at rest on the "
    "closed brake",
}


class DrivePower(StrEnum):
    """Whether the motor may have torque; the value is what the screens show."""

    OFF = "off"  # it has reported a state without power for as long as its brake takes to close
    STOPPING = "stopping"  # on its way there by itself
    NOT_OFF = "not off"


REST_S = 2.0  # for which a tension or a stroke at rest shows that a drive has no power


class PowerOff(IntEnum):
    """What shows that a drive commanded off is without power; the number is in the record."""

    NONE = 0  # no such command
    AWAITED = 1
    INPUT = 2  # the drive's STO feedback at the I/O node
    TENSION = 4  # the drive reports a state without power, and a tight rope's tension is at rest
    STROKE = 5  # slack rope: the same, and a stroke at rest
    UNCONFIRMED = 6  # nothing in time

    @property
    def confirmed(self) -> bool:
        """The power is off."""
        return self in _CONFIRMED

    @property
    def words(self) -> str:
        """In the events and on the screens."""
        return _SHOWN_WORDS.get(self, "")


class LoadAtRest(IntEnum):
    """What shows that the load has been at rest for `REST_S`; the number is in the record."""

    UNKNOWN = 0  # neither tension nor stroke is seen
    MOVES = 1  # one that is seen moves, or has not rested for so long
    TENSION = 2  # the stroke is not seen
    STROKE = 3  # the tension is not seen, or the rope is slack
    BOTH = 4

    @property
    def rests(self) -> bool:
        """The load is at rest."""
        return self > LoadAtRest.MOVES

    @property
    def words(self) -> str:
        """On the screens, and behind "load at rest:" in the events."""
        return _REST_WORDS[self]


_REST_WORDS: dict[LoadAtRest, str] = {
    LoadAtRest.UNKNOWN: "not known",
    LoadAtRest.MOVES: f"no, or not for {REST_S:g} s",
    LoadAtRest.TENSION: "yes, by the tension",
    LoadAtRest.STROKE: "yes, by the stroke",
    LoadAtRest.BOTH: "yes, by tension and stroke",
}
_CONFIRMED = frozenset({PowerOff.INPUT, PowerOff.TENSION, PowerOff.STROKE})
_SECONDS = f"{REST_S:g} s"
_SHOWN_WORDS: dict[PowerOff, str] = {
    PowerOff.AWAITED: "power off commanded, not yet confirmed",
    PowerOff.INPUT: "power off confirmed by the drive's STO feedback",
    PowerOff.TENSION: f"power off confirmed by the drive's state and a tension at rest for {_SECONDS}",
    PowerOff.STROKE: f"power off confirmed by the drive's state and a stroke at rest for {_SECONDS}, on a slack rope",
    PowerOff.UNCONFIRMED: "POWER OFF UNCONFIRMED, the drive may still move the load",
}


class Event(IntEnum):
    """What moves the rig from one mode to another."""

    ENABLED = 0  # drive reports operation enabled after an arm command
    TENSION = 1
    TENSIONED = 2  # ramp over, tension on the target
    RELEASE = 3
    SLACK = 4  # release over
    HOLD = 5
    DISARM = 6
    TRIP = 7
    RESET_HELD = 8  # fault acknowledged, the rig was armed and is held by the brake
    RESET_OFF = 9  # fault acknowledged, the rig was not armed or was taken off power, or its drive is in a fault
    STOP = 10  # the process is to end
    RAMP_DOWN = 11  # a limit whose action is to ramp the tension down
    LOWER = 12  # the motor lowers a load that the brake does not hold
    UNTESTED = 13  # ramp over on a brake that is known not to hold: it is to be tested first
    PAY_OUT = 14  # a slack rope is made longer
    RAMP_ENDS = 15  # of a ramp to slack with a fault latched: slack, a hold, or the process is to end

    @property
    def words(self) -> str:
        """In the events."""
        return _EVENT_WORDS[self]


_EVENT_WORDS: dict[Event, str] = {
    Event.ENABLED: "drive enabled",
    Event.TENSION: "tension commanded",
    Event.TENSIONED: "target reached",
    Event.RELEASE: "release commanded",
    Event.SLACK: "rope slack",
    Event.HOLD: "hold commanded",
    Event.DISARM: "disarm commanded",
    Event.TRIP: "trip",
    Event.RESET_HELD: "reset, armed before",
    Event.RESET_OFF: "reset, not armed before",
    Event.STOP: "daemon stopping",
    Event.RAMP_DOWN: "ramp down",
    Event.UNTESTED: "target reached; rigctl brake-test comes first, the brake is known not to hold",
    Event.PAY_OUT: "release of a slack rope commanded",
    Event.RAMP_ENDS: "the ramp to slack has ended, the fault is still latched",
    Event.LOWER: "the motor lowers the load, the brake does not hold it",
}


class Witness(IntEnum):
    """What shows the motion of a load that the motor carries because its brake does not hold it."""

    BOTH = 0  # encoder and cell agree, or an operator has named neither
    ENCODER = 1
    CELL = 2


class EndStep(IntEnum):
    """How far an end is that the load delays; the number is in the record of the event."""

    WAITS = 1
    LOWERS = 2
    LOWERED = 3
    LEFT = 4  # by a second request
    GONE = 5  # the motor has the load no more, and the rope is not known to be slack
    LATE = 6  # the rope is not slack in time


class EStop(IntFlag):
    """Inputs on which the emergency stop reads as pressed; the value of its trip."""

    DRIVE = 1
    IO_NODE = 2
