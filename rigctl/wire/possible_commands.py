"""Which commands the modes table allows in a state, and why it does not allow the others."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rigctl.control.checks import Check
from rigctl.control.events import refusal_text
from rigctl.control.faults import Fault
from rigctl.control.modes import CARRY_S, Mode, Refusal, Situation, Verb, decide

VERBS = (
    Verb.RELEASE, Verb.DISARM, Verb.RESET, Verb.ARM, Verb.TENSION, Verb.TARGET, Verb.CARRY, Verb.LOWER,
)  # fmt: skip
"""In the order of the page's bar, after HOLD, which is always there."""
NO_LOOP = "the loop does not run"
NO_DRIVE = "nothing valid is heard of the drive"
_UNHEARD = frozenset({Fault.BUS_SILENT.name, Fault.SYNC_LOST.name, Fault.DRIVE_STALE.name})
_BY_DRIVE = frozenset({Verb.TARGET, Verb.CARRY, Verb.LOWER})
"""In FAULT too, and of no use without a drive that is heard."""


def possible(state: dict[str, Any], target_range_n: tuple[float, float] = (0.0, 0.0)) -> dict[str, str]:
    """By verb: "" for a command that the modes table allows now, else why not, in the words of the refusal.

    What only the loop knows (a slack rope, a drive's own fault) is left to the loop: it refuses then.
    """
    try:
        mode, fault = Mode[str(state.get("mode"))], Fault(state.get("fault_code") or 0)
    except (KeyError, ValueError):
        return {verb.name.lower(): NO_LOOP for verb in VERBS}
    if not state.get("loop_alive"):
        return {verb.name.lower(): NO_LOOP for verb in VERBS}
    found = state.get("causes")
    causes = [cause for cause in found if isinstance(cause, dict)] if isinstance(found, list) else []
    active = {
        Fault[str(cause["fault"])]: str(cause.get("text", ""))
        for cause in causes
        if cause.get("fault") in Fault.__members__ and cause.get("blocks_reset")
    }
    flags = state.get("flag_names", [])
    known = {
        Check[name]: words
        for name, words in ((state.get("preflight") or {}).get("failing") or {}).items()
        if name in Check.__members__
    }
    checks = int(state.get("checks") or 0) if mode is Mode.DISARMED else 0
    speed = state.get("speed_mm_s")
    situation = Situation(
        failed_checks=checks, cause_present=bool(active), stop_running="stopping" in flags,
        fault_latched=bool(fault), armed="drive_enabled" in flags,
        e_stop=Fault.E_STOP in active, brake_fails="brake_fails" in flags,
        drive_faulted=bool(checks & Check.DRIVE_FAULT), wanted_n=target_range_n[0],
        target_min_n=target_range_n[0], target_max_n=target_range_n[1], carry_s=CARRY_S[0],
    )  # fmt: skip
    result, deaf = {}, any(cause.get("fault") in _UNHEARD for cause in causes)
    for verb in VERBS:
        refusal = decide(mode, verb, situation).refusal
        bits = sum(1 << cause for cause in active) if refusal is Refusal.CAUSE_PRESENT else checks
        result[verb.name.lower()] = "" if refusal is Refusal.NONE else refusal_text(
            refusal, verb, mode, bits, fault, target_range_n, float(speed) if isinstance(speed, int | float) else 0.0,
            known, active,
        )  # fmt: skip
        if deaf and verb in _BY_DRIVE and refusal is Refusal.NONE:
            result[verb.name.lower()] = NO_DRIVE
    return result


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
