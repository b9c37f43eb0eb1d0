"""Texts of the page, the same as those of `rigctl watch`, as JSON messages for the browser."""

from __future__ import annotations

import time
from typing import Any

from rigctl.client import local_hold
from rigctl.model.signals import ANGLES
from rigctl.model.verbs import VerbTrait, having
from rigctl.page import operator_panel, typed_fields
from rigctl.page.chart_signals import STRIPS
from rigctl.page.picture import Picture
from rigctl.wire import state_words as figures
from rigctl.wire.alarm_words import tally
from rigctl.wire.alarms import as_message
from rigctl.wire.offers import BUTTONS, PAY_OUT, not_now, refused_now
from rigctl.wire.trust import doubts

_NUMBERS = (
    *(row.name for row in STRIPS), "vertical_n", "tension_n", "target_n", "error_n", "error_pct", "stroke_mm",
    "tangential_deg", "tick", "skipped",
)  # fmt: skip
"""What the browser draws, judges or says with others."""

_MINUTE_S = 60


def _period_us(active: dict[str, Any]) -> float | None:
    rate_hz = ((active.get("settings") or {}).get("loop") or {}).get("rate_hz")
    return 1e6 / rate_hz if rate_hz else None


def state_message(picture: Picture, holds_lease: bool, asked: str = "") -> dict[str, Any]:
    """The newest state for the browser; ``holds_lease``: whether this page's operator holds the lease.

    ``asked``: what a command that waits for its confirmation would do now.
    """
    now_ns = time.time_ns()
    with picture.lock:
        state, passed, active = picture.state, picture.limits.now, picture.active
        alarms = picture.alarms.rows(state, now_ns)
        origin = picture.origin.now
        missed = picture.lateness.window(_MINUTE_S)["missed"]
    message: dict[str, Any] = {
        "kind": "state",
        "endpoint": picture.endpoint,
        "silent_s": None if state is None else round(picture.silent_s, 2),
        "stale": state is None or picture.is_silent,
        "trouble": picture.trouble,
        "samples_lost": picture.samples_lost,
        "server_wall_ms": time.time() * 1000,
        "asked": asked,
    }
    message["bounds"] = typed_fields.bounds(state or {})
    message["alarms"] = [as_message(row, now_ns, state) | {"condition": row.condition} for row in alarms]
    failing = ((state or {}).get("preflight") or {}).get("failing") or {}
    barred = len(failing) if (state or {}).get("mode") == "DISARMED" else 0
    message["tally"], message["barred"] = tally(alarms, now_ns, barred), barred
    if state is None:
        return message
    message["hold"] = _hold_words(picture, state)
    message["hold_dead"] = message["hold"] == _HOLD_STOPPED
    lock_out = str(((active.get("settings") or {}).get("safety") or {}).get("lock_out") or "")
    message["answers"] = operator_panel.answers(state, alarms, lock_out)
    message["origin"] = None if origin is None else {"since_ms": origin.since_ns / 1e6, "by": origin.by}
    message |= {"rig": state.get("rig"), "mode": figures.mode(state), "why": figures.why(state)}
    message |= {"causes": figures.causes(state), "waits_for": state.get("waits_for")}
    refused = [picture.refused] if picture.refused else []
    message |= {"warnings": [*state.get("warnings", []), *refused], "age_ms": state.get("age_ms")}
    message |= {"calibration": figures.calibration(state), "recorder": figures.recorder(state)}
    held = state.get("lease")
    message["lease"] = {
        "text": figures.lease(state) if "lease" in state else "", "mine": holds_lease,
        "holder": str(held.get("holder", "")) if isinstance(held, dict) else "",
    }  # fmt: skip
    if state.get("mode") is None:
        return message
    why, shown = refused_now(state), state.get("mode") == "FAULT"
    in_fault = {verb.name.lower() for verb in having(VerbTrait.IN_FAULT)}
    verbs = {name: why[name] for name in (verb.name.lower() for verb in BUTTONS)}
    if not why[PAY_OUT]:
        verbs["release"] = ""  # its button has a field for the length
    return message | {
        "values": {name: state.get(name) for name in _NUMBERS},
        "doubts": doubts(state),
        "ramping": figures.on_ramp(state),
        "oldest": operator_panel.oldest(state),
        "brake": figures.brake(state),
        "drive": figures.drive(state),
        "held_by": state.get("held_by"),
        "not_now": not_now({verb: why for verb, why in verbs.items() if shown or verb not in in_fault}),
        "flag_names": state.get("flag_names", []),
        "verbs": verbs,
        "devices": operator_panel.devices(state, active),
        "figures": operator_panel.values(state),
        "timing": operator_panel.timing(state, _period_us(active), missed),
        "flags": figures.flags(state),
        "limits": passed,
        "flaws": figures.flaws(state),
        "inclination": state["quality"]["inclination"],
        "lateness": figures.percentiles(state["lateness_us"]),
        "work": figures.percentiles(state["work_us"]),
        "bus": figures.counters(state),
        "bus_bad": any(state[name] for name in ("frames_lost", "frames_refused", "send_failures", "error_frames")),
        "checks": figures.checks(state),
        "design": state.get("design"),
        "margins": figures.margins(state),
    }


_HOLD_STOPPED = "HOLD does not work: the loop writes no records. The emergency stop works."
_HOLD_LOCAL = "HOLD goes to the loop itself, without what is silent: press it, and read its answer."
_HOLD_FAR = "HOLD goes the way that is silent now: use the emergency stop, or rigctl hold at the rig's computer."


def _hold_words(picture: Picture, state: dict[str, Any]) -> str:
    """Whether HOLD still works, for a display without fresh data."""
    if not picture.is_silent:
        return _HOLD_STOPPED if not state.get("loop_alive") else ""
    return _HOLD_LOCAL if local_hold.held_here(picture.endpoint, state.get("rig")) else _HOLD_FAR


def settings_message(active: dict[str, Any]) -> dict[str, Any]:
    """Bands, limits and ranges for the charts, from the active configuration."""
    settings = active.get("settings") or {}
    cylinder, safety, tension = (settings.get(name) or {} for name in ("cylinder", "safety", "tension"))
    limits = [limit for limit in settings.get("limits") or [] if isinstance(limit, dict)]

    def rows(signal: str) -> list[dict[str, Any]]:
        found = [limit for limit in limits if limit.get("signal") == signal]
        return [
            {"value": limit[bound], "action": limit["action"]}
            for limit in found
            for bound in ("low", "high")
            if limit.get(bound) is not None
        ]

    return {
        "kind": "settings",
        "rig": settings.get("rig"),
        "version": active.get("version"),
        "band_pct": figures.BAND_PCT,
        "period_us": _period_us(active),
        "error_n": rows("vertical_error_n"),
        "tension_n": [
            {"value": safety[name], "action": "hold"} for name in ("tension_high_n", "tension_low_n") if name in safety
        ] + rows("tension_n"),
        **{row.field: rows(row.field) for row in (*STRIPS, *ANGLES)},
        "stroke_range_mm": [cylinder.get("stroke_min_mm"), cylinder.get("stroke_max_mm")],
        "target_range_n": [tension.get("target_min_n"), tension.get("target_max_n")],
        "force_limits_n": [safety.get("tension_low_n"), safety.get("tension_high_n")],
    }  # fmt: skip


_TIMING = frozenset({"CLOCK", "READ_BACK"})
"""Events of the computer's own, which the history shows only where it is asked to."""


def events_message(picture: Picture) -> dict[str, Any]:
    """The newest events, oldest first."""
    with picture.lock:
        events = list(picture.events)
    rows = [
        {
            "severity": event["severity"],
            "text": event["text"],
            "wall_ms": event["wall_ns"] / 1e6,
            "source": event["source"],
            "kind": event["kind"],
            "timing": event["kind"] in _TIMING,
            "name": _name_of(event),
        }
        for event in events
    ]
    return {"kind": "events", "events": rows}


def _name_of(event: dict[str, Any]) -> str:
    """What a marker on the charts is called: the mode begun, or the fault."""
    text = str(event["text"])
    if event["kind"] == "MODE":
        return text.partition(" -> ")[2].partition(":")[0]
    return text.removeprefix("trip ").partition(":")[0].partition(" ")[0]
