"""Operator modes as a transition table, and the commands allowed in each mode. Pure functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rigctl.control.commands.situation import Situation
from rigctl.ipc.record import COMMAND
from rigctl.model.checks import HOST_CHECKS, Check
from rigctl.model.states import Event, Mode, Witness
from rigctl.model.verbs import CARRY_S, STROKE_TOLERANCE_MM, TRIED_IN, VALUES, Refusal, Verb, VerbTrait, having


def command_slot(t_ns: int, id_: int, code: int, *values: float) -> tuple[Any, ...]:
    """A ``COMMAND`` slot for its ring; ``values`` in the order of `VALUES`, those that ``code`` does not use drop."""
    return COMMAND.values(t_ns=t_ns, id=id_, verb=code, **dict(zip(VALUES.get(code, ()), values, strict=False)))


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
    agrees = abs(situation.measured_mm - situation.stroke_mm) <= STROKE_TOLERANCE_MM
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


_GUARDS: dict[str, Guard] = {
    guard.__name__: guard
    for guard in (
        preflight_passed, drive_at_fault, target_in_bounds, move_known, rope_unloaded, rope_tight_if_needed,
        held_response, regulated_response, stroke_as_measured, motor_may_carry, brake_fails_to_carry,
        brake_fails_to_lower, brake_testable,
    )
}  # fmt: skip
"""By the names that the rows of commands have."""
_WITNESSES = frozenset(map(float, Witness))
_MAY_MOVE = tuple(mode for mode in Mode if mode.may_move)

TRANSITIONS: dict[tuple[Mode, Event], Transition] = {
    (Mode.DISARMED, Event.ENABLED): Transition(Mode.HOLD, preflight_passed),
    (Mode.HOLD, Event.TENSION): Transition(Mode.TENSIONING),
    (Mode.HOLD, Event.RELEASE): Transition(Mode.RELEASING, rope_tight),
    (Mode.HOLD, Event.LOWER): Transition(Mode.RELEASING),
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


FILED = having(VerbTrait.FILED)
WITHOUT_EVENT: dict[tuple[Mode, Verb], Guard | None] = {
    (mode, verb): _GUARDS[name] if name else None for verb in Verb for mode, name in verb.row.modes.items()
}
"""Commands that change no mode, or not at once, with their guards."""
WHILE_DISARMING, CARRIES = having(VerbTrait.LEAVES_DISARM), having(VerbTrait.CARRIES)
NEEDS_MOTOR = having(VerbTrait.MOTOR)
ENDS_PENDING = having(VerbTrait.ENDS_OTHERS) | NEEDS_MOTOR

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
_ALREADY = {(mode, verb) for verb in Verb for mode in verb.row.already}


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
    if situation.pending and verb in TRIED_IN and verb not in ENDS_PENDING:  # it would be answered by the other's end
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
