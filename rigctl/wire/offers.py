"""What each command would be answered now: the gateway has it from the loop's situation, every display reads it.

The loop answers a command by the same function (`rigctl.control.modes.answer`), so that an offer differs from the
answer only by what has changed since: its age is beside it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from rigctl.control.commands.situation import Situation, of_slot
from rigctl.control.modes import answer, barring
from rigctl.model.checks import Check
from rigctl.model.faults import Fault
from rigctl.model.quantity import significant
from rigctl.model.refusal_words import refusal_text
from rigctl.model.states import Mode
from rigctl.model.verbs import CARRY_S, Refusal, Verb

BUTTONS = tuple(sorted((verb for verb in Verb if verb.row.button), key=lambda verb: verb.row.button))
"""In the order of the page's bar, after HOLD, which is always there."""
PAY_OUT = "pay_out"
"""RELEASE with a length: on a slack rope, where RELEASE alone has nothing to do."""
NO_LOOP = "the loop does not run"


def offers(slot: Any, now_ns: int, known: Mapping[Check, str], standing: Mapping[Fault, str]) -> dict[str, Any] | None:
    """Of a ``SITUATION`` slot, by verb: ``refused``, why, "" where it is accepted; ``reasons``; ``bounds``; ``age_ms``.

    Args:
        slot: None: the loop has written none yet.
        now_ns: CLOCK_MONOTONIC.
        known: details of failing checks.
        standing: causes present now, in words, the strongest first.
    """
    if slot is None or slot["mode"] not in list(Mode):
        return None
    mode, situation = Mode(int(slot["mode"])), of_slot(slot)
    room_mm = situation.room_mm
    given: dict[str, tuple[Verb, dict[str, float]]] = {verb.name.lower(): (verb, {}) for verb in Verb} | {
        "carry": (Verb.CARRY, {"carry_s": CARRY_S[0]}),
        "target": (Verb.TARGET, {"target_n": situation.target_min_n}),
        "confirm_stroke": (Verb.CONFIRM_STROKE, {"stroke_mm": situation.stroke_mm}),
        PAY_OUT: (Verb.RELEASE, {"length_mm": min(1.0, room_mm) if room_mm > 0.0 else 1.0}),
    }  # values with which a command is judged that needs one: its bounds are beside the offer
    refusals = {name: answer(mode, verb, situation.given(values)).refusal for name, (verb, values) in given.items()}
    return {
        "age_ms": round((now_ns - int(slot["t_ns"])) / 1e6, 1),
        "refused": {
            name: _in_words(refusal, mode, given[name][0], situation, known, standing)
            for name, refusal in refusals.items()
        },
        "reasons": {name: refusal.name for name, refusal in refusals.items() if refusal is not Refusal.NONE},
        "bounds": {
            "target": [situation.target_min_n, situation.target_max_n],
            "carry": list(CARRY_S),
            PAY_OUT: [0.0, max(0.0, room_mm)] if math.isfinite(room_mm) else None,
        },
    }


def _in_words(
    refusal: Refusal, mode: Mode, verb: Verb, situation: Situation, known: Mapping[Check, str],
    standing: Mapping[Fault, str],
) -> str:  # fmt: skip
    if refusal is Refusal.NONE:
        return ""
    bits = situation.causes if refusal is Refusal.CAUSE_PRESENT else barring(verb, situation)
    limits = situation.target_min_n, situation.target_max_n
    fault = Fault(situation.fault) if situation.fault in list(Fault) else Fault.NONE
    return refusal_text(refusal, verb, mode, bits, fault, limits, _figure(refusal, situation), known, standing)


def _figure(refusal: Refusal, situation: Situation) -> float:
    """The figure that a refusal is about; 0 for none."""
    match refusal:
        case Refusal.SUNK:
            return situation.sunk_mm
        case Refusal.DISAGREE:
            return situation.apart_mm
        case Refusal.CARRIED:
            return situation.carried_s
        case Refusal.LOADED:
            return situation.reading_n
        case Refusal.LITTLE_LOAD:
            return situation.needed_n
        case Refusal.STOP_RUNNING:
            return situation.speed_mm_s
        case Refusal.STROKE_DIFFERS:
            return situation.stroke_mm
        case _:
            return float(situation.drive_state)


def refused_now(state: Mapping[str, Any]) -> dict[str, str]:
    """By verb why it would be refused now, from a state message; "" where it would be accepted."""
    found = state.get("offers")
    refused = found.get("refused") if isinstance(found, dict) else None
    if not state.get("loop_alive") or not isinstance(refused, dict):
        return _NONE_RUNS
    return {name: str(refused.get(name, NO_LOOP)) for name in _NONE_RUNS}


def bounds_of(state: Mapping[str, Any], name: str) -> tuple[float, float] | None:
    """Least and most of a command's value, by the verb or `PAY_OUT`; None where it has none, or it is not known."""
    found = state.get("offers")
    bounds = (found.get("bounds") or {}).get(name) if isinstance(found, dict) else None
    return (float(bounds[0]), float(bounds[1])) if bounds else None


def refused_with(state: Mapping[str, Any], verb: str, value: float | None) -> str:
    """Why a command with this value would be refused now; "" where it would be accepted."""
    name = PAY_OUT if verb == Verb.RELEASE.name.lower() and value is not None else verb
    if why := refused_now(state)[name]:
        return why
    bounds = bounds_of(state, name)
    if value is None or bounds is None or bounds[0] <= value <= bounds[1]:
        return ""
    return f"found {significant(value)}, expected {significant(bounds[0])} to {significant(bounds[1], _unit_of(verb))}"


def _unit_of(verb: str) -> str:
    """Of a command's number."""
    return next(option.field.unit for option in Verb[verb.upper()].row.options if option.field is not None)


def reason_now(state: Mapping[str, Any], verb: str) -> str:
    """Name of the refusal that a command would have now; "" for none, or where it is not known."""
    found = state.get("offers")
    return str((found.get("reasons") or {}).get(verb, "")) if isinstance(found, dict) else ""


_NONE_RUNS = dict.fromkeys((*(verb.name.lower() for verb in Verb), PAY_OUT), NO_LOOP)
_PRESENT = re.compile(r"cause still present: (\w+)")


def _shortened(why: str) -> str:
    """The first of several reasons and how many more there are: the banner and the checks have them in full."""
    if found := _PRESENT.match(why):
        return f"{found[1]} is active"
    first, *more = why.split("; ")
    return f"{first} and {len(more)} more" if more else first


def not_now(verbs: Mapping[str, str]) -> list[str]:
    """What is not possible, each reason once: "ARM, TENSION: not possible in FAULT: reset first"."""
    by_reason: dict[str, list[str]] = {}
    for verb, why in verbs.items():
        if why:
            reason = _shortened(why.replace(f"{verb} is not possible", "not possible", 1))
            by_reason.setdefault(reason, []).append(verb.upper())
    return [f"{', '.join(names)}: {why}" for why, names in by_reason.items()]
