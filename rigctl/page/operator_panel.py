"""What the page shows an operator beside the charts: answers, alarms, devices, and which commands are possible now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rigctl.config.quantity import number
from rigctl.control.checks import Check
from rigctl.control.events import refusal_text
from rigctl.control.faults import Fault
from rigctl.control.modes import Mode, Refusal, Situation, Verb, decide
from rigctl.wire.alarms import Alarm
from rigctl.wire.operator_view import view

VERBS = (Verb.ARM, Verb.TENSION, Verb.RELEASE, Verb.DISARM, Verb.RESET, Verb.TARGET)


def answers(state: dict[str, Any], alarms: Sequence[Alarm]) -> dict[str, Any]:
    """What is wrong, what the rig does, what blocks a reset, what to do next, who may walk in."""
    found = view(state, alarms)
    causes = [
        {
            "fault": cause.fault, "text": cause.text, "value": cause.value, "limit": cause.limit,
            "since_ms": None if cause.since_ns is None else cause.since_ns / 1e6, "blocks": cause.blocks_reset,
            "stands": cause.stands,
        }
        for cause in found.causes
    ]  # fmt: skip
    return {"causes": causes, "does": found.does, "blocks": found.blocks, "next": found.next_step, "entry": found.entry}


def possible(state: dict[str, Any], target_range_n: tuple[float, float]) -> dict[str, str]:
    """By verb: "" for a command that the modes table allows now, else why not, in the words of the refusal.

    What only the loop knows (a slack rope, a drive's own fault) is left to the loop: it refuses then.
    """
    try:
        mode, fault = Mode[str(state.get("mode"))], Fault(state.get("fault_code") or 0)
    except (KeyError, ValueError):
        return {verb.name.lower(): "the loop does not run" for verb in VERBS}
    if not state.get("loop_alive"):
        return {verb.name.lower(): "the loop does not run" for verb in VERBS}
    causes = [cause for cause in state.get("causes") or [] if isinstance(cause, dict)]
    standing = {
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
        failed_checks=checks, cause_present=bool(standing), stop_running="stopping" in flags,
        fault_latched=bool(fault), drive_enabled="drive_enabled" in flags,
        drive_faulted=bool(checks & Check.DRIVE_FAULT), wanted_n=target_range_n[0],
        target_min_n=target_range_n[0], target_max_n=target_range_n[1],
    )  # fmt: skip
    result = {}
    for verb in VERBS:
        refusal = decide(mode, verb, situation).refusal
        bits = sum(1 << cause for cause in standing) if refusal is Refusal.CAUSE_PRESENT else checks
        result[verb.name.lower()] = "" if refusal is Refusal.NONE else refusal_text(
            refusal, verb, mode, bits, fault, target_range_n, float(speed) if isinstance(speed, int | float) else 0.0,
            known, standing,
        )  # fmt: skip
    return result


def _age(state: dict[str, Any], name: str) -> float | None:
    age = state.get(f"{name}_age_ns")
    return age / 1e6 if isinstance(age, int | float) else None


def devices(state: dict[str, Any], active: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each device and thing at the rig: name, words, age of its newest sample in ms, whether it is bad."""
    settings = active.get("settings") or {}
    flags, quality = state.get("flag_names", []), state.get("quality") or {}
    on = "drive_enabled" in flags
    rows: list[tuple[str, str, float | None, bool]] = [
        ("drive", "on" if on else "off", _age(state, "drive"), quality.get("drive", "good") != "good"),
        ("brake", "open, held by the motor" if on else "closed (drive off)", None, False),
        ("motor current", number_of(state.get("drive_current_a"), 2, "A"), None, False),
        ("drive temperature", number_of(state.get("drive_temperature_c"), 0, "deg C"), None, False),
        *_e_stops(state, settings),
        *((name, str(quality.get(key, "-")), _age(state, key), quality.get(key, "good") != "good")
          for name, key in (("tension cell", "tension"), ("inclinometer", "inclination"))),
    ]  # fmt: skip
    load = active.get("bus_load")
    if isinstance(load, int | float):
        errors = int(state.get("error_frames") or 0)
        rows.append(("bus load", f"{100 * load:.0f} % at worst, {errors} error frames", None, load > 0.8))
    return [{"name": name, "text": text, "age_ms": age, "bad": bad} for name, text, age, bad in rows]


def number_of(value: Any, digits: int, unit: str) -> str:
    """A number with its unit, or that it is not known."""
    return number(value, digits, unit) if isinstance(value, int | float) else "not known"


def _e_stops(state: dict[str, Any], settings: dict[str, Any]) -> list[tuple[str, str, None, bool]]:
    """Both inputs of the emergency stop. While armed a pressed one is a fault; before, a check that fails."""
    failing = (state.get("preflight") or {}).get("failing") or {}
    looked_at = state.get("mode") in ("DISARMED", "FAULT")
    pressed = " ".join(str(cause.get("text")) for cause in state.get("causes") or [] if cause.get("fault") == "E_STOP")
    rows: list[tuple[str, str, None, bool]] = []
    for name, check, fitted, words in (
        ("E-stop, drive's input", "E_STOP", (settings.get("cylinder") or {}).get("e_stop_input") is not None, "drive"),
        ("E-stop, I/O node's input", "E_STOP_IO", settings.get("io") is not None, "I/O node"),
    ):
        if not fitted:
            rows.append((name, "not fitted", None, False))
        elif words in pressed or (looked_at and check in failing):
            rows.append((name, "PRESSED", None, True))
        elif looked_at and f"{check}_UNSEEN" in failing:
            rows.append((name, "not seen", None, True))
        else:
            rows.append((name, "released", None, False))
    return rows


def timing(state: dict[str, Any], period_us: float | None, missed: int) -> dict[str, Any]:
    """The summary light of the loop's timing over the last second, and deadlines ``missed`` in the last minute."""
    worst = max((state.get(name) or {}).get("p999", 0.0) for name in ("lateness_us", "work_us"))
    late = period_us is not None and worst > period_us
    words = f"{missed} late in a minute" if missed else "late" if late else "in time"
    return {"good": not (late or missed), "text": words}
