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
from rigctl.ipc.hold_socket import HoldAnswer
from rigctl.ipc.record import figure_of
from rigctl.ipc.ring import RingReader
from rigctl.model.check_words import failed_checks
from rigctl.model.checks import Check
from rigctl.model.faults import Fault
from rigctl.model.lease_acts import ACTS, ID_BYTES, is_id
from rigctl.model.quantity import significant
from rigctl.model.refusal_words import refusal_text
from rigctl.model.requests import Request
from rigctl.model.states import Flag, Mode
from rigctl.model.verbs import Option, Refusal, Verb
from rigctl.wire.record_names import ALIVE_NS
from rigctl.wire.user_name import LONGEST

VERBS = {verb.name.lower(): verb for verb in Verb}
PAYLOAD_BYTES = 16_384  # room for a gain file
_OPTIONS: dict[str, Option] = {option.name: option for verb in Verb for option in verb.row.options}
"""Fields that a payload may have for some command; those of one name are of one kind."""


def expected(verb: Verb) -> str:
    """The form of a command's payload, for the words about another."""
    needs = "".join(f', "{option.name}": {option.form}' for option in verb.row.options if option.required)
    may = ", ".join(f'"{option.name}": {option.form}' for option in verb.row.options if not option.required)
    return f'{{"operator": "NAME"{needs}}}' + (f" and {may}" if may else "")


class RequestError(ValueError):
    """A query that is not a valid command; ``str()`` says what was found and what is expected."""


_NOT_GIVEN: dict[type, Any] = {bool: False, float: None, str: ""}
_CommandPayload: Any = built(
    msgspec.defstruct(
        "_CommandPayload",
        [
            ("operator", str), ("lease", Any, None), ("run_id", str, ""),
            *((name, option.kind | None if option.kind is float else option.kind, _NOT_GIVEN[option.kind])
              for name, option in _OPTIONS.items()),
        ],
        forbid_unknown_fields=True,
    )
)  # fmt: skip


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
    allowed = expected(verb)
    found = decoded(payload, _CommandPayload, allowed)
    operator = operator_of(found.operator)
    own = {option.name: option for option in verb.row.options}
    for name, option in _OPTIONS.items():
        given = getattr(found, name)
        if name not in own and given != _NOT_GIVEN[option.kind]:
            raise RequestError(f"found {name}, expected {allowed}")
        if option.choices and given not in option.choices:
            words = " or ".join(filter(None, option.choices))
            raise RequestError(f"found {name}: {given[:40]!r}, expected {words}")
    for option in own.values():
        if option.required and getattr(found, option.name) == _NOT_GIVEN[option.kind]:
            raise RequestError(f"found no {option.name}, expected {allowed}")
        number = getattr(found, option.name) if option.kind is float else None
        if number is not None and not math.isfinite(number):
            raise RequestError(f"found {option.name} {number}, expected a finite number")
        if number is not None and option.positive and number <= 0.0:
            raise RequestError(f"found {option.name} {number:g}, expected {option.positive}")
    if not found.name.isprintable():
        raise RequestError(f"found a name that is not printable, expected {allowed}")
    try:
        lease = lease_of(found.lease)
    except RequestError:
        if verb is not Verb.HOLD:  # HOLD needs no lease, so what is no id must not refuse it
            raise
        lease = None
    given = {name: value for name, value in msgspec.structs.asdict(found).items() if value is not None}
    return Request(verb, **given | {"operator": operator, "lease": lease})


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


_ANEW = "the loop ends, and the next one starts all devices up; it is DISARMED once they answer"
"""To a RESET of the silence, which leaves the fault to the loop that ends."""


def _done(request: Request, mode: Mode, value: float, newest: NewestRecord) -> str:
    verb = request.verb
    if verb is Verb.RESET and mode is Mode.FAULT:
        return _ANEW
    if request.value > 0.0 and verb is Verb.RELEASE:
        return f"paying out {request.value:.1f} mm of rope, {mode.name}"
    return verb.row.done.format(
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
