"""Commands on the wire: the payload of a query and the text of its answer. Pure functions of bytes and values."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

import msgspec

from rigctl.config.built_type import built
from rigctl.config.one_line import on_one_line
from rigctl.control.arming import LONG_TEST_NS
from rigctl.ipc.hold_socket import HELD, HoldAnswer
from rigctl.ipc.record import figure_of
from rigctl.ipc.ring import RingReader
from rigctl.model.check_words import failed_checks
from rigctl.model.checks import Check
from rigctl.model.faults import Fault
from rigctl.model.quantity import significant
from rigctl.model.refusal_words import refusal_text
from rigctl.model.states import Flag, Mode, Witness
from rigctl.model.verbs import Refusal, Verb
from rigctl.wire.lease import ACTS, ID_BYTES, is_id
from rigctl.wire.meanings import VERBS as MEANINGS
from rigctl.wire.record_names import ALIVE_NS
from rigctl.wire.user_name import LONGEST

VERBS = {verb.name.lower(): verb for verb in Verb}
REGULATED = {"hold": 0.0, "compensating": 1.0}
"""Where a RESPONSE may be measured, and the number in its slot."""
WITNESSES = {"": Witness.BOTH, "encoder": Witness.ENCODER, "cell": Witness.CELL}
"""What a CARRY or LOWER goes by, as the operator names it."""
_OPTIONS = (
    "value", "shunt", "adopt", "tight", "near_end", "supported", "creep_s", "where", "by", "gain_file", "name",
)  # fmt: skip
PAYLOAD_BYTES = 16_384  # room for a gain file
_ALLOWED = '{"operator": "NAME"}'
_ALLOWED_MORE = {
    Verb.ARM: '{"operator": "NAME"} and "near_end": true',
    Verb.TARGET: '{"operator": "NAME", "value": NEWTONS}',
    Verb.CONFIRM_STROKE: '{"operator": "NAME", "value": MILLIMETRES}',
    Verb.RELEASE: '{"operator": "NAME"} and "value": MILLIMETRES of a slack rope',
    Verb.BRAKE_TEST: '{"operator": "NAME", "supported": true}',
    Verb.MOVE: '{"operator": "NAME", "value": NUMBER}',
    Verb.CARRY: '{"operator": "NAME", "value": SECONDS} and "by": "encoder" or "cell"',
    Verb.LOWER: '{"operator": "NAME"} and "by": "encoder" or "cell"',
    Verb.CALIBRATE: '{"operator": "NAME"} and "value": NEWTONS or "shunt": true, "adopt": true, "creep_s": SECONDS',
    Verb.IDENTIFY: '{"operator": "NAME"} and "tight": true',
    Verb.RESPONSE: '{"operator": "NAME"} and "where": "hold" or "compensating"',
    Verb.GAINS: '{"operator": "NAME", "gain_file": TEXT, "name": "FILE"}',
}


class RequestError(ValueError):
    """A query that is not a valid command; ``str()`` says what was found and what is expected."""


@built
class _CommandPayload(msgspec.Struct, forbid_unknown_fields=True):
    operator: str
    lease: Any = None
    value: float | None = None
    shunt: bool = False
    adopt: bool = False
    tight: bool = False
    near_end: bool = False
    supported: bool = False
    creep_s: float | None = None
    where: str = ""
    by: str = ""
    gain_file: str = ""
    name: str = ""
    run_id: str = ""


@dataclass(frozen=True)
class Request:
    """A command as an operator gives it.

    ``value``: target of TARGET or known weight of CALIBRATE in N, stroke of CONFIRM_STROKE in mm,
    number of a MOVE, time of a CARRY in s, length of a RELEASE of a slack rope in mm, else NaN.
    ``shunt``: CALIBRATE compares with the shunt. ``adopt``: it sets a new scale, or the creep. ``creep_s``: it records
    the creep for so long, NaN for a mean. ``tight``: IDENTIFY needs a tight rope. ``near_end``: ARM at an end of the
    stroke, to drive away from it. ``where``: RESPONSE only in that mode, hold or compensating; empty for the mode that
    it is in. ``supported``: BRAKE_TEST has the payload supported from below.
    ``by``: CARRY or LOWER by encoder or cell alone; empty for both.
    ``gain_file``, ``name``: text and name of a gain file, for GAINS.
    ``lease``: id of the lease it is given under, None without one.
    ``run_id``: run of the daemon it is meant for, empty for any.
    """

    verb: Verb
    operator: str
    value: float = math.nan
    shunt: bool = False
    adopt: bool = False
    tight: bool = False
    lease: str | None = None
    gain_file: str = ""
    name: str = ""
    near_end: bool = False
    supported: bool = False
    where: str = ""
    run_id: str = ""
    creep_s: float = math.nan
    by: str = ""

    @property
    def command(self) -> str:
        """The command's name, as its key ends."""
        return self.verb.name.lower()

    @property
    def numbers(self) -> tuple[float, ...]:
        """The numbers in the command's slot, in the order of `rigctl.model.verbs.VALUES`."""
        second = {Verb.CALIBRATE: self.creep_s, Verb.CARRY: float(WITNESSES[self.by])}
        return (self.number, second[self.verb]) if self.verb in second else (self.number,)

    @property
    def number(self) -> float:
        """The number in the command's slot of the ring."""
        options = {
            Verb.IDENTIFY: float(self.tight), Verb.ARM: float(self.near_end),
            Verb.RESPONSE: REGULATED.get(self.where, math.nan), Verb.LOWER: float(WITNESSES[self.by]),
        }  # fmt: skip
        return options.get(self.verb, self.value)


def verb_of(name: str) -> Verb:
    """The verb a key ends in.

    Raises:
        RequestError: there is no such verb; the message names the verbs.
    """
    verb = VERBS.get(name)
    if verb is None:
        raise RequestError(f"found the command {name[:40]!r}, expected {', '.join((*VERBS, *ACTS))}")
    return verb


_Some = TypeVar("_Some")


def decoded(payload: bytes | None, kind: type[_Some], allowed: str) -> _Some:
    """A payload decoded as ``kind``; ``allowed``: the expected form, for the message.

    Raises:
        RequestError: no payload, too long, bad JSON, an unknown key, a wrong type.
    """
    if not payload:
        raise RequestError(f"found no payload, expected {allowed}")
    if len(payload) > PAYLOAD_BYTES:
        raise RequestError(f"found {len(payload)} bytes, expected {allowed}")
    try:
        return msgspec.json.decode(payload, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise RequestError(f"{on_one_line(str(error))}, expected {allowed}") from None


def operator_of(text: str) -> str:
    """An operator's name.

    Raises:
        RequestError: empty, too long or not printable.
    """
    operator = text.strip()
    if not operator or len(operator) > LONGEST or not operator.isprintable():
        raise RequestError(f"found operator {text[:80]!r}, expected 1 to {LONGEST} printable letters")
    return operator


def lease_of(found: Any) -> str | None:
    """The id of a lease that a payload shows, None without one. The message of an error does not show it.

    Raises:
        RequestError: it has not the form of an id.
    """
    if found is None or (isinstance(found, str) and is_id(found)):
        return found
    what = f"text of {len(found)} letters" if isinstance(found, str) else type(found).__name__
    raise RequestError(f"found lease: {what}, expected the id from the answer, {2 * ID_BYTES} hexadecimal digits")


def parse(verb: Verb, payload: bytes | None) -> Request:
    """Read a command's payload.

    Raises:
        RequestError: bad JSON, an unknown key, a missing or non-finite value, a wrong type.
    """
    allowed = _ALLOWED_MORE.get(verb, _ALLOWED)
    found = decoded(payload, _CommandPayload, allowed)
    operator = operator_of(found.operator)
    _, options = MEANINGS[verb]
    for name in _OPTIONS:
        if name not in options and getattr(found, name) not in (None, False, ""):
            raise RequestError(f"found {name}, expected {allowed}")
    if verb is Verb.GAINS and not (found.gain_file and found.name and found.name.isprintable()):
        raise RequestError(f"found no gain file with a name, expected {allowed}")
    if verb is Verb.BRAKE_TEST and not found.supported:
        raise RequestError(f"found no supported: true, which says that the payload is, expected {allowed}")
    if found.where not in ("", *REGULATED):
        raise RequestError(f"found where: {found.where[:40]!r}, expected {' or '.join(REGULATED)}")
    if found.by not in WITNESSES:
        raise RequestError(f"found by: {found.by[:40]!r}, expected encoder or cell")
    if found.value is None and verb in (Verb.TARGET, Verb.CONFIRM_STROKE, Verb.MOVE, Verb.CARRY):
        raise RequestError(f"found no value, expected {allowed}")
    for number in (found.value, found.creep_s):
        if number is not None and not math.isfinite(number):
            raise RequestError(f"found value {number}, expected a finite number")
    if verb is Verb.RELEASE and found.value is not None and found.value <= 0.0:
        raise RequestError(f"found value {found.value:g}, expected a length of rope above 0 mm")
    value = math.nan if found.value is None else found.value
    try:
        lease = lease_of(found.lease)
    except RequestError:
        if verb is not Verb.HOLD:  # HOLD needs no lease, so what is no id must not refuse it
            raise
        lease = None
    creep_s = math.nan if found.creep_s is None else found.creep_s
    given = msgspec.structs.asdict(found) | {"operator": operator, "value": value, "creep_s": creep_s, "lease": lease}
    return Request(verb, **given)


@dataclass(frozen=True)
class NewestRecord:
    """Values of the newest record that an answer may mention."""

    fault: Fault = Fault.NONE
    stroke_mm: float = math.nan
    tension_n: float = math.nan
    target_n: float = math.nan
    standing: Mapping[Fault, str] = field(default_factory=dict)  # causes in words, the strongest first
    arming: bool = False  # an ARM is being carried out, and the loop runs


def newest_record(records: RingReader, standing: Mapping[Fault, str] = MappingProxyType({})) -> NewestRecord:
    """`NewestRecord` of the ring; ``standing``: causes in words, the strongest first."""
    record = records.latest()
    if record is None:
        return NewestRecord()
    try:
        fault = Fault(int(record["fault"]))
    except ValueError:
        fault = Fault.NONE
    stroke_mm, tension_n, target_n = (float(record[name]) for name in ("stroke_mm", "tension_n", "target_n"))
    alive = time.monotonic_ns() - int(record["t_ns"]) < ALIVE_NS
    arming = alive and bool(int(record["flags"]) & Flag.ARMING)
    return NewestRecord(fault, stroke_mm, tension_n, target_n, standing, arming)


_DONE = {
    Verb.ARM: "armed, {mode}, stroke {stroke}, tension {tension}",
    Verb.TENSION: "ramping to {target}, {mode}",
    Verb.RELEASE: "ramping to slack, {mode}",
    Verb.HOLD: HELD,
    Verb.DISARM: "drive off, brake closed, {mode}{latched}",
    Verb.RESET: "fault cleared, {mode}",
    Verb.TARGET: "{newtons}, {mode}",
    Verb.TARE: "the cell reads {value:z.3f} N, {mode}",
    Verb.CALIBRATE: "the cell reads {value:z.3f} N, {mode}",
    Verb.IDENTIFY: "excited for {value:.1f} s, {mode}, stroke {stroke}",
    Verb.RESPONSE: "excited for {value:.0f} s, {mode}",
    Verb.CONFIRM_STROKE: "the stroke is {value:z.2f} mm, {mode}",
    Verb.CARRY: "the motor carries the load for {value:.0f} s and lowers it then, {mode}",
    Verb.LOWER: "the motor lowers the load until the rope is slack, {mode}",
    Verb.BRAKE_TEST: f"the brake has held {{value:.0f}} N for {LONG_TEST_NS * 1e-9:g} s, the motor has it, {{mode}}",
    Verb.MOVE: "learnt from {value:.0f} moves so far, {mode}",
    Verb.GAINS: "{mode}",
}


_ANEW = "the loop ends, and the next one starts all devices up; it is DISARMED once they answer"
"""To a RESET of the silence, which leaves the fault to the loop that ends."""


def _done(request: Request, mode: Mode, value: float, newest: NewestRecord) -> str:
    verb = request.verb
    if verb is Verb.RESET and mode is Mode.FAULT:
        return _ANEW
    if request.value > 0.0 and verb is Verb.RELEASE:
        return f"paying out {request.value:.1f} mm of rope, {mode.name}"
    return _DONE[verb].format(
        mode=mode.name,
        latched=", the fault stays latched" if mode is Mode.FAULT else "",
        value=value,
        newtons=significant(value, "N"),
        target=significant(newest.target_n, "N"),
        stroke=f"{newest.stroke_mm:z.2f} mm",
        tension=f"{newest.tension_n:z.1f} N",
    )


def refused(name: str, operator: str, reason: str, text: str, **more: Any) -> dict[str, Any]:
    """The answer to a command that was not carried out."""
    verb = name.upper() if name in VERBS else "LEASE" if name in ACTS else "COMMAND"
    return {
        "accepted": False, "verb": name, "operator": operator, "reason": reason,
        "text": f"{verb} refused: {text}", **more,
    }  # fmt: skip


def hold_refused(given: HoldAnswer, operator: str) -> dict[str, Any]:
    """The answer to a HOLD that the loop has refused on its own socket."""
    refusal = Refusal(given.reason)
    text = refusal_text(refusal, Verb.HOLD, Mode[given.mode], given.checks, Fault(given.fault), (0.0, 0.0))
    return refused("hold", operator, refusal.name.lower(), text)


def silent(name: str, operator: str) -> dict[str, Any]:
    """The answer when the loop gives none: whether the command was carried out is unknown."""
    text = "the control loop does not answer"
    return {**refused(name, operator, "no_answer", text), "text": f"{name.upper()}: {text}"}


def _by_words(waived: Mapping[Check, str]) -> str:
    """``calibration, tare (the waiver's words), realtime (...)``."""
    checks: dict[str, list[str]] = {}
    for check, words in waived.items():
        checks.setdefault(words, []).append(_plain(check))
    return ", ".join(f"{', '.join(names)} ({words})" for words, names in checks.items())


def _plain(check: Check) -> str:
    return (check.name or "").lower().replace("_", " ")


def answer(
    request: Request,
    reply: Any,
    newest: NewestRecord,
    limits_n: tuple[float, float],
    failing: Mapping[Check, str] = MappingProxyType({}),
    waived: Mapping[Check, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """A ``REPLY`` slot as the answer to ``request``.

    ``limits_n``: lowest and highest target. ``failing``: details of failing checks. ``waived``: words of the waivers.
    """
    verb, mode, value = request.verb, Mode(int(reply["mode"])), figure_of(reply)
    name = verb.name.lower()
    about = {"mode": mode.name, "t_ns": int(reply["t_ns"]), "value": value if math.isfinite(value) else None}
    if reply["accepted"]:
        taken_s = float(reply["taken_s"])
        first = f"taking the load from the brake, {taken_s:.1f} s; " if math.isfinite(taken_s) else ""
        text = f"{verb.name}: {first}{_done(request, mode, value, newest)}"
        if verb is Verb.ARM and waived:
            text += f"; waived: {_by_words(waived)}"
            about["waived"] = {_plain(check): words for check, words in waived.items()}
        return {"accepted": True, "verb": name, "operator": request.operator, "text": text, **about}
    refusal, checks = Refusal(int(reply["reason"])), int(reply["checks"])
    named = refusal is Refusal.CAUSE_PRESENT and value in Fault._value2member_map_
    cause = Fault(int(value)) if named else newest.fault
    text = refusal_text(refusal, verb, mode, checks, cause, limits_n, value, failing, newest.standing)
    more = {"checks": failed_checks(checks, failing)} if refusal is Refusal.PREFLIGHT else {}
    return refused(name, request.operator, refusal.name.lower(), text, **about, **more)
