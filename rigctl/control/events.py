"""Events are numbers in the loop and words for people: the loop writes ``EVENT`` slots, the gateway words them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from rigctl.config.quantity import Number, count, significant
from rigctl.control.ending import EndStep
from rigctl.control.escalation import Symptom
from rigctl.control.homed import TOLERANCE_MM
from rigctl.control.modes import CARRY_S, TRIED_IN
from rigctl.control.safety import LINGERS, MOVES_OFF, POSITION, RUNAWAY, SPEED, STROKE_SPARE_MM, Action
from rigctl.control.situation import Witness
from rigctl.control.snapshot import EStop
from rigctl.control.stage import OFF_LIMIT_NS
from rigctl.devices import can_errors, emergency
from rigctl.devices.objects import STATUSWORD, DriveState
from rigctl.ipc.record import NEVER_AGE_NS
from rigctl.model.checks import Check
from rigctl.model.faults import Fault, Trait, faults_of
from rigctl.model.signals import WATCHED
from rigctl.model.states import Event, HeldBy, LoadAtRest, Mode, PowerOff
from rigctl.model.verbs import Refusal, Verb


class Kind(IntEnum):
    """Kind of an event; the comment gives the meaning of ``a``, ``b``, ``value`` and ``limit``."""

    MODE = 1  # a: from, b: to, value: event, limit: safe frames sent before it
    TRIP = 2  # a: fault, b: action, value, limit, text: the signal, for a limit of the rig file
    RESET = 3  # a: fault acknowledged
    EMERGENCY = 4  # a: node, b: emergency code | error register << 16 (CiA 301), text: manufacturer's bytes, hex
    NODE_STATE = 5  # a: node, b: NMT state
    EXCEPTION = 6  # text: exception and place
    BUS_ERROR = 7  # a: error class bits of the frame's id, b: see rigctl.devices.can_errors.details
    SEND_FAILED = 8  # text: why
    STARTED = 9  # loop running; a, b: slots in the rings of commands and holds from before it
    STOPPED = 10  # loop ended, value: stroke, limit: tension
    CLOCK = 11  # a: ticks skipped at once
    CORRECTION = 12  # value: zero of the tension cell in N, limit: its scale
    GAINS = 14  # text: K_T, K_v, K_i now in force
    LIMIT = 15  # a: fault, b: action (LOG), value, limit, text: a limit of the rig file is exceeded
    LIMIT_OVER = 16  # as LIMIT: the limit is kept again; value NaN: it is not watched any more, or has no value
    RECEIVE_FAILED = 17  # text: why
    STROKE_LEFT = 40  # a: mode, value: stroke from where it was latched in mm, limit: excursion that is reported
    DRIVE_CREEPS = 41  # value: speed in mm/s at which the drive creeps when commanded 0, limit: creep that is reported
    ESCALATION = 42  # a: fault, b: symptom, see rigctl.control.escalation, value, limit: its reaction did not help;
    # text: where the brake is known not to hold
    CAUSE = 45  # as TRIP: a further cause while a fault is latched
    CAUSE_OVER = 46  # as TRIP: such a cause, or the one that tripped, is gone
    FOREIGN_SDO = 50  # a: node, b: index << 8 | sub-index (0: not known), text: what another master does there
    SETTING_LOST = 51  # a: node, b: index << 8 | sub-index, value: found (NaN: no value), limit: wanted, text: in words
    READ_BACK = 52  # a: objects that were as wanted, value: how long it took in s
    STROKE = 53  # a: 1 the drive's position is believed, 0 not, value: it in mm, limit: last known in mm, text: why
    BRAKE_FLAG = 56  # a: 1 the brake does not hold, b: 1 that is assumed; value: tension, limit: of a test; text: why
    ENDING = 58  # a: see rigctl.control.ending.EndStep, value: WAITS: time until the motor lowers the load, LOWERS: 0,
    # else time since the request, both in s, limit: tension in N
    WITNESS = 57  # a: see rigctl.control.situation.Witness, text: the command; an operator has named it
    BRAKE_TEST = 55  # a: 1 held, 0 not possible on a slack rope, value: stroke moved in mm, limit: tension in N
    LOAD_STEP = 71  # a: samples, b: cell's temperature in mK (0: not known), value: their mean reading in N,
    # limit: their mean time after the load's step in s, negative before it, text: rms of the reading in N
    SECOND_FORCE = 73  # zero and scale of the second force path in force; value: zero in N, limit: scale
    CREEP = 70  # a: 1 the load's history is known, 0 assumed, value: whole share of the load, text: shares, times in s
    MOVE = 80  # a: number of the move that begins, 0: the one under way has ended, b: moves its table was learnt from
    LEARNT = 81  # a: number, b: moves learnt from, value: rms error of this move in N, limit: of the first in N
    NOT_LEARNT = 82  # as LEARNT, text: why the move taught nothing; b 0: its table is dropped
    HELD = 100  # a: from, b: to, see rigctl.model.states.HeldBy; value: longest time in s for which the motor holds,
    # 0: hold.park_s; text: the command that needs it, or the mode
    POWER_OFF = 102  # a: see rigctl.control.power_off.PowerOff, value: time since the command in s,
    # b: 1 the brake is known not to hold
    LOAD_AT_REST = 103  # a: from, b: to, see rigctl.model.states.LoadAtRest, on the closed brake; text: mode
    NO_MARGINS = 101  # a: why, see Unmeasured
    MARGINS_DIFFER = 104  # value: |S| as measured, limit: the nearest that the design's family has
    LOCAL_HOLD = 65  # a: user, b: process it came from, text: operator; its result is in the reply
    HOLD_SOCKET_CLOSED = 66  # a: user, b: process: it sent a descriptor along with a HOLD
    FOUND_AT_START = 121  # a: node, b: index << 8, value: what a former controller left there, limit: as it is now
    START_ANEW = 120  # a: fault acknowledged; the loop ends, the next one starts all devices up
    # a: 1 the stiffness is off and nothing else checks the cell's scale
    SIGNS = 13  # value: stiffness found in the first tensioning in N/mm, limit: the plant's


class Unmeasured(IntEnum):
    """Why a minute of COMPENSATING gave no margins."""

    OTHER = 0
    LIMITED = 1
    SKIPPED = 2
    WEAK = 3
    UNSTEADY = 4


UNMEASURED: dict[int, str] = {
    Unmeasured.OTHER: "the records do not determine them, see the gateway's log",
    Unmeasured.LIMITED: "the limits of speed or acceleration acted in too many periods, so the loop may ring: look at "
    "command_mm_s, and take gains of a lower Ms (rigctl tune, then rigctl gains FILE)",
    Unmeasured.SKIPPED: "the computer had the loop skip ticks in too many periods",
    Unmeasured.WEAK: "the multisine is too weak: a larger margins.probe_n, or rigctl identify --response",
    Unmeasured.UNSTEADY: "the multisine was not at its level for a minute",
}


@dataclass(frozen=True)
class Worded:
    """An event for people: key ending (info, warning, error) and one line."""

    severity: str
    text: str


_SEEN: dict[float, str] = {
    EStop.DRIVE: "drive's input",
    EStop.IO_NODE: "I/O node's input",
    EStop.DRIVE | EStop.IO_NODE: "inputs of drive and I/O node",
}

_EVENT_TEXT: dict[Event, str] = {
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

_MISSED = {
    SPEED: "its speed is off by {0:.2f} mm/s (limit {1:g} mm/s)",
    POSITION: "its position is off by {0:.2f} mm (limit {1:g} mm)",
    RUNAWAY: "its speed is beyond any command by {0:.2f} mm/s (limit {1:g} mm/s), and grows; power off at once",
    MOVES_OFF: "it reports that it is not enabled, and moves at {0:.2f} mm/s (limit {1:g} mm/s); power off at once",
}
_NMT: dict[float, str] = {0: "boot-up", 4: "stopped", 5: "operational", 127: "pre-operational"}


def fault_text(fault: Fault, value: float, limit: float, text: str = "") -> str:
    """One line for a fault; ``text``: the signal of a limit of the rig file."""
    scale, words = 1e-6 if Trait.AGE in fault.traits else 1.0, fault.words
    if Trait.AGE in fault.traits and value > NEVER_AGE_NS:
        words = words.replace("{value:.0f} ms", "as long as the loop has run")
    return words.format(
        value=Number(value * scale),
        limit=Number(limit * scale),
        text=text,
        found=text and f" ({text})",
        unit=_unit_of(text),
        seen=_SEEN.get(value, "input not known"),
        state=_node_words(value, limit),
        missed=_missed_words(value, limit, text),
        not_requested=_not_requested_words(value, limit, text),
        emergency=_emergency_words(value),
    )


def _not_requested_words(value: float, limit: float, text: str) -> str:
    """Of a drive that has power without a command; one that does not show that it has gone off is commanded by none."""
    if text == LINGERS:
        return ""
    speed = f" ({Number(value):.2f} mm/s)" if limit else ""
    return f", and this daemon has not commanded it{speed}: find who commands the drive, withdraw the tool, then reset"


def _emergency_words(value: float) -> str:
    """Node and code of an active emergency: node << 16 | code."""
    node, code = divmod(int(value), 1 << 16) if math.isfinite(value) else (0, 0)
    if not node:
        return "see the events"
    return f"node {node}: 0x{code:04X}, {emergency.code_words(code) if code >> 8 else 'see the events'}"


def _missed_words(value: float, limit: float, text: str) -> str:
    """By how much the drive misses its command; without a limit it is not enabled."""
    if not limit:
        return "it is not enabled"
    # Recordings from before the rows said which have no text.
    return _MISSED.get(text, "its speed or position is off").format(Number(value), Number(limit))


def _node_words(value: float, limit: float) -> str:
    """Time without a heartbeat of a device; its NMT state where ``limit`` is 0."""
    if limit:
        return f"has sent no heartbeat for {Number(value * 1e-6):.0f} ms (limit {Number(limit * 1e-6):.0f} ms)"
    return f"is {_NMT.get(value, 'in an unknown state')}, not operational: start the daemon anew"


def _unit_of(limit: str) -> str:
    """Unit of a limit of the rig file, from its text such as ``tension_n above``."""
    signal, _, words = limit.partition(" ")
    unit = WATCHED[signal].unit if signal in WATCHED else ""
    return f" {unit}{'/s' if 'per second' in words else ''}" if unit else ""


def _trip(a: int, b: int, value: float, limit: float, text: str) -> Worded:
    action = "" if b == Action.HOLD else f"; {_ACTION_TEXT[Action(b)]}"
    return Worded("error", f"trip {Fault(a).name}: {fault_text(Fault(a), value, limit, text)}{action}")


_ACTION_TEXT = {
    Action.LOG: "logged",
    Action.RAMP_DOWN: "ramping down",
    Action.QUICK_STOP: "quick stop, then power off",
    Action.POWER_OFF: "power off commanded, the brake is to close",
    Action.SILENCE: "power off commanded by SDO, NMT stop, then silence: the drive is to stop by its own supervision",
}


def failed_checks(bits: int, known: Mapping[Check, str] = MappingProxyType({})) -> list[str]:
    """Preflight checks that failed, in words; ``known``: details of some of them."""
    return [known.get(check, check.words) for check in Check if bits & check]


def refusal_text(
    refusal: Refusal,
    verb: Verb,
    mode: Mode,
    checks: int,
    fault: Fault,
    limits: tuple[float, float],
    value: float = math.nan,
    known: Mapping[Check, str] = MappingProxyType({}),
    standing: Mapping[Fault, str] = MappingProxyType({}),
) -> str:
    """Why a command was refused, in one line; ``value`` is the reply's, ``known`` as in `failed_checks`.

    ``standing``: causes present now, in words, the strongest first.
    """
    match refusal:
        case Refusal.ALREADY:
            slack = verb is Verb.LOWER or (verb is Verb.RELEASE and mode is Mode.HOLD)
            return "rope is slack already" if slack else f"already {mode.name}"
        case Refusal.PREFLIGHT:
            return "; ".join(failed_checks(checks, known)) + (_SILENT_HINT if checks & _UNSEEN else "")
        case Refusal.LOADED:
            return f"the rope is not unloaded: the cell reads {value:z.2f} N, more than calibration.tare_limit_n"
        case Refusal.OUT_OF_RANGE if verb in _RANGES:
            return _RANGES[verb]
        case Refusal.OUT_OF_RANGE:
            return f"target must be {significant(limits[0])} to {significant(limits[1], 'N')}"
        case Refusal.STROKE_DIFFERS:
            return (
                f"the drive's position is {value:z.2f} mm, expected within {TOLERANCE_MM:g} mm of the stroke "
                "measured: measure it again, or home the drive with its own tool"
            )
        case Refusal.CAUSE_PRESENT:
            there = faults_of(checks) or [fault]
            there.sort(key=lambda cause: list(standing).index(cause) if cause in standing else len(standing))
            words = [f"{cause.name} ({standing[cause]})" if cause in standing else cause.name for cause in there]
            return f"cause still present: {', '.join(words)}" + (
                _SILENT_HINT if any(Trait.DEVICE_SILENT in cause.traits for cause in there) else ""
            )
        case Refusal.WRONG_MODE:
            return f"{verb.name.lower()} is not possible in {mode.name}{_HINT.get((mode, verb), '')}"
        case Refusal.STOP_RUNNING:
            return f"the drive is still stopping or closing its brake ({value:.2f} mm/s): wait a second, then reset"
        case Refusal.DRIVE_TIMEOUT | Refusal.DRIVE_STATE | Refusal.OFF_UNSEEN:
            return _DRIVE_TEXT[refusal] + _drive_state(value)
        case Refusal.BRAKE_SLIPPED:
            return f"brake test: the stroke moved by {value:.2f} mm on the closed brake: secure the load"
        case _:
            return _PLAIN_TEXT.get(refusal, "unknown command").format(value)


_DRIVE_TEXT = {
    Refusal.DRIVE_TIMEOUT: "drive did not become enabled",
    Refusal.OFF_UNSEEN: f"not confirmed: the drive has not reported that it is off within {OFF_LIMIT_NS * 1e-9:g} s",
    Refusal.DRIVE_STATE: "the drive has not left its fault state, whose cause is still there",
}


def _drive_state(value: float) -> str:
    """The drive's state in words, for the end of a sentence; "" where none is known."""
    known = {float(state): state for state in DriveState}
    return f": it now reports {known[value].name.replace('_', ' ')}" if value in known else ""


_RANGES: dict[Verb, str] = {
    Verb.MOVE: "the number of a move is 1 to learning.moves of the rig file, 0 for the end of the one under way",
    Verb.RELEASE: f"the length must leave the cylinder inside its stroke, {STROKE_SPARE_MM:g} mm from its end",
    Verb.CARRY: f"the time must be {CARRY_S[0]:g} to {CARRY_S[1]:g} s",
}
_PLAIN_TEXT = {
    Refusal.CARRIED: "the motor carries the load for another {:.0f} s, because the brake does not hold it: rigctl "
    "lower, or rigctl disarm to try the brake, then reset",
    Refusal.SUNK: "the load has sunk by {:.1f} mm in the arms before, because the motor turns back when it takes it: "
    "support the payload from below until the rope is slack, arm, and let the motor have the load with tension; "
    "cylinder.rated_force_n gives the motor a preload",
    Refusal.DISAGREE: "encoder and tension disagree by {:.2f} mm on how the load moves: see at the rig which of them "
    "is right, then rigctl carry (or lower) --by encoder or --by cell",
    Refusal.STOPPING: "daemon is stopping",
    Refusal.EXPIRED: "command came too late and was not carried out",
    Refusal.ABORTED: "cut short by a command, a trip or a change of mode; nothing was changed",
    Refusal.UNSTEADY: "the stroke or the cell's reading moves: wait until everything is at rest",
    Refusal.NO_SAMPLES: "the cell gives no good samples",
    Refusal.SLACK: "the rope is slack",
    Refusal.NO_STEP: "no weight was hung on the cell, or taken off it, 2 s to 2 min after the command",
    Refusal.NO_LEARNING: "the rig file has no section learning, so nothing would be learnt from the move",
    Refusal.FAULT_LATCHED: "a limit has the tension ramped down; only hold stops that",
    Refusal.TIGHT: "the rope is tight: release without a length ramps the tension down",
    Refusal.NO_BRAKE: "the rig has no brake to test (cylinder.brake_waiver): the motor holds the load",
    Refusal.LITTLE_LOAD: "a brake test needs at least {:.0f} N on the rope to show that the brake holds: rigctl "
    "target, then rigctl tension, which ends in HOLD",
    Refusal.STRAYED: "tension or stroke left the bounds of the excitation, or would have; the excitation was ended",
    Refusal.UNFELT: "the stroke moved and the cell did not show it: look at cell and rope; the excitation was ended",
}
_UNSEEN = (
    Check.DRIVE_SUPERVISION
    | Check.CELL_STALE
    | Check.INCLINATION_STALE
    | Check.DRIVE_STALE
    | Check.E_STOP_IO_UNSEEN
    | Check.STATUS_STALE
    | Check.NODE_NOT_OPERATIONAL
)
_SILENT_HINT = " (a device that was switched off or a CAN interface that was unplugged needs the daemon started anew)"
_MOVES_STROKE = tuple(mode for mode in Mode if mode.moves_stroke)
_HINT: dict[tuple[Mode, Verb], str] = {
    **{(Mode.FAULT, verb): ": reset first" for verb in (Verb.ARM, Verb.TENSION, Verb.RELEASE, Verb.HOLD, *TRIED_IN)},
    **{(Mode.DISARMED, verb): ": arm first" for verb in (Verb.TENSION, Verb.RELEASE, Verb.HOLD, Verb.IDENTIFY)},
    (Mode.DISARMED, Verb.RESPONSE): ": arm and tension first",
    (Mode.HOLD, Verb.RESPONSE): ": tension first",
    **{(mode, verb): ": hold first" for mode in _MOVES_STROKE for verb in (Verb.DISARM, Verb.BRAKE_TEST, *TRIED_IN)},
    **{(mode, Verb.RELEASE): ": a length is paid out in HOLD" for mode in (Mode.TENSIONING, Mode.COMPENSATING)},
    (Mode.DISARMED, Verb.BRAKE_TEST): ": arm on a tight rope tests it",
    **{(mode, Verb.CONFIRM_STROKE): ": hold, then disarm first" for mode in _MOVES_STROKE},
    (Mode.HOLD, Verb.CONFIRM_STROKE): ": disarm first",
    **{(mode, Verb.RESET): ": there is no fault" for mode in Mode if mode is not Mode.FAULT},
}


_WITNESS: dict[int, str] = {Witness.ENCODER: "encoder", Witness.CELL: "cell"}
_HELD_TEXT: dict[HeldBy, str] = {
    HeldBy.NOTHING: "the motor moves the load",
    HeldBy.MOTOR: "load held by the motor",
    HeldBy.CLOSING: "the drive stops and closes its brake",
    HeldBy.BRAKE: "load held by the brake, drive off",
    HeldBy.TAKING: "the motor takes the load from the brake",
    HeldBy.UNKNOWN: "not known what holds the load: the drive does not report, or the load is not seen at rest on the "
    "closed brake",
}


def _held(_a: int, b: int, value: float, _limit: float, text: str) -> Worded:
    longest = f", for at most {value:.0f} s" if value else ""
    severity = "warning" if b == HeldBy.UNKNOWN else "info"
    return Worded(severity, f"{text}: {_HELD_TEXT[HeldBy(b)]}{longest}")


_LEAVES = "the daemon ends and leaves {1:.0f} N to the brake, which may not hold it: support the payload from below"
_END_TEXT: dict[int, tuple[str, str]] = {
    EndStep.WAITS: (
        "warning",
        "the daemon is to end, but the motor has a load of {1:.0f} N that the brake may not hold: support the payload "
        "from below; in {0:.0f} s the motor lowers the load, then the daemon ends; a second signal leaves the load",
    ),
    EndStep.LOWERS: (
        "warning",
        "the daemon ends once the motor has lowered the load of {1:.0f} N; a second signal leaves the load",
    ),
    EndStep.LOWERED: ("info", "the load is lowered, {1:.0f} N are left on the rope: the daemon ends"),
    EndStep.LEFT: ("error", f"by a second signal {_LEAVES}"),
    EndStep.GONE: ("error", f"the motor has the load no more: {_LEAVES}"),
    EndStep.LATE: ("error", f"the load is not lowered after {{0:.0f}} s: {_LEAVES}"),
}


def _ending(a: int, _b: int, value: float, limit: float, _text: str) -> Worded:
    severity, text = _END_TEXT.get(a, ("warning", "the end of the daemon goes on"))
    return Worded(severity, text.format(value, limit))


def _power_off(a: int, b: int, value: float, _limit: float, _text: str) -> Worded:
    shown = PowerOff(a) if a in PowerOff._value2member_map_ else PowerOff.UNCONFIRMED
    severity = "info" if shown.confirmed else "error"
    hint = "" if shown.confirmed else f": {_SECURE[bool(b)]}"
    return Worded(severity, f"{shown.words}, {value:.1f} s after the command{hint}")


def _found_at_start(_a: int, b: int, value: float, limit: float, _text: str) -> Worded:
    index = b >> 8
    if index == STATUSWORD:
        names = {float(state): state.name.replace("_", " ") for state in DriveState}
        found, left = (names.get(state, "no state of CiA 402") for state in (value, limit))
        return Worded("warning", f"the drive was found in {found} at the start, and taken off power: {left}")
    kept = f", and it keeps {limit:.0f}" if limit else ""
    return Worded("warning", f"0x{index:04X} of the drive was found at {value:.0f} at the start, set to 0{kept}")


def _load_at_rest(_a: int, b: int, _value: float, _limit: float, text: str) -> Worded:
    shown = LoadAtRest(b) if b in LoadAtRest._value2member_map_ else LoadAtRest.UNKNOWN
    return Worded("info" if shown.rests else "warning", f"{text}: load at rest on the brake: {shown.words}")


def _mode(a: int, b: int, value: float, _limit: float, _text: str) -> Worded:
    event = Event(int(value))
    return Worded("error" if event is Event.TRIP else "info", f"{Mode(a).name} -> {Mode(b).name}: {_EVENT_TEXT[event]}")


def _emergency(a: int, b: int, _value: float, _limit: float, text: str) -> Worded:
    code, register = b & 0xFFFF, b >> 16 & 0xFF
    try:
        manufacturer = bytes.fromhex(text)
    except ValueError:
        manufacturer = b""
    severity = "info" if not emergency.stands(code, register) else "error" if code >> 8 else "warning"
    return Worded(severity, f"node {a}: {emergency.words(code, register, manufacturer)}")


def setting_words(text: str) -> str:
    """The setting a device does not keep, and what to do."""
    return f"a device does not keep what start-up wrote, {text}: start the daemon anew, it writes all of it again"


def stroke_words(reads_mm: float, why: str) -> str:
    """Why a stroke has to be confirmed, and what to do."""
    return (
        f"the stroke reads {reads_mm:z.2f} mm, but {why}: measure it at the cylinder; if it is {reads_mm:z.2f} mm, "
        f"rigctl confirm-stroke {reads_mm:z.2f}, else home the drive with its own tool"
    )


def _stroke(a: int, _b: int, value: float, _limit: float, text: str) -> Worded:
    if a:
        return Worded("info", f"stroke {value:z.2f} mm: {text}")
    return Worded("warning", stroke_words(value, text))


_SILENT = (
    "it is stopped by NMT and gets neither command nor heartbeat any more, so that its own supervision stops it; look "
    "at drive and bus, then reset: all devices are started up again"
)
_SYMPTOM_TEXT: dict[Symptom, str] = {
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
_SECURE = "press the emergency stop, secure the load", "support the payload from below"
"""What to do about a drive that may have power: the second where only the motor can hold the load."""


def _escalation(a: int, b: int, value: float, limit: float, text: str) -> Worded:
    """``text``: not empty where the brake is known not to hold."""
    words = _SYMPTOM_TEXT[Symptom(b)].format(value, limit, secure=_SECURE[bool(text)])
    return Worded("error", f"{Fault(a).name}, reaction did not help: {words}")


def _brake_fails(*, assumed: bool, tension_n: float, wanted_n: float, why: str) -> str:
    seen = "the brake counts as one that does not hold" if assumed else "the brake does not hold"
    load = f", {tension_n:.0f} N on the rope" if tension_n else ""
    test = f"rigctl arm on a tight rope of {wanted_n:.0f} N at least, once nothing bars it"
    return f"{seen}: {why}{load}; carry and lower go by the motor, and only a brake test clears this: {test}"


def _creep(a: int, _b: int, value: float, _limit: float, text: str) -> Worded:
    if not text:
        return Worded("info", "tension cell: no creep is taken out")
    history = "" if a else "; the load before is not known and is taken to have been the present one"
    return Worded("info", f"tension cell: creep of {100.0 * value:z.4f} % is taken out (shares and s: {text}){history}")


def _move(a: int, b: int, _value: float, _limit: float, _text: str) -> Worded:
    if not a:
        return Worded("info", "the move has ended")
    return Worded(
        "info", f"move {a} begins, learnt from {count(b, 'move')}" if b else f"move {a} begins, nothing learnt"
    )


def _not_learnt(a: int, b: int, value: float, limit: float, text: str) -> Worded:
    found = f" ({value:.3f} N rms, {limit:.3f} N in the first)" if value else ""
    return Worded(
        "info" if b else "warning", f"nothing learnt from move {a}: {text}{found}{'' if b else '; it begins anew'}"
    )


def _limit(a: int, _b: int, value: float, limit: float, text: str) -> Worded:
    """Of a row that is only logged: of a limit of the rig file, or of a fault in a mode that it does not trip in."""
    fault = Fault(a)
    heading = "limit" if fault is Fault.LIMIT else f"{fault.name} is active"
    return Worded("warning", f"{heading}: {fault_text(fault, value, limit, text)}")


def _limit_over(a: int, _b: int, value: float, limit: float, text: str) -> Worded:
    fault, over = Fault(a), "cleared" if math.isfinite(value) else "not watched any more"
    if fault is not Fault.LIMIT:
        return Worded("info", f"{fault.name} is {over}")
    return Worded("info", f"limit {over}: {text} {limit:.10g}{_unit_of(text)}")


_WORDS: dict[Kind, Callable[[int, int, float, float, str], Worded]] = {
    Kind.MODE: _mode,
    Kind.TRIP: _trip,
    Kind.LIMIT: _limit,
    Kind.LIMIT_OVER: _limit_over,
    Kind.CAUSE: lambda a, _b, v, m, t: Worded("error", f"{Fault(a).name} is active: {fault_text(Fault(a), v, m, t)}"),
    Kind.CAUSE_OVER: lambda a, _b, _v, _m, t: Worded("info", f"{Fault(a).name} is cleared{t and f': {t}'}"),
    Kind.RESET: lambda a, _b, _v, _l, _t: Worded("info", f"fault {Fault(a).name} reset"),
    Kind.START_ANEW: lambda a, _b, _v, _l, _t: Worded(
        "info", f"fault {Fault(a).name} reset: the loop ends, the next one starts all devices up and is DISARMED"
    ),
    Kind.EMERGENCY: _emergency,
    Kind.NODE_STATE: lambda a, b, _v, _l, _t: Worded(
        "info" if b == 5 else "warning", f"node {a}: {_NMT.get(b, f'unknown state {b}')}"
    ),
    Kind.EXCEPTION: lambda _a, _b, _v, _l, t: Worded("error", f"exception in the loop: {t}"),
    Kind.BUS_ERROR: lambda a, b, _v, _l, _t: Worded(
        "error" if can_errors.is_grave(a) else "warning", f"CAN error frame: {can_errors.in_words(a, b)}"
    ),
    Kind.SEND_FAILED: lambda _a, _b, _v, _l, t: Worded("warning", f"frame not sent: {t}"),
    Kind.RECEIVE_FAILED: lambda _a, _b, _v, _l, t: Worded("warning", f"bus not readable: {t}"),
    Kind.STARTED: lambda _a, _b, _v, _l, _t: Worded("info", "loop started, DISARMED"),
    Kind.STOPPED: lambda _a, _b, v, m, _t: Worded("info", f"loop stopped, stroke {v:.2f} mm, tension {m:z.1f} N"),
    Kind.SIGNS: lambda a, _b, v, m, _t: Worded(
        "warning" if a else "info",
        f"signs checked: the stroke follows, tension rises by {v:.2f} N/mm (plant: {m:.2f} N/mm)"
        + ("; nothing else checks the cell's scale: compare it with a known weight (rigctl calibrate)" if a else ""),
    ),
    Kind.BRAKE_TEST: lambda a, _b, v, m, _t: Worded(
        "info",
        f"brake test: held {m:.1f} N for 2 s, stroke moved {v:z.3f} mm"
        if a
        else "brake test not possible: the rope is slack",
    ),
    Kind.BRAKE_FLAG: lambda a, b, v, m, t: Worded(
        "error" if a else "info",
        _brake_fails(assumed=bool(b), tension_n=v, wanted_n=m, why=t) if a else f"the brake holds: {t}",
    ),
    Kind.WITNESS: lambda a, _b, _v, _m, t: Worded(
        "warning", f"{t} by the {_WITNESS.get(a, 'witness')} alone, as the operator has named it"
    ),
    Kind.STROKE_LEFT: lambda a, _b, v, m, _t: Worded(
        "warning",
        f"{Mode(a).name}: the stroke is {v:+.2f} mm from where it was latched (reported beyond {m:.2f} mm): "
        + ("the brake slips, or the screw is turned" if a == Mode.DISARMED else "the drive creeps, or the brake slips"),
    ),
    Kind.DRIVE_CREEPS: lambda _a, _b, v, m, _t: Worded(
        "warning",
        f"the drive creeps at {v:+.2f} mm/s when commanded 0 (reported beyond {m:.2f} mm/s); HOLD corrects it: check "
        "the drive's velocity offset (0x60B1) and its tuning",
    ),
    Kind.ESCALATION: _escalation,
    Kind.CORRECTION: lambda _a, _b, v, m, _t: Worded("info", f"tension cell: zero {v:+z.3f} N, scale {m:.5f}"),
    Kind.SECOND_FORCE: lambda _a, _b, v, m, _t: Worded("info", f"second force path: zero {v:+z.3f} N, scale {m:.5f}"),
    Kind.CREEP: _creep,
    Kind.LOAD_STEP: lambda a, _b, v, m, _t: Worded(
        "info", f"creep: {count(a, 'sample')}, mean {v:.4f} N, {m:.1f} s after the load's step"
    ),
    Kind.NO_MARGINS: lambda a, _b, _v, _m, _t: Worded(
        "warning", f"margins not measured in the last minute: {UNMEASURED.get(a, '')}"
    ),
    Kind.MARGINS_DIFFER: lambda _a, _b, v, m, _t: Worded(
        "warning",
        f"the loop's sensitivity is not the design's: |S| {v:.2f} measured, {m:.2f} predicted; no other gains are "
        "taken until rigctl identify --response and rigctl tune --from",
    ),
    Kind.GAINS: lambda _a, _b, _v, _m, t: Worded("info", f"gains changed: K_T, K_v, K_i = {t}"),
    Kind.MOVE: _move,
    Kind.LEARNT: lambda a, b, v, m, _t: Worded(
        "info", f"move {a}: {v:.3f} N rms, {m:.3f} N in the first; learnt from {count(b, 'move')}"
    ),
    Kind.NOT_LEARNT: _not_learnt,
    Kind.LOCAL_HOLD: lambda a, b, _v, _l, t: Worded(
        "info", f"HOLD from {t} via the local socket (uid {a}, process {b})"
    ),
    Kind.HOLD_SOCKET_CLOSED: lambda a, b, _v, _l, _t: Worded(
        "warning",
        f"the HOLD socket of uid {a} is read no more: process {b} sent a descriptor along; HOLD of that user goes over "
        "the network until the loop starts anew",
    ),
    Kind.FOREIGN_SDO: lambda _a, _b, _v, _l, t: Worded("warning", f"another master {t}: find it and stop it"),
    Kind.SETTING_LOST: lambda _a, _b, _v, _l, t: Worded("error", f"a device's setting is lost: {t}"),
    Kind.STROKE: _stroke,
    Kind.READ_BACK: lambda a, _b, v, _l, _t: Worded(
        "info", f"{count(a, 'setting')} of the devices read back in {v:.2f} s"
    ),
    Kind.HELD: _held,
    Kind.ENDING: _ending,
    Kind.POWER_OFF: _power_off,
    Kind.LOAD_AT_REST: _load_at_rest,
    Kind.FOUND_AT_START: _found_at_start,
    Kind.CLOCK: lambda a, _b, _v, _l, _t: Worded("warning", f"{count(a, 'tick')} skipped at once"),
}  # fmt: skip


def worded(kind: int, a: int, b: int, value: float, limit: float, text: str) -> Worded:
    """An ``EVENT`` slot in words."""
    return _WORDS[Kind(kind)](a, b, Number(value), Number(limit), text)
