"""Texts of the page, the same as those of `rigctl watch`, as JSON messages for the browser."""

from __future__ import annotations

import time
from typing import Any

from rigctl.page.picture import Picture
from rigctl.wire import state_words as figures

_NUMBERS = (
    "vertical_n", "tension_n", "target_n", "error_n", "error_pct", "stroke_mm", "speed_mm_s", "tangential_deg",
    "normal_deg", "tick", "skipped", "wall_ns", "move", "learned_mm_s",
)  # fmt: skip


def state_message(picture: Picture, holds_lease: bool) -> dict[str, Any]:
    """The newest state for the browser; ``holds_lease``: whether this page's operator holds the lease."""
    with picture.lock:
        state, passed = picture.state, picture.limits.now
    message: dict[str, Any] = {
        "kind": "state",
        "endpoint": picture.endpoint,
        "silent_s": None if state is None else round(picture.silent_s, 2),
        "stale": state is None or picture.is_silent,
        "trouble": picture.trouble,
        "samples_lost": picture.samples_lost,
        "server_wall_ms": time.time() * 1000,
    }
    if state is None:
        return message
    message |= {"rig": state.get("rig"), "mode": figures.mode(state), "why": figures.why(state)}
    message["causes"] = figures.causes(state)
    refused = [picture.refused] if picture.refused else []
    message |= {"warnings": [*state.get("warnings", []), *refused], "age_ms": state.get("age_ms")}
    message |= {"calibration": figures.calibration(state), "recorder": figures.recorder(state)}
    message["lease"] = {"text": figures.lease(state) if "lease" in state else "", "mine": holds_lease}
    if state.get("mode") is None:
        return message
    return message | {
        "values": {name: state.get(name) for name in _NUMBERS},
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
        "period_us": 1e6 / rate_hz if (rate_hz := (settings.get("loop") or {}).get("rate_hz")) else None,
        "error_n": rows("vertical_error_n"),
        "tension_n": [
            {"value": safety[name], "action": "hold"} for name in ("tension_high_n", "tension_low_n") if name in safety
        ] + rows("tension_n"),
        "stroke_mm": rows("stroke_mm"),
        "stroke_range_mm": [cylinder.get("stroke_min_mm"), cylinder.get("stroke_max_mm")],
        "speed_mm_s": rows("speed_mm_s"),
        "tangential_deg": rows("tangential_deg"),
        "normal_deg": rows("normal_deg"),
        "target_range_n": [tension.get("target_min_n"), tension.get("target_max_n")],
    }  # fmt: skip


def events_message(picture: Picture) -> dict[str, Any]:
    """The newest events, oldest first."""
    with picture.lock:
        events = list(picture.events)
    rows = [
        {"severity": event["severity"], "text": event["text"], "wall_ms": event["wall_ns"] / 1e6} for event in events
    ]
    return {"kind": "events", "events": rows}
