"""What the page shows an operator beside the charts: answers, alarms, devices, and which commands are possible now."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from rigctl.model import quantity
from rigctl.model.signals import DEVICES, SHOWN
from rigctl.wire import state_words as figures
from rigctl.wire.alarms import Alarm
from rigctl.wire.operator_view import view
from rigctl.wire.state_words import held
from rigctl.wire.trust import doubts


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
        "entry": found.entry, "entry_why": found.entry_why, "unheld": found.unheld,
    }  # fmt: skip


NOT_KNOWN = "not known"
_NAMES = {"drive": "drive", "tension": "tension cell", "inclination": "inclinometer"}


class _Part(NamedTuple):
    """A device or a thing at the rig, at its place among the others."""

    place: int
    name: str
    text: str
    bad: bool = False
    sure: bool = True
    age_ms: float | None = None


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
    rows = [
        _Part(10, "drive", figures.drive_with_state(state), "drive" in doubt,
              age_ms=None if "drive" in doubt else _age(state, "drive")),
        _Part(20, "brake", figures.brake(state), sure=False),
        _Part(30, "load", held(state), state.get("held_by") == "UNKNOWN", sure=False),
        *_signals(state),
        *_e_stops(state, settings),
        *(_Part(80, name, doubt.get(key, str(quality.get(key, "-"))), key in doubt, age_ms=_age(state, key))
          for key, name in _NAMES.items() if key != "drive"),
    ]  # fmt: skip
    load = active.get("bus_load")
    if isinstance(load, int | float):
        errors = int(state.get("error_frames") or 0)
        heard = "nothing is heard" if dead else quantity.count(errors, "error frame")
        rows.append(_Part(90, "bus", f"{heard}; load {100 * load:.0f} % at worst", dead))
    return [{"name": part.name, "text": part.text, "age_ms": part.age_ms if alive else None, "bad": part.bad,
             "sure": part.sure} for part in sorted(rows, key=lambda part: part.place)]  # fmt: skip


def _signals(state: dict[str, Any]) -> Iterator[_Part]:
    """The signals that are shown among the parts of the rig; not known where they are not to be trusted."""
    doubt = doubts(state)
    for name, row in SHOWN.items():
        if not row.shown.part:
            continue
        known = row.device not in doubt and (row.enum is not None or isinstance(state.get(name), int | float))
        text = figures.worded(state, name) if known else NOT_KNOWN
        bad = row.enum is not None and str(state.get(name)) == "UNKNOWN"
        yield _Part(row.shown.part, row.shown.label, text, bad, sure=not row.shown.inferred)


def values(state: dict[str, Any]) -> list[dict[str, Any]]:
    """The page's list of values: each in words, and why it is not to be trusted, None where it is."""
    doubt, found = doubts(state), []
    for name, row in sorted(SHOWN.items(), key=lambda item: item[1].shown.value):
        if row.shown.value:
            text = figures.worded(state, name, row.shown.digits + row.shown.finer)
            there = isinstance(state.get(name), int | float)
            found.append({"name": name, "label": row.shown.label, "text": text.replace(" deg", " °"),
                          "doubt": doubt.get(row.device) if there else None})  # fmt: skip
    return found


def oldest(state: dict[str, Any]) -> dict[str, Any] | None:
    """The device whose newest sample is the oldest, and its age in ms; None where no age is known."""
    ages = [(age, device) for device in DEVICES if (age := _age(state, device)) is not None]
    age_ms, device = max(ages, default=(None, ""))
    return None if age_ms is None else {"name": _NAMES[device], "age_ms": age_ms}


def _e_stops(state: dict[str, Any], settings: dict[str, Any]) -> Iterator[_Part]:
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
    for name, check, fitted, words in inputs:
        if not fitted:
            yield _Part(70, name, "not fitted")
        elif words in pressed or (looked_at and check in failing) or (unnamed and only):
            yield _Part(70, name, "PRESSED", bad=True)
        elif unnamed:
            yield _Part(70, name, "not known: one of the inputs is pressed", bad=True)
        elif unseen[words] or (looked_at and f"{check}_UNSEEN" in failing):
            yield _Part(70, name, "not seen", bad=True)
        else:
            yield _Part(70, name, "released")


def timing(state: dict[str, Any], period_us: float | None, missed: int) -> dict[str, Any]:
    """The summary light of the loop's timing over the last second, and deadlines ``missed`` in the last minute."""
    worst = max((state.get(name) or {}).get("p999", 0.0) for name in ("lateness_us", "work_us"))
    late = period_us is not None and worst > period_us
    words = f"{missed} late in a minute" if missed else "late" if late else "in time"
    return {"good": not (late or missed), "text": words}
