"""What the rig does about a cause, and the signs that it has not helped."""

from __future__ import annotations

from enum import IntEnum


class Action(IntEnum):
    """Reaction of a row, the weakest first. All but LOG latch a fault."""

    LOG = 0  # write an event
    RAMP_DOWN = 1  # lower the tension on its ramp until the rope is slack, then hold
    HOLD = 2  # stop the stroke under power; at standstill the brake takes the load
    QUICK_STOP = 3  # the drive stops on its own ramp, then power off with the brake closed
    POWER_OFF = 4  # the same, but power is cut and the brake closes even if the drive has not stopped in its time
    SILENCE = 5  # NMT stop, then neither command nor heartbeat: the drive stops by its own supervision

    @property
    def words(self) -> str:
        """In the event of a trip; a HOLD, the usual one, is not named."""
        return _ACTION_WORDS[self]


_ACTION_WORDS: dict[Action, str] = {
    Action.LOG: "logged",
    Action.RAMP_DOWN: "ramping down",
    Action.QUICK_STOP: "quick stop, then power off",
    Action.POWER_OFF: "power off commanded, the brake is to close",
    Action.SILENCE: "power off commanded by SDO, NMT stop, then silence: the drive is to stop by its own supervision",
}


class Symptom(IntEnum):
    """Sign that a reaction did not help; the number is in the event."""

    RAMP_RISES = 1
    RAMP_LATE = 2
    HOLD_RISES = 3
    HOLD_MOVES = 4
    STOP_MOVES = 5
    STOP_DRIFTS = 6
    STOP_STAYS_ON = 7
    OFF_DRIFTS = 8
    HOLD_UNSEEN = 9
    HOLD_BLIND = 10
    STOP_UNANSWERED = 11
    OFF_UNANSWERED = 12
    OFF_STAYS_ON = 13
    SILENCE_MOVES = 14

    @property
    def words(self) -> str:
        """In the events: ``{0}`` value, ``{1}`` limit, ``{secure}`` what to do about a drive that may have power."""
        return _SYMPTOM_WORDS[self]


_SILENT = (
    "it is stopped by NMT and gets neither command nor heartbeat any more, so that its own supervision stops it; look "
    "at drive and bus, then reset: all devices are started up again"
)
_SYMPTOM_WORDS: dict[Symptom, str] = {
    Symptom.RAMP_RISES: "the tension has risen by {0:.1f} N since the ramp down began (limit {1:.1f} N); the stroke is "
    "held",
    Symptom.RAMP_LATE: "the rope is not slack {0:.1f} s after the ramp down should have ended (limit {1:.1f} s); the "
    "stroke is held",
    Symptom.HOLD_RISES: "the tension is above its limit and has risen by {0:.1f} N while the stroke was held (limit "
    "{1:.1f} N); quick stop, then power off",
    Symptom.HOLD_MOVES: "the stroke moves at {0:.2f} mm/s though it is held (limit {1:.2f} mm/s); quick stop, then "
    "power off",
    Symptom.HOLD_UNSEEN: "nothing has been heard of the drive for {0:.1f} s (limit {1:.1f} s): its stroke may creep; "
    "quick stop, then power off",
    Symptom.HOLD_BLIND: "nothing is heard of the drive, and its stroke may have moved {0:.2f} mm since (limit {1:.2f} "
    "mm); quick stop, then power off",
    Symptom.STOP_MOVES: "the stroke still moves at {0:.2f} mm/s after the quick stop (limit {1:.2f} mm/s); power off",
    Symptom.STOP_DRIFTS: "the stroke has moved {0:.2f} mm after the quick stop (limit {1:.2f} mm); power off",
    Symptom.STOP_STAYS_ON: "the drive is not seen to have gone off after the quick stop; power off",
    Symptom.STOP_UNANSWERED: f"the drive has not answered the quick stop; {_SILENT}",
    Symptom.OFF_UNANSWERED: f"the drive has not answered; {_SILENT}",
    Symptom.OFF_STAYS_ON: f"the drive is not seen to have gone off though its power was cut; {_SILENT}",
    Symptom.OFF_DRIFTS: "the stroke has moved {0:.2f} mm with the power off (limit {1:.2f} mm): the brake does not "
    "hold; secure the load, rigctl carry has the motor hold it, rigctl lower lowers it",
    Symptom.SILENCE_MOVES: "the tension has changed by {0:.1f} N (limit {1:.1f} N) with the drive left to its own "
    "supervision: it is still powered, its brake slips or the payload moves; {secure}",
}
