"""Operator modes as a transition table, and the commands allowed in each mode. Pure functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple

from rigctl.control.checks import HOST_CHECKS, Check
from rigctl.control.homed import TOLERANCE_MM
from rigctl.control.situation import Situation, Witness
from rigctl.ipc.record import COMMAND


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


class HeldBy(IntEnum):
    """What carries the load; the first in a mode that moves the stroke."""

    NOTHING = 0
    MOTOR = 1  # IEC 61800-5-2: SOS, safe operating stop
    CLOSING = 2  # the drive stops, closes its brake and goes off; the load is not seen at rest yet
    BRAKE = 3  # SBC, safe brake control: the drive is off, its brake closed, and the load is at rest
    TAKING = 4  # the drive is being switched on, the motor takes the load from the brake
    UNKNOWN = 5  # the drive does not report its state, or the load is not seen at rest on the closed brake


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


class Verb(IntEnum):
    """Commands an operator may give."""

    ARM = 1
    TENSION = 2
    RELEASE = 3
    HOLD = 4
    DISARM = 5
    RESET = 6
    TARGET = 7
    TARE = 8  # TARE, CALIBRATE and IDENTIFY measure first and answer at their end, see rigctl.control.trials
    CALIBRATE = 9
    IDENTIFY = 10
    GAINS = 11  # the new gains follow as LAW_GAINS, once their margins have been judged
    CONFIRM_STROKE = 12  # the measured stroke agrees with the drive's position
    RESPONSE = 13  # frequency response by a multisine; a trial, as IDENTIFY
    MOVE = 14  # a move of the mechanism begins, or the one under way has ended
    CARRY = 15  # the motor holds a load that the brake does not hold
    LOWER = 16  # the motor lowers such a load until the rope is slack
    BRAKE_TEST = 17  # the brake has the load for 10 s, then the motor again


class Setting(IntEnum):
    """Settings the gateway sends once they are on record; on the ring of the verbs, but not for operators."""

    ZERO = 128
    SCALE = 129
    OVERDUE = 130
    HOST_CHECKS = 134  # sent before every ARM; 131 to 133 had other meanings
    LAW_GAINS = 135
    MARGINS = 140  # the loop's sensitivity peak as measured while COMPENSATING
    CREEP = 144
    DIFFERS = 145  # |S| as measured and the nearest that the design's family has, where the two differ


VALUES: dict[int, tuple[str, ...]] = {
    Verb.ARM: ("near_end",),
    Verb.RELEASE: ("length_mm",),
    Verb.TARGET: ("target_n",),
    Verb.CALIBRATE: ("weight_n", "creep_s"),
    Verb.IDENTIFY: ("tight",),
    Verb.CONFIRM_STROKE: ("stroke_mm",),
    Verb.RESPONSE: ("regulated",),
    Verb.MOVE: ("move",),
    Verb.CARRY: ("carry_s", "by"),
    Verb.LOWER: ("by",),
    Setting.ZERO: ("zero_n", "zero_c", "zero_n_k", "second_zero_n"),
    Setting.SCALE: ("scale", "overdue", "second_scale"),
    Setting.OVERDUE: ("overdue",),
    Setting.HOST_CHECKS: ("host_checks",),
    Setting.LAW_GAINS: ("k_tension", "k_speed", "k_integral"),
    Setting.MARGINS: ("sensitivity_peak", "sensitivity_peak_error"),
    Setting.DIFFERS: ("sensitivity_peak", "sensitivity_peak_error"),
    Setting.CREEP: ("creep_1", "creep_1_s", "creep_2", "creep_2_s", "creep_held_s"),
}
"""Fields of a ``COMMAND`` slot that a command or setting uses, beside time and id."""


class SettingOrder(NamedTuple):
    """A setting with the values for its fields, in the order of `VALUES`."""

    setting: Setting
    values: tuple[float, ...]


def command_slot(t_ns: int, id_: int, code: int, *values: float) -> tuple[Any, ...]:
    """A ``COMMAND`` slot for its ring; ``values`` in the order of `VALUES`, those that ``code`` does not use drop."""
    return COMMAND.values(t_ns=t_ns, id=id_, verb=code, **dict(zip(VALUES.get(code, ()), values, strict=False)))


class Refusal(IntEnum):
    """Why a command was not carried out."""

    NONE = 0
    WRONG_MODE = 1
    PREFLIGHT = 2  # the reply's ``checks`` name the failures
    OUT_OF_RANGE = 3
    CAUSE_PRESENT = 4  # the fault's cause is still present
    ALREADY = 5
    EXPIRED = 6
    UNKNOWN = 7
    STOPPING = 8
    DRIVE_TIMEOUT = 9  # the drive did not follow
    ABORTED = 10  # a command, a trip or a change of mode came in between
    LOADED = 11  # the rope is not unloaded
    UNSTEADY = 12  # the stroke moves, or the reading does
    NO_SAMPLES = 13  # the cell gives no good samples
    SLACK = 14  # a slack rope shows nothing to identify
    STRAYED = 15  # tension or stroke left the bounds of the excitation
    FAULT_LATCHED = 16  # a limit ramps the tension down; only HOLD stops that
    NO_STEP = 30  # neither was a weight hung on the cell nor taken off it
    STROKE_DIFFERS = 19  # the measured stroke is not the drive's position
    STOP_RUNNING = 21  # the drive is still stopping, or its brake is closing
    BRAKE_SLIPPED = 22  # the brake did not hold the load while the drive was off; value: mm
    UNFELT = 23  # the cell does not show the motion of the stroke
    NO_LEARNING = 24  # the rig file has no section learning
    CARRIED = 100  # the motor carries a load that the brake does not hold; value: time left in s
    DRIVE_STATE = 102  # the drive has not left its fault state; value: its state, see DriveState
    OFF_UNSEEN = 103  # the drive was commanded off, and has not been seen to be; value: its state
    TIGHT = 104  # a length is paid out on a slack rope only
    NO_BRAKE = 106  # the rig file has none to test
    LITTLE_LOAD = 105  # too little for a brake test to show anything; value: load that it needs in N
    SUNK = 107  # each ARM of a tight rope had the load sink, and it is no motion on purpose; value: by how much in mm
    DISAGREE = 101  # encoder and tension do not show the same motion; value: difference in mm


# -- guards: the refusal of a transition or command whose condition does not hold -----------------------------------
Guard = Callable[[Situation], Refusal]


SUNK_MM = 0.9
"""By ARMs alone: two that let a load roll back by the limit of DRIVE_NOT_FOLLOWING."""


def preflight_passed(situation: Situation) -> Refusal:
    """No preflight check fails, and the load has not sunk by ARMs that went before."""
    if barring(Verb.ARM, situation):
        return Refusal.PREFLIGHT
    return Refusal.SUNK if situation.sunk_mm > SUNK_MM else Refusal.NONE


def cause_gone(situation: Situation) -> Refusal:
    """No cause of the latched fault is active, the stop it began has ended, and the motor does not carry the load."""
    # A reset during the stop would also cancel the power off that follows if the drive does not obey.
    if situation.causes:
        return Refusal.CAUSE_PRESENT
    if situation.carried_s:  # the brake would have to hold again: lower, or disarm to try it
        return Refusal.CARRIED
    return Refusal.STOP_RUNNING if situation.stop_running else Refusal.NONE


def rope_tight(situation: Situation) -> Refusal:
    """The rope is tight, so that there is tension to release."""
    return Refusal.ALREADY if situation.slack else Refusal.NONE


def length_payable(situation: Situation) -> Refusal:
    """The rope is slack, and the length leaves the cylinder inside its stroke."""
    if not situation.slack:
        return Refusal.TIGHT
    return Refusal.NONE if 0.0 < situation.length_mm <= situation.room_mm else Refusal.OUT_OF_RANGE


def brake_testable(situation: Situation) -> Refusal:
    """There is a brake, the rope is tight, the stroke at rest, and the load enough for the test to show something."""
    if situation.no_brake:
        return Refusal.NO_BRAKE
    if situation.slack:
        return Refusal.SLACK
    if not situation.at_rest:
        return Refusal.UNSTEADY
    return Refusal.LITTLE_LOAD if situation.needed_n else Refusal.NONE


def motor_carries(situation: Situation) -> Refusal:
    """The motor carries the load by `carry`, and the rope is tight."""
    return rope_tight(situation) if situation.carried_s else Refusal.WRONG_MODE


def no_fault_latched(situation: Situation) -> Refusal:
    """No fault is latched: only a hold ends the ramp down that a limit began."""
    return Refusal.FAULT_LATCHED if situation.fault else Refusal.NONE


def target_in_bounds(situation: Situation) -> Refusal:
    """The target is between tension.target_min_n and target_max_n."""
    inside = situation.target_min_n <= situation.wanted_n <= situation.target_max_n
    return Refusal.NONE if inside else Refusal.OUT_OF_RANGE


def move_known(situation: Situation) -> Refusal:
    """The rig learns from moves, and the number is one of them, or 0."""
    if not situation.moves:
        return Refusal.NO_LEARNING
    known = situation.move.is_integer() and 0 <= situation.move <= situation.moves
    return Refusal.NONE if known else Refusal.OUT_OF_RANGE


def rope_unloaded(situation: Situation) -> Refusal:
    """The cell reads no more than a tare may take away."""
    return Refusal.NONE if situation.unloaded else Refusal.LOADED


def rope_tight_if_needed(situation: Situation) -> Refusal:
    """The rope is tight, or the identification does not need it to be."""
    return Refusal.SLACK if situation.needs_tight and situation.slack else Refusal.NONE


def held_response(situation: Situation) -> Refusal:
    """The rope is tight, and the response is not requested for COMPENSATING only."""
    if situation.regulated == 1.0:
        return Refusal.WRONG_MODE
    return Refusal.SLACK if situation.slack else Refusal.NONE


def regulated_response(situation: Situation) -> Refusal:
    """The response is not requested for HOLD only."""
    return Refusal.WRONG_MODE if situation.regulated == 0.0 else Refusal.NONE


def stroke_as_measured(situation: Situation) -> Refusal:
    """The drive's position is the stroke that the operator has measured."""
    agrees = abs(situation.measured_mm - situation.stroke_mm) <= TOLERANCE_MM
    return Refusal.NONE if agrees else Refusal.STROKE_DIFFERS


def motor_may_carry(situation: Situation) -> Refusal:
    """No emergency stop is pressed, the rope is tight, the time is 1 s to 1 h, a witness is named or both agree."""
    if situation.e_stop:
        return Refusal.CAUSE_PRESENT
    if situation.slack_by_all:
        return Refusal.SLACK
    if not CARRY_S[0] <= situation.carry_s <= CARRY_S[1]:
        return Refusal.OUT_OF_RANGE
    return witness_known(situation)


def motor_may_lower(situation: Situation) -> Refusal:
    """The rope is tight; after a brake or motor that did not hold, a witness is named or both agree."""
    if situation.slack_by_all:
        return Refusal.ALREADY
    if situation.by not in _WITNESSES:
        return Refusal.OUT_OF_RANGE
    return witness_known(situation) if situation.brake_fails or situation.strays else Refusal.NONE


def witness_known(situation: Situation) -> Refusal:
    """The drive is fit to carry, and the operator has named a witness, or encoder and tension agree."""
    if situation.drive_unfit:
        return Refusal.DRIVE_STATE
    if situation.by not in _WITNESSES:
        return Refusal.OUT_OF_RANGE
    return Refusal.DISAGREE if situation.apart_mm and situation.by == Witness.BOTH else Refusal.NONE


def brake_fails_to_carry(situation: Situation) -> Refusal:
    """The brake is known not to hold, and the motor may carry."""
    return motor_may_carry(situation) if situation.brake_fails else Refusal.WRONG_MODE


def brake_fails_to_lower(situation: Situation) -> Refusal:
    """The brake is known not to hold, and the motor may lower."""
    return motor_may_lower(situation) if situation.brake_fails else Refusal.WRONG_MODE


def drive_at_fault(situation: Situation) -> Refusal:
    """The drive reports a fault of its own, from before this daemon, that a reset can clear."""
    if not situation.drive_faulted:
        return Refusal.WRONG_MODE
    return cause_gone(situation)


@dataclass(frozen=True)
class Transition:
    """The mode an event leads to, if its guard allows it."""

    after: Mode
    guard: Guard | None = None


CARRY_S = 1.0, 3600.0
"""Shortest and longest time of a CARRY."""
_WITNESSES = frozenset(map(float, Witness))
_MAY_MOVE = tuple(mode for mode in Mode if mode.may_move)

TRANSITIONS: dict[tuple[Mode, Event], Transition] = {
    (Mode.DISARMED, Event.ENABLED): Transition(Mode.HOLD, preflight_passed),
    (Mode.HOLD, Event.TENSION): Transition(Mode.TENSIONING),
    (Mode.HOLD, Event.RELEASE): Transition(Mode.RELEASING, rope_tight),
    (Mode.HOLD, Event.DISARM): Transition(Mode.DISARMED),
    (Mode.HOLD, Event.PAY_OUT): Transition(Mode.RELEASING, length_payable),
    (Mode.TENSIONING, Event.TENSIONED): Transition(Mode.COMPENSATING),
    (Mode.TENSIONING, Event.UNTESTED): Transition(Mode.HOLD),
    (Mode.TENSIONING, Event.RELEASE): Transition(Mode.RELEASING),
    (Mode.COMPENSATING, Event.RELEASE): Transition(Mode.RELEASING),
    (Mode.RELEASING, Event.TENSION): Transition(Mode.TENSIONING, no_fault_latched),
    (Mode.RELEASING, Event.SLACK): Transition(Mode.HOLD, no_fault_latched),
    (Mode.FAULT, Event.RESET_HELD): Transition(Mode.HOLD, cause_gone),
    (Mode.FAULT, Event.RESET_OFF): Transition(Mode.DISARMED, cause_gone),
    (Mode.FAULT, Event.LOWER): Transition(Mode.RELEASING, motor_may_lower),
    (Mode.FAULT, Event.RELEASE): Transition(Mode.RELEASING, motor_carries),
    **{(mode, Event.RAMP_DOWN): Transition(Mode.RELEASING) for mode in _MAY_MOVE if mode is not Mode.RELEASING},
    **{(mode, Event.HOLD): Transition(Mode.HOLD, no_fault_latched) for mode in _MAY_MOVE},
    **{(mode, Event.STOP): Transition(Mode.HOLD, no_fault_latched) for mode in _MAY_MOVE},
    (Mode.RELEASING, Event.RAMP_ENDS): Transition(Mode.FAULT),
    **{(mode, Event.TRIP): Transition(Mode.FAULT) for mode in Mode},
}
"""RELEASING with a fault latched is a ramp down, which always ends in FAULT: by slack, hold, stop or a trip."""


def next_mode(mode: Mode, event: Event) -> Mode:
    """Mode after ``event``; an event without a transition in ``mode`` changes nothing."""
    transition = TRANSITIONS.get((mode, event))
    return mode if transition is None else transition.after


@dataclass(frozen=True)
class Decision:
    """Answer to a command: refused, or accepted with the event it causes (None: no change of mode)."""

    refusal: Refusal = Refusal.NONE
    event: Event | None = None
    ends: bool = False
    """The command ends what is under way, and does no more."""


TRIED_IN = {
    Verb.TARE: (Mode.DISARMED, Mode.HOLD),
    Verb.CALIBRATE: (Mode.DISARMED, Mode.HOLD),
    Verb.IDENTIFY: (Mode.HOLD,),
    Verb.RESPONSE: (Mode.HOLD, Mode.COMPENSATING),
}
FILED = frozenset({*TRIED_IN, Verb.GAINS})  # their results are put on record before they take effect

_TRIAL_GUARD: dict[Verb, Guard] = {Verb.TARE: rope_unloaded, Verb.IDENTIFY: rope_tight_if_needed}

WITHOUT_EVENT: dict[tuple[Mode, Verb], Guard | None] = {
    (Mode.DISARMED, Verb.ARM): preflight_passed,  # no event yet: ENABLED follows from the drive
    (Mode.DISARMED, Verb.RESET): drive_at_fault,
    **{(mode, Verb.CONFIRM_STROKE): stroke_as_measured for mode in (Mode.DISARMED, Mode.FAULT)},
    (Mode.COMPENSATING, Verb.MOVE): move_known,
    (Mode.FAULT, Verb.DISARM): None,  # power off, brake closed; the fault stays latched
    (Mode.FAULT, Verb.CARRY): motor_may_carry,
    **{(mode, Verb.CARRY): brake_fails_to_carry for mode in (Mode.DISARMED, Mode.HOLD)},  # BRAKE_SLIPS is latched first
    **{(mode, Verb.LOWER): brake_fails_to_lower for mode in (Mode.DISARMED, Mode.HOLD)},
    (Mode.HOLD, Verb.BRAKE_TEST): brake_testable,
    **{(mode, Verb.TARGET): target_in_bounds for mode in Mode},
    **{(mode, Verb.GAINS): None for mode in Mode},
    **{(mode, verb): _TRIAL_GUARD.get(verb) for verb, modes in TRIED_IN.items() for mode in modes},
    (Mode.HOLD, Verb.RESPONSE): held_response,
    (Mode.COMPENSATING, Verb.RESPONSE): regulated_response,
}
"""Commands that change no mode, or not at once, with their guards."""

WHILE_DISARMING = frozenset({Verb.TARGET, Verb.GAINS, Verb.DISARM})
"""Commands that leave a DISARM under way as it is."""
NEEDS_MOTOR = frozenset(
    {Verb.TENSION, Verb.RELEASE, Verb.IDENTIFY, Verb.RESPONSE, Verb.CARRY, Verb.LOWER, Verb.BRAKE_TEST}
)
"""With the load on the brake, these first have the motor take it back."""
ENDS_PENDING = frozenset({Verb.ARM, Verb.DISARM, Verb.HOLD, Verb.RESET, *NEEDS_MOTOR})
"""Accepted, these end a command that waits for the drive or for its read-back."""
CARRIES = frozenset({Verb.CARRY, Verb.LOWER})
"""Commands for a load that the brake does not hold."""

AT_ARM_ONLY = HOST_CHECKS | Check.CALIBRATION | Check.STROKE_NEAR_END | Check.SECOND_FORCE
"""Checks that bar no way out of a parked HOLD or a FAULT: what they guard against ends no move that is under way."""
_BARS_CARRY = Check.E_STOP | Check.E_STOP_IO | Check.DRIVE_STALE | Check.RIVAL
"""Checks that bar a motor from carrying a load that its brake does not hold; all else concerns other motion."""
_BY_CELL = Check.CELL_STALE | Check.CELL_INVALID | Check.CELL_IMPLAUSIBLE
"""... and those that bar it where the cell alone is to show the load."""


def bars_carry(by: Witness) -> Check:
    """Checks that bar moving a load that the brake does not hold by a witness."""
    bars = _BARS_CARRY if by is Witness.ENCODER else _BARS_CARRY | Check.TENSION_HIGH
    return bars | _BY_CELL if by is Witness.CELL else bars


_EVENT_OF = {
    Verb.TENSION: Event.TENSION,
    Verb.RELEASE: Event.RELEASE,
    Verb.HOLD: Event.HOLD,
    Verb.DISARM: Event.DISARM,
    Verb.LOWER: Event.LOWER,
}
_ALREADY = {
    (Mode.TENSIONING, Verb.TENSION),
    (Mode.COMPENSATING, Verb.TENSION),
    (Mode.RELEASING, Verb.RELEASE),
    (Mode.DISARMED, Verb.DISARM),
    *((mode, Verb.ARM) for mode in _MAY_MOVE),
}


def answer(mode: Mode, verb: Verb, situation: Situation) -> Decision:
    """What a command does now: what is under way comes first, then the mode, then the checks of a motor that starts."""
    if situation.ends:
        return Decision(Refusal.STOPPING)
    if situation.silent and verb is Verb.RESET:
        return Decision(Refusal.NONE if situation.left_alone else Refusal.STOP_RUNNING)
    if situation.silent and verb in NEEDS_MOTOR:
        return Decision(Refusal.WRONG_MODE)
    if verb == situation.pending or (situation.disarming and verb is Verb.DISARM):
        return Decision(Refusal.ALREADY)
    if situation.pending == Verb.ARM and verb in TRIED_IN:
        return Decision(Refusal.WRONG_MODE)
    stops = verb is Verb.HOLD or (verb is Verb.DISARM and mode is Mode.DISARMED)
    if stops and (situation.pending or (situation.tries and mode is Mode.DISARMED)):
        return Decision(ends=True)  # the load stays on the brake
    decision = decide(mode, verb, situation)
    starts = verb is Verb.BRAKE_TEST or (verb in NEEDS_MOTOR and not situation.powered)
    if decision.refusal is Refusal.NONE and starts and barring(verb, situation):
        return Decision(Refusal.PREFLIGHT)
    return decision


def barring(verb: Verb, situation: Situation) -> int:
    """The checks that fail of those that a command must pass which needs the motor."""
    if verb is Verb.ARM:
        return situation.failed_checks & ~(int(Check.DRIVE_SUPERVISION) if situation.read_at_arm else 0)
    if verb in CARRIES and (situation.brake_fails or situation.by):
        return situation.failed_checks & int(bars_carry(Witness(int(situation.by) or situation.witness)))
    later = AT_ARM_ONLY | Check.DRIVE_SUPERVISION if situation.read_at_motor and verb not in CARRIES else AT_ARM_ONLY
    return situation.failed_checks & ~int(later)


def decide(mode: Mode, verb: Verb, situation: Situation) -> Decision:
    """What a command does in a mode where nothing else is under way.

    ARM and DISARM without an event take effect through the drive first.

    A reset of a drive's own fault ends in DISARMED, so that a whole arming follows.
    """
    if (mode, verb) in _ALREADY:
        return Decision(Refusal.ALREADY)
    if (mode, verb) in WITHOUT_EVENT:
        return _guarded(WITHOUT_EVENT[mode, verb], None, situation)
    event = _EVENT_OF.get(verb)
    if verb is Verb.RELEASE and situation.length_mm:
        event = Event.PAY_OUT
    if verb is Verb.RESET:
        event = Event.RESET_HELD if situation.armed and not situation.drive_faulted else Event.RESET_OFF
    if event is Event.HOLD and mode is Mode.RELEASING and situation.fault:
        return Decision(event=Event.RAMP_ENDS)
    if event is None or (mode, event) not in TRANSITIONS:
        return Decision(Refusal.WRONG_MODE)
    return _guarded(TRANSITIONS[mode, event].guard, event, situation)


def _guarded(guard: Guard | None, event: Event | None, situation: Situation) -> Decision:
    refusal = Refusal.NONE if guard is None else guard(situation)
    return Decision(event=event) if refusal is Refusal.NONE else Decision(refusal)
