"""What the page shows an operator beside the charts: answers, alarms, devices, and which commands are possible now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rigctl.model import quantity
from rigctl.model.quantity import number
from rigctl.wire import state_words as figures
from rigctl.wire.alarms import Alarm
from rigctl.wire.operator_view import view
from rigctl.wire.state_words import held
from rigctl.wire.trust import DEVICES, doubts


def answers(state: dict[str, Any], alarms: Sequence[Alarm], lock_out: str = "") -> dict[str, Any]:
    """What is wrong, what the rig does, what blocks a reset, what to do next, who may walk in."""
    found = view(state, alarms, lock_out)
    root = found.causes[0] if found.causes else None
    return {
        "parts": list(found.parts), "text": found.text, "follows": list(found.follows), "priority": found.priority,
        "value": root.value if root else "", "limit": root.limit if root else "",
        "since_ms": None if root is None or root.since_ns is None else root.since_ns / 1e6,
        "active": root is None or root.stands, "does": found.does, "blocks": found.blocks,
        "steps": [{"text": step.text, "verb": "" if step.read_at_rig else step.verb} for step in found.steps],
        "entry": found.entry, "entry_why": found.entry_why,
    }  # fmt: skip


def _age(state: dict[str, Any], name: str) -> float | None:
    age = state.get(f"{name}_age_ns")
    return age / 1e6 if isinstance(age, int | float) else None


def devices(state: dict[str, Any], active: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each device and thing at the rig.

    ``age_ms``: of its newest sample, None where the state itself is old. ``bad``: abnormal now. ``sure``: measured,
    else inferred from something else.
    """
    settings = active.get("settings") or {}
    doubt, quality, alive = doubts(state), state.get("quality") or {}, bool(state.get("loop_alive"))
    dead = set(DEVICES) <= doubt.keys()
    rows: list[tuple[str, str, float | None, bool, bool]] = [
        ("drive", figures.drive_with_state(state), None if "drive" in doubt else _age(state, "drive"),
         "drive" in doubt, True),
        ("brake", figures.brake(state), None, False, False),
        ("load", held(state), None, state.get("held_by") == "UNKNOWN", False),
        ("load at rest", figures.at_rest(state), None, state.get("load_at_rest") == "UNKNOWN", False),
        *((name, _drive_figure(state, field, digits, unit), None, False, True)
          for name, field, digits, unit in _OF_DRIVE),
        *((*row, True) for row in _e_stops(state, settings)),
        *((name, doubt.get(key, str(quality.get(key, "-"))), _age(state, key), key in doubt, True)
          for name, key in (("tension cell", "tension"), ("inclinometer", "inclination"))),
    ]  # fmt: skip
    load = active.get("bus_load")
    if isinstance(load, int | float):
        errors = int(state.get("error_frames") or 0)
        heard = "nothing is heard" if dead else quantity.count(errors, "error frame")
        rows.append(("bus", f"{heard}; load {100 * load:.0f} % at worst", None, dead, True))
    return [{"name": name, "text": text, "age_ms": age if alive else None, "bad": bad, "sure": sure}
            for name, text, age, bad, sure in rows]  # fmt: skip


_OF_DRIVE = (("motor current", "drive_current_a", 2, "A"), ("drive temperature", "drive_temperature_c", 0, "deg C"))


def _drive_figure(state: dict[str, Any], field: str, digits: int, unit: str) -> str:
    """What the drive's status carries; not known where nothing valid is heard of the drive."""
    return "not known" if "drive" in doubts(state) else number_of(state.get(field), digits, unit)


def oldest_ms(state: dict[str, Any]) -> float | None:
    """Age of the oldest of the devices' newest samples: how old the measurements shown are."""
    ages = [age for device in DEVICES if (age := _age(state, device)) is not None]
    return max(ages, default=None)


def number_of(value: Any, digits: int, unit: str) -> str:
    """A number with its unit, or that it is not known."""
    return number(value, digits, unit) if isinstance(value, int | float) else "not known"


def _e_stops(state: dict[str, Any], settings: dict[str, Any]) -> list[tuple[str, str, None, bool]]:
    """Both inputs of the emergency stop. While armed a pressed one is a fault; before, a check that fails."""
    failing = (state.get("preflight") or {}).get("failing") or {}
    blind = {str(cause.get("fault")) for cause in state.get("causes") or []} & {"STATUS_STALE", "BUS_SILENT"}
    unseen = {"drive": bool(blind) or "drive" in doubts(state), "I/O node": "BUS_SILENT" in blind}
    looked_at = state.get("mode") in ("DISARMED", "FAULT")
    pressed = " ".join(str(cause.get("text")) for cause in state.get("causes") or [] if cause.get("fault") == "E_STOP")
    unnamed = any(cause.get("fault") == "E_STOP" for cause in state.get("causes") or []) and not any(
        words in pressed for words in unseen
    )
    inputs = (
        ("E-stop, drive's input", "E_STOP", (settings.get("cylinder") or {}).get("e_stop_input") is not None, "drive"),
        ("E-stop, I/O node's input", "E_STOP_IO", settings.get("io") is not None, "I/O node"),
    )
    only = sum(fitted for _, _, fitted, _ in inputs) == 1
    rows: list[tuple[str, str, None, bool]] = []
    for name, check, fitted, words in inputs:
        if not fitted:
            rows.append((name, "not fitted", None, False))
        elif words in pressed or (looked_at and check in failing) or (unnamed and only):
            rows.append((name, "PRESSED", None, True))
        elif unnamed:
            rows.append((name, "not known: one of the inputs is pressed", None, True))
        elif unseen[words] or (looked_at and f"{check}_UNSEEN" in failing):
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
