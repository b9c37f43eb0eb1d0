"""Events: numbers in the loop, words for people. The loop writes ``EVENT`` slots; the gateway words them here."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from rigctl.control.escalation import Symptom
from rigctl.control.modes import TRIED_IN, Event, Mode, Refusal, Verb
from rigctl.control.safety import Action, Check, EStop, Fault
from rigctl.telemetry import can_errors


class Kind(IntEnum):
    """Kind of an event; ``a``, ``b``, ``value`` and ``limit`` mean what the comment says."""

    MODE = 1  # a: from, b: to, value: event, limit: safe frames sent before it
    TRIP = 2  # a: fault, b: action, value, limit, text: what is beyond its limit, for a limit of the rig file
    RESET = 3  # a: fault acknowledged
    EMERGENCY = 4  # a: node, b: emergency code (CiA 301)
    NODE_STATE = 5  # a: node, b: NMT state
    EXCEPTION = 6  # text: exception and place
    BUS_ERROR = 7  # a: error class bits of the frame's id, b: see rigctl.telemetry.can_errors.details
    SEND_FAILED = 8  # text: why
    STARTED = 9  # loop running
    STOPPED = 10  # loop ended, value: stroke, limit: tension
    CLOCK = 11  # a: ticks skipped at once
    CORRECTION = 12  # value: zero of the tension cell in N, limit: its scale
    GAINS = 14  # text: K_T, K_v, K_i now in force
    LIMIT = 15  # a: fault, b: action (LOG), value, limit, text: a limit of the rig file is passed ...
    LIMIT_OVER = 16  # ... and is kept again
    RECEIVE_FAILED = 17  # text: why
    STROKE_LEFT = 40  # a: mode, value: stroke from where it was latched in mm, limit: what is told
    DRIVE_CREEPS = 41  # value: speed in mm/s at which the drive creeps when told 0, limit: what is told
    ESCALATION = 42  # a: fault, b: symptom, see rigctl.control.escalation, value, limit: its reaction did not help
    SIGNS = 13  # value: stiffness found in the first tensioning in N/mm, limit: the plant's


@dataclass(frozen=True)
class Worded:
    """An event for people: key ending (info, warning, error) and one line."""

    severity: str
    text: str


FAULT_TEXT: dict[Fault, str] = {
    Fault.NONE: "no fault",
    Fault.TENSION_HIGH: "tension {value:.1f} N above {limit:.1f} N",
    Fault.TENSION_LOW: "tension lost ({value:.1f} N, limit {limit:.1f} N)",
    Fault.CELL_STALE: "no tension sample for {value:.0f} ms (limit {limit:.0f} ms)",
    Fault.CELL_INVALID: "tension cell reports overload or no valid value (status {value:.0f})",
    Fault.INCLINATION_STALE: "no inclination sample for {value:.0f} ms (limit {limit:.0f} ms)",
    Fault.INCLINATION_INVALID: "inclinometer reports no valid value",
    Fault.DRIVE_STALE: "no drive status for {value:.0f} ms (limit {limit:.0f} ms)",
    Fault.DRIVE_FAULT: "drive reports a fault and holds by itself",
    Fault.BUS_SILENT: "no frame on the bus for {value:.0f} ms (limit {limit:.0f} ms)",
    Fault.OVERRUN: "{value:.0f} ticks skipped, loop cannot keep its rate (limit {limit:.0f})",
    Fault.LOOP_EXCEPTION: "exception in the loop",
    Fault.STROKE_END: "stroke limit reached before the tension was",
    Fault.DRIVE_NOT_FOLLOWING: "drive does not do what it is told (enabled state or speed)",
    Fault.INNOVATION: "tension or cylinder speed contradicts what the filter expects",
    Fault.SIGN_DRIVE: "the stroke does not go where the drive is told: check the drive's sign and scale",
    Fault.SIGN_CELL: "the tension does not follow the stroke as the plant says: check the signs of cell and drive",
    Fault.LIMIT: "{text} {limit:g} ({value:.4g})",
    Fault.CELL_STUCK: "tension cell has sent the very same value {value:.0f} times more",
    Fault.DRIVE_CONTRADICTS: "drive's position and speed contradict each other by {value:.2f} mm (limit {limit:.2f})",
    Fault.STROKE_MOVES: "the stroke moves though the drive is off ({value:.2f} mm/s): the brake does not hold; "
    "reset, then arm: the motor carries",
    Fault.STRETCH_UNEXPLAINED: "tension and stroke contradict each other by {value:.1f} mm of stretch "
    "(limit {limit:.1f} mm): rope, cell or payload",
    Fault.STROKE_NOT_HELD: "the stroke has moved {value:.2f} mm from where it was latched (limit {limit:.2f} mm): "
    "the drive creeps or the brake slips",
    Fault.POSITION_DRIFTS: "holding the stroke has moved the load by {value:.2f} mm (limit {limit:.2f} mm): "
    "the drive's position drifts, check its encoder",
    Fault.E_STOP: "emergency stop pressed ({seen})",
    Fault.E_STOP_UNSEEN: "the I/O node that mirrors the emergency stop has sent nothing for {value:.0f} ms "
    "(limit {limit:.0f} ms)",
    Fault.RIVAL: "another controller commands this bus: find it and stop it",
    Fault.CELL_NOISY: "tension cell jumps by {value:.1f} N from sample to sample (limit {limit:.1f} N)",
    Fault.CELL_NEGATIVE: "tension cell reads {value:.1f} N: a rope cannot push (limit {limit:.1f} N)",
    Fault.SENSOR_EMERGENCY: "a sensor's emergency message stands (see the events)",
    Fault.DRIVE_EMERGENCY: "the drive's emergency message stands (see the events)",
    Fault.DEVICE_RESTARTED: "a device restarted and lost its settings; start the daemon anew",
}

_SCALE: dict[Fault, float] = {
    Fault.CELL_STALE: 1e-6, Fault.INCLINATION_STALE: 1e-6, Fault.DRIVE_STALE: 1e-6, Fault.BUS_SILENT: 1e-6,
    Fault.E_STOP_UNSEEN: 1e-6,
}  # fmt: skip

_SEEN: dict[float, str] = {
    EStop.DRIVE: "drive's input",
    EStop.IO_NODE: "I/O node's input",
    EStop.DRIVE | EStop.IO_NODE: "inputs of drive and I/O node",
}

CHECK_TEXT: dict[Check, str] = {
    Check.CELL_STALE: "no fresh tension sample: check the cell's power and cable",
    Check.CELL_INVALID: "tension cell reports overload or no valid value: unload it, check its cable",
    Check.INCLINATION_STALE: "no fresh inclination sample: check the inclinometer's power and cable",
    Check.INCLINATION_INVALID: "inclinometer reports no valid value: check its mounting and range",
    Check.DRIVE_STALE: "no fresh drive status: check the drive's power and cable",
    Check.DRIVE_FAULT: "drive reports a fault (reset clears it)",
    Check.TENSION_HIGH: "tension above its limit: unload the rope",
    Check.STROKE_RANGE: "stroke beyond its limits: bring it back by hand or with the drive's own tool",
    Check.STROKE_NEAR_END: "stroke too near its end (preflight.stroke_margin_mm): rigctl arm --near-end, then tension "
    "or release, whichever leads away from it",
    Check.DRIVE_SUPERVISION: "drive's own stop on loss of the controller is not verified since a device started anew: "
    "start the daemon anew",
    Check.CELL_IMPLAUSIBLE: "tension cell is stuck, noisy or reads a push: check cable and amplifier",
    Check.EMERGENCY: "a device's emergency message stands (see the events)",
    Check.RIVAL: "another controller commands this bus: find it and stop it",
    Check.LIMIT: "a limit of the rig file is passed (rigctl watch shows the signals)",
    Check.E_STOP: "emergency stop is pressed (drive's input): release it, then rigctl reset",
    Check.E_STOP_IO: "emergency stop is pressed (I/O node's input): release it, then rigctl reset",
    Check.E_STOP_UNSEEN: "emergency stop's input is not seen: check the drive's second TPDO (cylinder.e_stop_input)",
    Check.E_STOP_IO_UNSEEN: "emergency stop's input on the I/O node is not seen: check the node's power and cable",
    Check.TARE: "no tare on record that still holds: rigctl tare (or calibration.waiver)",
    Check.MARGINS: "no accepted margins of the law in use: rigctl tune",
    Check.REALTIME: "real-time settings are not in force: rigctl doctor (or loop.realtime_waiver)",
    Check.DISK: "disk nearly full: make room for ledger, audit log and trip dumps",
    Check.HOST: "tare, margins, real time and disk have not been looked at: try again in a second",
    Check.CALIBRATION: "tension cell's calibration is missing or overdue: rigctl calibrate (or calibration.waiver)",
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
    Event.RESET_HELD: "reset, drive on",
    Event.RESET_OFF: "reset, drive off",
    Event.STOP: "daemon stopping",
    Event.RAMP_DOWN: "ramp down",
}

_NMT = {0: "boot-up", 4: "stopped", 5: "operational", 127: "pre-operational"}


def fault_text(fault: Fault, value: float, limit: float, text: str = "") -> str:
    """One line for a fault; ``text``: what is beyond its limit, where the rig file says so."""
    scale = _SCALE.get(fault, 1.0)
    seen = _SEEN.get(value, "input not known") if fault is Fault.E_STOP else ""
    return FAULT_TEXT[fault].format(value=value * scale, limit=limit * scale, text=text, seen=seen)


def _trip(a: int, b: int, value: float, limit: float, text: str) -> Worded:
    asked = "" if b == Action.HOLD else f"; {_ACTION_TEXT[Action(b)]}"
    return Worded("error", f"trip {Fault(a).name}: {fault_text(Fault(a), value, limit, text)}{asked}")


_ACTION_TEXT = {
    Action.LOG: "logged",
    Action.RAMP_DOWN: "ramping down",
    Action.HOLD: "holding",
    Action.QUICK_STOP: "quick stop, then power off",
    Action.POWER_OFF: "power off, brake closed",
}


def failed_checks(bits: int, known: Mapping[Check, str] = MappingProxyType({})) -> list[str]:
    """Preflight checks that failed, in words; ``known``: what more is known of some."""
    return [known.get(check, CHECK_TEXT[check]) for check in Check if bits & check]


def refusal_text(
    refusal: Refusal,
    verb: Verb,
    mode: Mode,
    checks: int,
    fault: Fault,
    limits: tuple[float, float],
    value: float = math.nan,
    known: Mapping[Check, str] = MappingProxyType({}),
) -> str:
    """Why a command was refused, in one line; ``value`` is the reply's, ``known`` as of `failed_checks`."""
    match refusal:
        case Refusal.ALREADY:
            return (
                f"already {mode.name}" if verb is not Verb.RELEASE or mode is not Mode.HOLD else "rope is slack already"
            )
        case Refusal.PREFLIGHT:
            return "; ".join(failed_checks(checks, known)) + (_SILENT_HINT if checks & _UNSEEN else "")
        case Refusal.LOADED:
            return f"the rope is not unloaded: the cell reads {value:z.2f} N, more than calibration.tare_limit_n"
        case Refusal.OUT_OF_RANGE:
            return f"target must be {limits[0]:g} to {limits[1]:g} N"
        case Refusal.CAUSE_PRESENT:
            return f"cause still present: {fault.name}" + (_SILENT_HINT if fault in _SILENT else "")
        case Refusal.WRONG_MODE:
            return f"{verb.name.lower()} is not possible in {mode.name}{_HINT.get((mode, verb), '')}"
        case Refusal.EXPIRED:
            return "command came too late and was not carried out"
        case Refusal.STOPPING:
            return "daemon is stopping"
        case Refusal.DRIVE_TIMEOUT:
            return "drive did not become enabled"
        case _:
            return _TRIAL_TEXT.get(refusal, "unknown command")


_TRIAL_TEXT = {
    Refusal.ABORTED: "cut short by a command, a trip or a change of mode; nothing was changed",
    Refusal.UNSTEADY: "it moves, or the reading does: wait until everything is at rest",
    Refusal.NO_SAMPLES: "the cell gives no good samples",
    Refusal.SLACK: "the rope is slack",
    Refusal.FAULT_LATCHED: "a limit has the tension ramped down; only hold stops that",
    Refusal.STRAYED: "tension or stroke left the bounds of the excitation, or would have; the stroke is held",
}
_SILENT = frozenset(
    {Fault.DEVICE_RESTARTED, Fault.BUS_SILENT, Fault.CELL_STALE, Fault.INCLINATION_STALE, Fault.DRIVE_STALE,
     Fault.E_STOP_UNSEEN}
)  # fmt: skip
_UNSEEN = (
    Check.DRIVE_SUPERVISION | Check.CELL_STALE | Check.INCLINATION_STALE | Check.DRIVE_STALE | Check.E_STOP_IO_UNSEEN
)
_SILENT_HINT = " (a device that was switched off or a CAN interface that was unplugged needs the daemon started anew)"
_HINT: dict[tuple[Mode, Verb], str] = {
    **{(Mode.FAULT, verb): ": reset first" for verb in (Verb.ARM, Verb.TENSION, Verb.RELEASE, Verb.HOLD, *TRIED_IN)},
    **{(Mode.DISARMED, verb): ": arm first" for verb in (Verb.TENSION, Verb.RELEASE, Verb.HOLD, Verb.IDENTIFY)},
    **{
        (mode, verb): ": hold first"
        for mode in (Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)
        for verb in (Verb.DISARM, *TRIED_IN)
    },
    **{(mode, Verb.RESET): ": there is no fault" for mode in Mode if mode is not Mode.FAULT},
}


def _mode(a: int, b: int, value: float, _limit: float, _text: str) -> Worded:
    severity = "error" if b == Mode.FAULT else "info"
    return Worded(severity, f"{Mode(a).name} -> {Mode(b).name}: {_EVENT_TEXT[Event(int(value))]}")


def _emergency(a: int, b: int, _value: float, _limit: float, _text: str) -> Worded:
    if b == 0:
        return Worded("info", f"node {a}: emergency over")
    return Worded("error", f"node {a}: emergency 0x{b:04X}")


_SYMPTOM_TEXT: dict[Symptom, str] = {
    Symptom.RAMP_RISES: "the tension has risen by {0:.1f} N since the ramp down began (limit {1:.1f} N); the stroke is "
    "held",
    Symptom.RAMP_LATE: "the rope is not slack {0:.1f} s after the ramp down should have ended (limit {1:.1f} s); the "
    "stroke is held",
    Symptom.HOLD_RISES: "the tension is above its limit and has risen by {0:.1f} N since the stroke is held (limit "
    "{1:.1f} N); quick stop, then power off",
    Symptom.HOLD_MOVES: "the stroke moves at {0:.2f} mm/s though it is held (limit {1:.2f} mm/s); quick stop, then "
    "power off",
    Symptom.STOP_MOVES: "the stroke still moves at {0:.2f} mm/s after the quick stop (limit {1:.2f} mm/s); power off, "
    "brake closed",
    Symptom.STOP_DRIFTS: "the stroke has moved {0:.2f} mm after the quick stop (limit {1:.2f} mm); power off, brake "
    "closed",
    Symptom.STOP_STAYS_ON: "the drive is not seen to have gone off after the quick stop; power off, brake closed",
    Symptom.OFF_DRIFTS: "the stroke has moved {0:.2f} mm with the power off (limit {1:.2f} mm): the brake does not "
    "hold, and the rig can do no more; secure the load",
}


def _escalation(a: int, b: int, value: float, limit: float, _text: str) -> Worded:
    return Worded("error", f"{Fault(a).name}, reaction did not help: {_SYMPTOM_TEXT[Symptom(b)].format(value, limit)}")


_WORDS: dict[Kind, Callable[[int, int, float, float, str], Worded]] = {
    Kind.MODE: _mode,
    Kind.TRIP: _trip,
    Kind.LIMIT: lambda a, _b, v, m, t: Worded("warning", f"limit: {fault_text(Fault(a), v, m, t)}"),
    Kind.LIMIT_OVER: lambda _a, _b, _v, m, t: Worded("info", f"limit: no longer {t} {m:g}"),
    Kind.RESET: lambda a, _b, _v, _l, _t: Worded("info", f"fault {Fault(a).name} reset"),
    Kind.EMERGENCY: _emergency,
    Kind.NODE_STATE: lambda a, b, _v, _l, _t: Worded("info" if b == 5 else "warning", f"node {a}: {_NMT.get(b, b)}"),
    Kind.EXCEPTION: lambda _a, _b, _v, _l, t: Worded("error", f"exception in the loop: {t}"),
    Kind.BUS_ERROR: lambda a, b, _v, _l, _t: Worded(
        "error" if can_errors.is_grave(a) else "warning", f"CAN error frame: {can_errors.in_words(a, b)}"
    ),
    Kind.SEND_FAILED: lambda _a, _b, _v, _l, t: Worded("warning", f"frame not sent: {t}"),
    Kind.RECEIVE_FAILED: lambda _a, _b, _v, _l, t: Worded("warning", f"bus not readable: {t}"),
    Kind.STARTED: lambda _a, _b, _v, _l, _t: Worded("info", "loop started, DISARMED"),
    Kind.STOPPED: lambda _a, _b, v, m, _t: Worded("info", f"loop stopped, stroke {v:.2f} mm, tension {m:z.1f} N"),
    Kind.SIGNS: lambda _a, _b, v, m, _t: Worded(
        "info", f"signs checked: the stroke follows, tension rises by {v:.2f} N/mm (plant: {m:.2f})"
    ),
    Kind.STROKE_LEFT: lambda a, _b, v, m, _t: Worded(
        "warning",
        f"{Mode(a).name}: the stroke is {v:+.2f} mm from where it was latched (told beyond {m:.2f} mm): "
        + ("the brake slips, or the screw is turned" if a == Mode.DISARMED else "the drive creeps, or the brake slips"),
    ),
    Kind.DRIVE_CREEPS: lambda _a, _b, v, m, _t: Worded(
        "warning",
        f"the drive creeps at {v:+.2f} mm/s when it is told 0 (told beyond {m:.2f} mm/s); HOLD corrects it: check the "
        "drive's velocity offset (0x60B1) and its tuning",
    ),
    Kind.ESCALATION: _escalation,
    Kind.CORRECTION: lambda _a, _b, v, m, _t: Worded("info", f"tension cell: zero {v:+z.3f} N, scale {m:.5f}"),
    Kind.GAINS: lambda _a, _b, _v, _m, t: Worded("info", f"gains changed: K_T, K_v, K_i = {t}"),
    Kind.CLOCK: lambda a, _b, _v, _l, _t: Worded("warning", f"{a} ticks skipped at once"),
}  # fmt: skip


def worded(kind: int, a: int, b: int, value: float, limit: float, text: str) -> Worded:
    """An ``EVENT`` slot in words."""
    return _WORDS[Kind(kind)](a, b, value, limit, text)
