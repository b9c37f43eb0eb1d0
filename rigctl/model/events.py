"""Events are numbers in the loop and words for people: the loop writes ``EVENT`` slots, the gateway words them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from rigctl.model import can_errors, emergency
from rigctl.model.check_words import stroke_words
from rigctl.model.device_states import NMT_WORDS, STATUSWORD, DriveState
from rigctl.model.fault_words import fault_text, unit_of_limit
from rigctl.model.faults import Fault
from rigctl.model.quantity import Number, count
from rigctl.model.reactions import Action, Symptom
from rigctl.model.states import EndStep, Event, HeldBy, LoadAtRest, Mode, PowerOff, Witness
from rigctl.model.unmeasured import UNMEASURED


class Kind(IntEnum):
    """Kind of an event; the comment gives the meaning of ``a``, ``b``, ``value`` and ``limit``."""

    MODE = 1  # a: from, b: to, value: event, limit: safe frames sent before it
    TRIP = 2  # a: fault, b: action, value, limit, text: the signal, for a limit of the rig file
    RESET = 3  # a: fault acknowledged
    EMERGENCY = 4  # a: node, b: emergency code | error register << 16 (CiA 301), text: manufacturer's bytes, hex
    NODE_STATE = 5  # a: node, b: NMT state
    EXCEPTION = 6  # text: exception and place
    BUS_ERROR = 7  # a: error class bits of the frame's id, b: see rigctl.model.can_errors.details
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
    ESCALATION = 42  # a: fault, b: symptom, see rigctl.model.reactions, value, limit: its reaction did not help;
    # text: where the brake is known not to hold
    CAUSE = 45  # as TRIP: a further cause while a fault is latched
    CAUSE_OVER = 46  # as TRIP: such a cause, or the one that tripped, is gone
    FOREIGN_SDO = 50  # a: node, b: index << 8 | sub-index (0: not known), text: what another master does there
    SETTING_LOST = 51  # a: node, b: index << 8 | sub-index, value: found (NaN: no value), limit: wanted, text: in words
    READ_BACK = 52  # a: objects that were as wanted, value: how long it took in s
    STROKE = 53  # a: 1 the drive's position is believed, 0 not, value: it in mm, limit: last known in mm, text: why
    BRAKE_FLAG = 56  # a: 1 the brake does not hold, b: 1 that is assumed; value: tension, limit: of a test; text: why
    ENDING = 58  # a: see rigctl.model.states.EndStep, value: WAITS: time until the motor lowers the load, LOWERS: 0,
    # else time since the request, both in s, limit: tension in N
    WITNESS = 57  # a: see rigctl.model.states.Witness, text: the command; an operator has named it
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


@dataclass(frozen=True)
class Worded:
    """An event for people: key ending (info, warning, error) and one line."""

    severity: str
    text: str


def _trip(a: int, b: int, value: float, limit: float, text: str) -> Worded:
    action = "" if b == Action.HOLD else f"; {Action(b).words}"
    return Worded("error", f"trip {Fault(a).name}: {fault_text(Fault(a), value, limit, text)}{action}")


_WITNESS: dict[int, str] = {Witness.ENCODER: "encoder", Witness.CELL: "cell"}


def _held(_a: int, b: int, value: float, _limit: float, text: str) -> Worded:
    longest = f", for at most {value:.0f} s" if value else ""
    severity = "warning" if b == HeldBy.UNKNOWN else "info"
    return Worded(severity, f"{text}: {HeldBy(b).words}{longest}")


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
    return Worded("error" if event is Event.TRIP else "info", f"{Mode(a).name} -> {Mode(b).name}: {event.words}")


def _emergency(a: int, b: int, _value: float, _limit: float, text: str) -> Worded:
    code, register = b & 0xFFFF, b >> 16 & 0xFF
    try:
        manufacturer = bytes.fromhex(text)
    except ValueError:
        manufacturer = b""
    severity = "info" if not emergency.stands(code, register) else "error" if code >> 8 else "warning"
    return Worded(severity, f"node {a}: {emergency.words(code, register, manufacturer)}")


def _stroke(a: int, _b: int, value: float, _limit: float, text: str) -> Worded:
    if a:
        return Worded("info", f"stroke {value:z.2f} mm: {text}")
    return Worded("warning", stroke_words(value, text))


_SECURE = "press the emergency stop, secure the load", "support the payload from below"
"""What to do about a drive that may have power: the second where only the motor can hold the load."""


def _escalation(a: int, b: int, value: float, limit: float, text: str) -> Worded:
    """``text``: not empty where the brake is known not to hold."""
    words = Symptom(b).words.format(value, limit, secure=_SECURE[bool(text)])
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
    return Worded("info", f"limit {over}: {text} {limit:.10g}{unit_of_limit(text)}")


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
        "info" if b == 5 else "warning", f"node {a}: {NMT_WORDS.get(b, f'unknown state {b}')}"
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
