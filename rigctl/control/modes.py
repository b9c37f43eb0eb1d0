"""Operator modes as a transition table, and what an operator may ask in which mode. Pure functions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum


class Mode(IntEnum):
    """What the rig is doing."""

    DISARMED = 0  # drive off, brake closed
    HOLD = 1  # drive on, stroke held
    TENSIONING = 2  # bounded ramp to the target
    COMPENSATING = 3  # closed loop on the target
    RELEASING = 4  # bounded ramp to slack
    FAULT = 5  # stroke held, latched


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
    RESET_HELD = 8  # fault acknowledged, drive still on
    RESET_OFF = 9  # fault acknowledged, drive off
    STOP = 10  # the process was told to end


_ALIVE = (Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)

TRANSITIONS: dict[tuple[Mode, Event], Mode] = {
    (Mode.DISARMED, Event.ENABLED): Mode.HOLD,
    (Mode.HOLD, Event.TENSION): Mode.TENSIONING,
    (Mode.HOLD, Event.RELEASE): Mode.RELEASING,
    (Mode.HOLD, Event.DISARM): Mode.DISARMED,
    (Mode.TENSIONING, Event.TENSIONED): Mode.COMPENSATING,
    (Mode.TENSIONING, Event.RELEASE): Mode.RELEASING,
    (Mode.COMPENSATING, Event.RELEASE): Mode.RELEASING,
    (Mode.RELEASING, Event.TENSION): Mode.TENSIONING,
    (Mode.RELEASING, Event.SLACK): Mode.HOLD,
    (Mode.FAULT, Event.RESET_HELD): Mode.HOLD,
    (Mode.FAULT, Event.RESET_OFF): Mode.DISARMED,
    **{(mode, Event.HOLD): Mode.HOLD for mode in _ALIVE},
    **{(mode, Event.STOP): Mode.HOLD for mode in _ALIVE},
    **{(mode, Event.TRIP): Mode.FAULT for mode in Mode},
}


def next_mode(mode: Mode, event: Event) -> Mode:
    """Mode after ``event``; an event that means nothing in ``mode`` changes nothing."""
    return TRANSITIONS.get((mode, event), mode)


class Verb(IntEnum):
    """Commands an operator may give."""

    ARM = 1
    TENSION = 2
    RELEASE = 3
    HOLD = 4
    DISARM = 5
    RESET = 6
    TARGET = 7
    TARE = 8  # these three measure first and answer when they are over, see rigctl.control.trials
    CALIBRATE = 9
    IDENTIFY = 10


class Setting(IntEnum):
    """What the gateway sets once it is on record; on the same ring as the verbs, but no operator's to give."""

    ZERO = 128  # value: N
    SCALE = 129  # value: factor
    OVERDUE = 130  # value: 1 the calibration is overdue, 0 it is not
    K_TENSION = 131  # these three come in this order, the last puts all in force; see rigctl.control.tension.Gains
    K_SPEED = 132
    K_INTEGRAL = 133


class Refusal(IntEnum):
    """Why a command was not carried out."""

    NONE = 0
    WRONG_MODE = 1
    PREFLIGHT = 2  # the reply's ``checks`` say which
    OUT_OF_RANGE = 3
    CAUSE_PRESENT = 4  # the fault's cause is still there
    ALREADY = 5
    EXPIRED = 6
    UNKNOWN = 7
    STOPPING = 8
    DRIVE_TIMEOUT = 9  # the drive did not follow
    ABORTED = 10  # a command, a trip or a change of mode came in between
    LOADED = 11  # the rope is not unloaded
    UNSTEADY = 12  # it moves, or the reading does
    NO_SAMPLES = 13  # the cell gives no good samples
    SLACK = 14  # there is nothing to be found on a slack rope
    STRAYED = 15  # tension or stroke left the bounds of the excitation


@dataclass(frozen=True)
class Situation:
    """What a decision depends on, beside the mode."""

    failed_checks: int = 0  # preflight, bits of safety.Check
    cause_present: bool = False  # the latched fault's cause
    drive_enabled: bool = False
    drive_faulted: bool = False
    slack: bool = False
    unloaded: bool = False  # the cell reads no more than a tare may take away
    target_min_n: float = 0.0
    target_max_n: float = 0.0


@dataclass(frozen=True)
class Decision:
    """Answer to a command: refused, or accepted with the event it causes (None: no change of mode)."""

    refusal: Refusal = Refusal.NONE
    event: Event | None = None


_EVENT_OF = {Verb.TENSION: Event.TENSION, Verb.RELEASE: Event.RELEASE, Verb.HOLD: Event.HOLD}
TRIED_IN = {
    Verb.TARE: (Mode.DISARMED, Mode.HOLD),
    Verb.CALIBRATE: (Mode.DISARMED, Mode.HOLD),
    Verb.IDENTIFY: (Mode.HOLD,),
}
_ALREADY = {
    (Mode.TENSIONING, Verb.TENSION),
    (Mode.COMPENSATING, Verb.TENSION),
    (Mode.RELEASING, Verb.RELEASE),
    (Mode.DISARMED, Verb.DISARM),
}


def _unfit(verb: Verb, value: float, situation: Situation) -> Refusal:
    """What a trial needs of the rope."""
    if verb is Verb.TARE and not situation.unloaded:
        return Refusal.LOADED
    return Refusal.SLACK if verb is Verb.IDENTIFY and value and situation.slack else Refusal.NONE


def decide(mode: Mode, verb: Verb, value: float, situation: Situation) -> Decision:
    """What a command does in a mode. ARM and DISARM without an event are carried out by the drive first."""
    if (mode, verb) in _ALREADY:
        return Decision(Refusal.ALREADY)
    match verb:
        case Verb.TARGET:
            inside = math.isfinite(value) and situation.target_min_n <= value <= situation.target_max_n
            return Decision() if inside else Decision(Refusal.OUT_OF_RANGE)
        case Verb.ARM if mode is Mode.DISARMED:
            return Decision(Refusal.PREFLIGHT) if situation.failed_checks else Decision()
        case Verb.ARM if mode is not Mode.FAULT:
            return Decision(Refusal.ALREADY)
        case Verb.RESET if mode is Mode.FAULT:
            if situation.cause_present:
                return Decision(Refusal.CAUSE_PRESENT)
            return Decision(event=Event.RESET_HELD if situation.drive_enabled else Event.RESET_OFF)
        case Verb.RESET if mode is Mode.DISARMED and situation.drive_faulted:
            # The drive's own fault, from before this daemon; one that is not seen now cannot be cleared.
            return Decision(Refusal.CAUSE_PRESENT) if situation.cause_present else Decision()
        case Verb.TARE | Verb.CALIBRATE | Verb.IDENTIFY if mode in TRIED_IN[verb]:
            return Decision(_unfit(verb, value, situation))
        case Verb.RELEASE if mode is Mode.HOLD and situation.slack:
            return Decision(Refusal.ALREADY)
        case Verb.DISARM if mode is Mode.FAULT:
            return Decision()  # power off, brake closed; the fault stays latched
        case Verb.DISARM if mode is Mode.HOLD:
            return Decision(event=Event.DISARM)
    event = _EVENT_OF.get(verb)
    if event is not None and (mode, event) in TRANSITIONS:
        return Decision(event=event)
    return Decision(Refusal.WRONG_MODE)
