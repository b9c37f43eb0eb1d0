"""The vocabulary of events: a kind is a row of `Kind`, with number, meaning, fields, severity, words and alarm.

The loop writes an event as the flat slot ``EVENT``: ``a``, ``b``, ``value``, ``limit``, ``text``. A row names what its
kind has in them; ``meta/schema``, messages, audit log, alarms and readers take names, units and words from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from itertools import groupby
from types import SimpleNamespace
from typing import Any

from rigctl.model import can_errors, emergency
from rigctl.model.check_words import stroke_words
from rigctl.model.device_states import NMT_WORDS, STATUSWORD, DriveState, NmtState
from rigctl.model.event_row import EventField, OfFault, OwnAlarm, Priority
from rigctl.model.fault_words import fault_text, unit_of_limit
from rigctl.model.faults import Fault
from rigctl.model.quantity import count
from rigctl.model.reactions import Action, Symptom
from rigctl.model.states import EndStep, Event, HeldBy, LoadAtRest, Mode, PowerOff, Witness
from rigctl.model.unmeasured import UNMEASURED, Unmeasured

_a, _b, _value, _limit, _text = (partial(EventField, slot) for slot in ("a", "b", "value", "limit", "text"))
_FAULT = _a("fault", "fault (see faults)", Fault)
_NODE = _a("node", "node")
_OBJECT = _b("index", "index", shift=8), _b("sub_index", "sub-index", bits=8)
_TRIPPED = (
    _FAULT,
    _b("action", "action (see actions)", Action),
    _value("value", "what was found, in the fault's unit"),
    _limit("limit", "what is allowed, in the same unit"),
    _text("seen", "of a limit of the rig file its row, else what was seen"),
)
_LEARNT = (
    _a("move", "number"),
    _b("learnt_from", "moves so far"),
    _value("rms_n", "its rms error in N"),
    _limit("first_rms_n", "the first's"),
)
_CORRECTED = _value("zero_n", "zero in N"), _limit("scale", "scale")
_NOT_SENT = _text("why", "why")
_BUS_FAILS = OwnAlarm(Priority.LOW, Fault.BUS_SILENT, each_second=True)
_SECURE = "press the emergency stop, secure the load", "support the payload from below"
"""What to do about a drive that may have power: the second where only the motor can hold the load."""


# -- words and severities that a template does not give; ``e`` has the fields ---------------------------------------
def _trip_words(e: Any) -> str:
    action = "" if e.action is Action.HOLD else f"; {e.action.words}"
    return f"trip {e.fault.name}: {fault_text(e.fault, e.value, e.limit, e.seen)}{action}"


def _limit_words(e: Any) -> str:
    """Of a row that is only logged: of a limit of the rig file, or of a fault in a mode that it does not trip in."""
    heading = "limit" if e.fault is Fault.LIMIT else f"{e.fault.name} is active"
    return f"{heading}: {fault_text(e.fault, e.value, e.limit, e.seen)}"


def _limit_over_words(e: Any) -> str:
    over = "cleared" if math.isfinite(e.value) else "not watched any more"
    if e.fault is not Fault.LIMIT:
        return f"{e.fault.name} is {over}"
    return f"limit {over}: {e.seen} {e.limit:.10g}{unit_of_limit(e.seen)}"


def _escalation_words(e: Any) -> str:
    words = e.symptom.words.format(e.value, e.limit, secure=_SECURE[bool(e.brake)])
    return f"{e.fault.name}, reaction did not help: {words}"


def _emergency_severity(e: Any) -> str:
    return "info" if not emergency.stands(e.code, e.register) else "error" if e.code >> 8 else "warning"


def _emergency_words(e: Any) -> str:
    try:
        manufacturer = bytes.fromhex(e.manufacturer)
    except ValueError:
        manufacturer = b""
    return f"node {e.node}: {emergency.words(e.code, e.register, manufacturer)}"


def _found_at_start_words(e: Any) -> str:
    if e.index == STATUSWORD:
        names = {float(state): state.name.replace("_", " ") for state in DriveState}
        found, left = (names.get(state, "no state of CiA 402") for state in (e.found, e.left))
        return f"the drive was found in {found} at the start, and taken off power: {left}"
    kept = f", and it keeps {e.left:.0f}" if e.left else ""
    return f"0x{e.index:04X} of the drive was found at {e.found:.0f} at the start, set to 0{kept}"


def _held_words(e: Any) -> str:
    longest = f", for at most {e.longest_s:.0f} s" if e.longest_s else ""
    return f"{e.why}: {e.to.words}{longest}"


_LEAVES = "the daemon ends and leaves {1:.0f} N to the brake, which may not hold it: support the payload from below"
_END_WORDS: dict[int, tuple[str, str]] = {
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


def _ending(e: Any) -> tuple[str, str]:
    return _END_WORDS.get(e.step, ("warning", "the end of the daemon goes on"))


def _power_off(e: Any) -> PowerOff:
    return e.shown if isinstance(e.shown, PowerOff) else PowerOff.UNCONFIRMED


def _power_off_words(e: Any) -> str:
    hint = "" if _power_off(e).confirmed else f": {_SECURE[e.brake_fails]}"
    return f"{_power_off(e).words}, {e.after_s:.1f} s after the command{hint}"


def _rest(e: Any) -> LoadAtRest:
    return e.to if isinstance(e.to, LoadAtRest) else LoadAtRest.UNKNOWN


def _brake_flag_words(e: Any) -> str:
    if not e.fails:
        return f"the brake holds: {e.why}"
    seen = "the brake counts as one that does not hold" if e.assumed else "the brake does not hold"
    load = f", {e.tension_n:.0f} N on the rope" if e.tension_n else ""
    test = f"rigctl arm on a tight rope of {e.test_n:.0f} N at least, once nothing bars it"
    return f"{seen}: {e.why}{load}; carry and lower go by the motor, and only a brake test clears this: {test}"


def _creep_words(e: Any) -> str:
    if not e.terms:
        return "tension cell: no creep is taken out"
    history = "" if e.history_known else "; the load before is not known and is taken to have been the present one"
    return f"tension cell: creep of {100.0 * e.share:z.4f} % is taken out (shares and s: {e.terms}){history}"


def _move_words(e: Any) -> str:
    if not e.move:
        return "the move has ended"
    return f"move {e.move} begins, " + (
        f"learnt from {count(e.learnt_from, 'move')}" if e.learnt_from else "nothing learnt"
    )


def _not_learnt_words(e: Any) -> str:
    found = f" ({e.rms_n:.3f} N rms, {e.first_rms_n:.3f} N in the first)" if e.rms_n else ""
    return f"nothing learnt from move {e.move}: {e.why}{found}{'' if e.learnt_from else '; it begins anew'}"


_WITNESS_WORDS: dict[int, str] = {Witness.ENCODER: "encoder", Witness.CELL: "cell"}

_Words = str | Callable[[Any], str]


class Kind(IntEnum):
    """Kind of an event; its number is on record.

    ``words`` and ``severity`` (info, warning, error): a template over the names of the fields, or a function of an
    object that has them. ``alarm``: None for an event that is no alarm's.
    """

    meaning: str
    fields: tuple[EventField, ...]
    words: _Words
    severity: _Words
    alarm: OwnAlarm | OfFault | None

    def __new__(
        cls,
        number: int,
        meaning: str = "",
        fields: tuple[EventField, ...] = (),
        words: _Words = "",
        severity: _Words = "info",
        alarm: OwnAlarm | OfFault | None = None,
    ) -> Kind:
        """A member with its row."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.meaning, member.fields, member.words = meaning, fields, words
        member.severity, member.alarm = severity, alarm
        return member

    # Mode and faults
    MODE = (
        1, "change of mode",
        (_a("from", "from", Mode), _b("to", "to (see modes)", Mode), _value("why", "why", Event),
         _limit("safe_frames", "safe frames sent before it")),
        "{from.name} -> {to.name}: {why.words}", lambda e: "error" if e.why is Event.TRIP else "info",
    )  # fmt: skip
    TRIP = 2, "a limit trips", _TRIPPED, _trip_words, "error", OfFault.BEGINS
    RESET = (
        3, "a latched fault was acknowledged",
        (_a("fault", "fault", Fault),),
        "fault {fault.name} reset", "info", OfFault.RESET,
    )  # fmt: skip
    START_ANEW = (
        120, "a reset of the silence: the loop ends, the next one starts all devices up",
        (_a("fault", "fault", Fault),),
        "fault {fault.name} reset: the loop ends, the next one starts all devices up and is DISARMED",
    )  # fmt: skip
    LIMIT = 15, "a limit that only logs is exceeded", _TRIPPED, _limit_words, "warning", OfFault.BEGINS
    LIMIT_OVER = (
        16, "such a limit is kept again, or is not watched any more (value: null)", _TRIPPED, _limit_over_words,
        "info", OfFault.ENDS,
    )  # fmt: skip
    CAUSE = (
        45, "a further cause while a fault is latched", _TRIPPED,
        lambda e: f"{e.fault.name} is active: {fault_text(e.fault, e.value, e.limit, e.seen)}", "error",
        OfFault.BEGINS,
    )  # fmt: skip
    CAUSE_OVER = (
        46, "such a cause, or the one that tripped, is gone", _TRIPPED,
        lambda e: f"{e.fault.name} is cleared{e.seen and f': {e.seen}'}", "info", OfFault.ENDS,
    )  # fmt: skip
    ESCALATION = (
        42, "the reaction to a fault did not help",
        (_a("fault", "fault (see faults)", Fault), _b("symptom", "symptom", Symptom),
         _value("value", "what was found, in the symptom's unit"),
         _limit("limit", "what is allowed, in the same unit"),
         _text("brake", "not empty where the brake is known not to hold")),
        _escalation_words, "error", OfFault.BEGINS,
    )  # fmt: skip
    EXCEPTION = (
        6, "exception in the loop, which holds",
        (_text("error", "what and where"),),
        "exception in the loop: {error}", "error",
    )  # fmt: skip

    # The loop
    STARTED = (
        9, "the loop runs",
        (_a("commands", "slots in the ring of commands from before it"),
         _b("holds", "slots in the ring of HOLDs from before it")),
        "loop started, DISARMED",
    )  # fmt: skip
    STOPPED = (
        10, "the loop ended",
        (_value("stroke_mm", "stroke in mm"), _limit("tension_n", "tension in N")),
        "loop stopped, stroke {stroke_mm:.2f} mm, tension {tension_n:z.1f} N",
    )  # fmt: skip
    ENDING = (
        58,
        "an end that a load delays",
        (
            _a(
                "step",
                "1 the motor goes on carrying, 2 it lowers the load, 3 it has lowered it, 4 a second signal leaves the "
                "load, 5 the motor has it no more, 6 it is not lowered in time",
                EndStep,
                beyond=True,
            ),
            _value("time_s", "of 1 the time until it is lowered, from 3 on that since the request, both in s"),
            _limit("tension_n", "tension in N"),
        ),
        lambda e: _ending(e)[1].format(e.time_s, e.tension_n),
        lambda e: _ending(e)[0],
        OwnAlarm(Priority.URGENT, Fault.BRAKE_SLIPS, lasts=True),
    )
    CLOCK = (
        11, "the loop could not keep its rate",
        (_a("ticks", "ticks skipped at once"),),
        lambda e: f"{count(e.ticks, 'tick')} skipped at once", "warning",
    )  # fmt: skip
    LOCAL_HOLD = (
        65, "HOLD was taken from the local socket",
        (_a("uid", "user id"), _b("process", "process"), _text("operator", "operator; see the MODE event")),
        "HOLD from {operator} via the local socket (uid {uid}, process {process})",
    )  # fmt: skip
    HOLD_SOCKET_CLOSED = (
        66, "a user's socket for HOLD is read no more: a process of the user sent a descriptor along",
        (_a("uid", "user id"), _b("process", "process")),
        "the HOLD socket of uid {uid} is read no more: process {process} sent a descriptor along; HOLD of that user "
        "goes over the network until the loop starts anew",
        "warning",
    )  # fmt: skip

    # The bus and its devices
    EMERGENCY = (
        4, "emergency message of a device (CiA 301)",
        (_NODE, _b("code", "code", bits=16), _b("register", "error register", shift=16, bits=8),
         _text("manufacturer", "the manufacturer's bytes; a code 0x00xx with register 0 when it is over")),
        _emergency_words, _emergency_severity, OwnAlarm(Priority.LOW, Fault.SENSOR_EMERGENCY, lasts=True),
    )  # fmt: skip
    NODE_STATE = (
        5, "state of a device changed",
        (_NODE, _b("state", "NMT state (CiA 301)", NmtState, beyond=True)),
        lambda e: f"node {e.node}: {NMT_WORDS.get(e.state, f'unknown state {e.state}')}",
        lambda e: "info" if e.state is NmtState.OPERATIONAL else "warning",
    )  # fmt: skip
    BUS_ERROR = (
        7, "CAN error frame",
        (_a("classes", "error class bits"), _b("details", "details")),
        lambda e: f"CAN error frame: {can_errors.in_words(e.classes, e.details)}",
        lambda e: "error" if can_errors.is_grave(e.classes) else "warning", _BUS_FAILS,
    )  # fmt: skip
    SEND_FAILED = 8, "a frame could not be sent", (_NOT_SENT,), "frame not sent: {why}", "warning", _BUS_FAILS
    RECEIVE_FAILED = 17, "the bus could not be read", (_NOT_SENT,), "bus not readable: {why}", "warning", _BUS_FAILS
    FOREIGN_SDO = (
        50, "another master speaks to a device",
        (_NODE, *_OBJECT, _text("what", "what")),
        "another master {what}: find it and stop it", "warning", OwnAlarm(Priority.LOW, Fault.RIVAL),
    )  # fmt: skip
    FOUND_AT_START = (
        121, "what a former controller had left in the drive",
        (_NODE, _b("index", "index", shift=8), _value("found", "it"),
         _limit("left", "as start-up has left it; of 0x6041 the drive's state")),
        _found_at_start_words, "warning",
    )  # fmt: skip
    SETTING_LOST = (
        51, "a device does not keep an object as start-up wrote it",
        (_NODE, *_OBJECT, _value("found", "found, null for no answer"), _limit("wanted", "wanted"),
         _text("setting", "the setting in words")),
        "a device's setting is lost: {setting}", "error", OwnAlarm(Priority.LOW, Fault.SUPERVISION_LOST),
    )  # fmt: skip
    READ_BACK = (
        52, "the devices' settings were read back before arming",
        (_a("settings", "how many"), _value("took_s", "how long it took in s")),
        lambda e: f"{count(e.settings, 'setting')} of the devices read back in {e.took_s:.2f} s",
    )  # fmt: skip

    # Stroke, brake and load
    STROKE = (
        53, "whether the drive's position is believed",
        (_a("believed", "1 it is, 0 not", bool), _value("stroke_mm", "it in mm"),
         _limit("last_mm", "the last one known in mm, null for none"), _text("why", "why")),
        lambda e: f"stroke {e.stroke_mm:z.2f} mm: {e.why}" if e.believed else stroke_words(e.stroke_mm, e.why),
        lambda e: "info" if e.believed else "warning", OwnAlarm(Priority.LOW, Fault.STROKE_JUMPED, lasts=True),
    )  # fmt: skip
    STROKE_LEFT = (
        40, "a stroke that is to stay left its latch",
        (_a("mode", "mode", Mode), _value("off_mm", "distance in mm"),
         _limit("reported_mm", "distance beyond which it is reported")),
        lambda e: (
            f"{e.mode.name}: the stroke is {e.off_mm:+.2f} mm from where it was latched (reported beyond "
            f"{e.reported_mm:.2f} mm): "
            + (
                "the brake slips, or the screw is turned"
                if e.mode is Mode.DISARMED
                else "the drive creeps, or the brake slips"
            )
        ),
        "warning", OwnAlarm(Priority.LOW, Fault.STROKE_NOT_HELD),
    )  # fmt: skip
    DRIVE_CREEPS = (
        41, "the drive creeps when commanded 0, and is corrected",
        (_value("creep_mm_s", "creep in mm/s"), _limit("reported_mm_s", "creep beyond which it is reported")),
        "the drive creeps at {creep_mm_s:+.2f} mm/s when commanded 0 (reported beyond {reported_mm_s:.2f} mm/s); HOLD "
        "corrects it: check the drive's velocity offset (0x60B1) and its tuning",
        "warning", OwnAlarm(Priority.LOW, Fault.STROKE_NOT_HELD),
    )  # fmt: skip
    SIGNS = (
        13, "first tensioning: signs checked",
        (_a("scale_unchecked", "1 where the stiffness is off and nothing else checks the cell's scale", bool),
         _value("stiffness_n_mm", "stiffness found in N/mm"), _limit("plant_n_mm", "the plant's")),
        lambda e: (
            f"signs checked: the stroke follows, tension rises by {e.stiffness_n_mm:.2f} N/mm (plant: "
            f"{e.plant_n_mm:.2f} N/mm)"
            + (
                "; nothing else checks the cell's scale: compare it with a known weight (rigctl calibrate)"
                if e.scale_unchecked
                else ""
            )
        ),
        lambda e: "warning" if e.scale_unchecked else "info",
    )  # fmt: skip
    BRAKE_TEST = (
        55, "brake test at arm",
        (_a("held", "1 held, 0 rope slack", bool), _value("moved_mm", "stroke moved in mm"),
         _limit("tension_n", "tension in N")),
        lambda e: (
            f"brake test: held {e.tension_n:.1f} N for 2 s, stroke moved {e.moved_mm:z.3f} mm"
            if e.held
            else "brake test not possible: the rope is slack"
        ),
    )  # fmt: skip
    BRAKE_FLAG = (
        56, "the brake is known not to hold, or holds again",
        (_a("fails", "1 it does not hold, 0 it holds", bool), _b("assumed", "1 that is assumed", bool),
         _value("tension_n", "tension in N"), _limit("test_n", "tension of a test in N"), _text("why", "why")),
        _brake_flag_words, lambda e: "error" if e.fails else "info",
    )  # fmt: skip
    WITNESS = (
        57, "the operator has named what the motor carries the load by",
        (_a("witness", "1 encoder, 2 cell", Witness, beyond=True), _text("command", "command")),
        lambda e: f"{e.command} by the {_WITNESS_WORDS.get(e.witness, 'witness')} alone, as the operator has named it",
        "warning",
    )  # fmt: skip
    HELD = (
        100, "what carries the load has changed",
        (_a("from", "from", HeldBy, beyond=True), _b("to", "to, see held_by", HeldBy),
         _value("longest_s", "longest time in s for which the motor holds, 0: hold.park_s"),
         _text("why", "the command that needs it, or the mode")),
        _held_words, lambda e: "warning" if e.to is HeldBy.UNKNOWN else "info",
    )  # fmt: skip
    POWER_OFF = (
        102, "a power off is confirmed, or is not in time",
        (_a("shown", "see power_off", PowerOff, beyond=True),
         _b("brake_fails", "1 the brake is known not to hold", bool), _value("after_s", "s since the command")),
        _power_off_words, lambda e: "info" if _power_off(e).confirmed else "error",
    )  # fmt: skip
    LOAD_AT_REST = (
        103, "on the closed brake the load has begun to move, is not seen any more, or is at rest again",
        (_a("from", "from", LoadAtRest, beyond=True), _b("to", "to, see load_at_rest", LoadAtRest, beyond=True),
         _text("mode", "the mode")),
        lambda e: f"{e.mode}: load at rest on the brake: {_rest(e).words}",
        lambda e: "info" if _rest(e).rests else "warning",
    )  # fmt: skip

    # The cell and the law
    CORRECTION = (
        12, "tare or calibration in force", _CORRECTED, "tension cell: zero {zero_n:+z.3f} N, scale {scale:.5f}",
    )  # fmt: skip
    SECOND_FORCE = (
        73, "zero and scale of the second force path in force", _CORRECTED,
        "second force path: zero {zero_n:+z.3f} N, scale {scale:.5f}",
    )  # fmt: skip
    CREEP = (
        70, "creep of the cell taken out from now on",
        (_a("history_known", "1 the load's history is known, 0 it is taken as always the present load", bool),
         _value("share", "whole share of the load"), _text("terms", "shares and time constants in s")),
        _creep_words,
    )  # fmt: skip
    LOAD_STEP = (
        71, "part of a record of the cell's creep",
        (_a("samples", "samples"), _b("cell_mk", "temperature of the cell in mK, 0 for not known"),
         _value("mean_n", "their mean reading in N"),
         _limit("after_s", "their mean time after the load's step in s, negative before it"),
         _text("rms_n", "rms in N")),
        lambda e: (
            f"creep: {count(e.samples, 'sample')}, mean {e.mean_n:.4f} N, {e.after_s:.1f} s after the load's step"
        ),
    )  # fmt: skip
    GAINS = (
        14, "gains changed",
        (_text("gains", "K_T, K_v, K_i now in force"),),
        "gains changed: K_T, K_v, K_i = {gains}",
    )  # fmt: skip
    NO_MARGINS = (
        101,
        "a minute of COMPENSATING gave no margins",
        (
            _a(
                "why",
                "why (0 other, 1 command limited, 2 ticks skipped, 3 multisine too weak, 4 multisine not at its level)",
                Unmeasured,
                beyond=True,
            ),
        ),
        lambda e: f"margins not measured in the last minute: {UNMEASURED.get(e.why, '')}",
        "warning",
    )
    MARGINS_DIFFER = (
        104, "the sensitivity measured in the last minute is not one of the design's family",
        (_value("measured", "|S| as measured"), _limit("predicted", "the nearest predicted")),
        "the loop's sensitivity is not the design's: |S| {measured:.2f} measured, {predicted:.2f} predicted; no other "
        "gains are taken until rigctl identify --response and rigctl tune --from",
        "warning",
    )  # fmt: skip
    MOVE = (
        80, "a marked move begins",
        (_a("move", "its number, 0 it has ended"), _b("learnt_from", "moves its table was learnt from")),
        _move_words,
    )  # fmt: skip
    LEARNT = (
        81, "learnt from a move", _LEARNT,
        lambda e: (
            f"move {e.move}: {e.rms_n:.3f} N rms, {e.first_rms_n:.3f} N in the first; learnt from "
            f"{count(e.learnt_from, 'move')}"
        ),
    )  # fmt: skip
    NOT_LEARNT = (
        82, "a move taught nothing",
        (*_LEARNT, _text("why", "why; b 0: its table is dropped")),
        _not_learnt_words, lambda e: "info" if e.learnt_from else "warning",
    )  # fmt: skip

    @property
    def sentence(self) -> str:
        """The meaning of the kind and of the values of its slot, for ``meta/schema``."""
        return "; ".join(filter(None, (self.meaning, ", ".join(self._slots()))))

    def _slots(self) -> Iterator[str]:
        for slot, fields in groupby(self.fields, lambda field: field.slot):
            yield f"{slot}: " + " | ".join(
                f"{field.meaning} << {field.shift}" if field.shift else field.meaning for field in fields
            )

    def read(self, a: int, b: int, value: float, limit: float, text: str) -> dict[str, Any]:
        """The fields of an event by name, see `EventField.read`."""
        slot = {"a": a, "b": b, "value": value, "limit": limit, "text": text}
        return {field.name: field.read(slot[field.slot]) for field in self.fields}


EACH_SECOND = tuple(kind.name for kind in Kind if isinstance(kind.alarm, OwnAlarm) and kind.alarm.each_second)
"""Names of the kinds that the loop repeats every second while their cause is there."""


@dataclass(frozen=True)
class Worded:
    """An event for people: key ending (info, warning, error) and one line."""

    severity: str
    text: str


def worded(kind: int, a: int, b: int, value: float, limit: float, text: str) -> Worded:
    """An ``EVENT`` slot in words.

    Raises:
        ValueError: of no kind, or with a number that its enumeration does not have.
    """
    row = Kind(kind)
    fields = row.read(a, b, value, limit, text)
    for field in row.fields:
        if not (field.beyond or field.fits(fields[field.name])):
            raise ValueError(f"{row.name}: {fields[field.name]} is no {field.name}")
    found = SimpleNamespace(**fields)
    severity, words = (of(found) if callable(of) else of.format(**fields) for of in (row.severity, row.words))
    return Worded(severity, words)
