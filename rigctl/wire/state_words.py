"""Values of the state as an operator reads them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from rigctl.model import quantity
from rigctl.model.presentation import Enumeration
from rigctl.model.signals import SHOWN
from rigctl.model.states import DrivePower, PowerOff
from rigctl.wire.alarms import without_steps
from rigctl.wire.mode_origin import Origin
from rigctl.wire.trust import doubts, explained

MODE_STYLE = {
    "DISARMED": "black on white",
    "HOLD": "bold white on blue",
    "TENSIONING": "bold black on yellow",
    "COMPENSATING": "bold black on green",
    "RELEASING": "bold black on yellow",
    "FAULT": "bold white on red",
    "STARTING": "bold black on yellow",
}
BRAKE_FAILS = "brake_fails"
"""In ``flag_names``: the brake is known not to hold."""
NOTHING = "-"
BAND_PCT = 5.0  # the requirement: largest error of the vertical tension, of its target


def number(value: Any, digits: int, unit: str = "", *, sign: bool = False) -> str:
    """A number with its unit; a dash for no value."""
    if not isinstance(value, int | float):
        return NOTHING
    return quantity.number(value, digits, unit, sign=sign)


def mode(state: dict[str, Any]) -> str:
    """The mode, or that the loop does not run, or that the daemon starts."""
    if state.get("mode") is None:
        return "STARTING" if state.get("waits_for") else "NO LOOP"
    return str(state["mode"]) if state["loop_alive"] else "LOOP STOPPED"


_HELD = {
    "MOTOR": "held by the motor",
    "CLOSING": "brake closing (inferred)",
    "BRAKE": "held by the brake (inferred)",
    "TAKING": "motor takes the load",
    "UNKNOWN": "not known what holds the load",
}
_SLIPS = "on the closed brake (inferred)"


def held(state: dict[str, Any]) -> str:
    """What carries the load, how fast it sinks on a brake that slips, and whether a power off is confirmed."""
    unheard = "drive" in doubts(state)
    by = "UNKNOWN" if unheard else str(state.get("held_by"))
    speed, left = state.get("sink_mm_s"), state.get("slack_s")
    slips = ""
    if not unheard and isinstance(speed, int | float) and isinstance(left, int | float):
        slips = f", which SLIPS by {abs(speed):.2f} mm/s: rope slack in {left:.0f} s"
    holds = _SLIPS if slips and by == "UNKNOWN" else _HELD.get(by, "moved by the motor")
    return "; ".join(filter(None, (holds, power_off(state)))) + slips


def if_it_moves(state: dict[str, Any]) -> str:
    """What to do should the load move while no loop runs; nothing but the motor holds one whose brake fails."""
    fails = BRAKE_FAILS in state.get("flag_names", [])
    step = "support the payload from below, the brake does not hold it" if fails else "press the emergency stop"
    return f"If the load moves: {step}."


def ending(state: dict[str, Any]) -> str:
    """That the daemon is to end, and how long until the motor lowers the load; empty where no load delays an end."""
    left_s = state.get("end_s")
    if not isinstance(left_s, int | float):
        return ""
    when = f"in {left_s:.0f} s the motor lowers the load first" if left_s else "the motor lowers the load first"
    return f"THE DAEMON IS TO END: {when}; a second signal leaves the load"


def drive(state: dict[str, Any]) -> str:
    """Whether the drive is on, off, or what it is else, as its statusword says."""
    if "drive" in doubts(state):
        return "not known"
    if "drive_enabled" in state.get("flag_names", []):
        return "on"
    shown = DrivePower.__members__.get(str(state.get("drive_power")))
    return "not known" if shown is None else shown.value


def drive_with_state(state: dict[str, Any]) -> str:
    """The same, with the state that the drive reports."""
    name = state.get("drive_state")
    if "drive" in doubts(state) or not isinstance(name, str):
        return drive(state)
    return f"{drive(state)} ({name.replace('_', ' ')})"


def power_off(state: dict[str, Any]) -> str:
    """What shows that a drive commanded off has no power, or that nothing does; empty without such a command."""
    return PowerOff.__members__.get(str(state.get("power_off")), PowerOff.NONE).words


def brake(state: dict[str, Any]) -> str:
    """Open, closed or closing. No rig measures it: it is inferred from the drive's state."""
    if "drive" in doubts(state) or state.get("held_by") == "UNKNOWN":
        return "not known"
    if drive(state) == "on":
        return "open"
    return "closing" if state.get("held_by") == "CLOSING" else "closed"


def worded(state: dict[str, Any], name: str, digits: int | None = None) -> str:
    """A signal by its row, trusted or not: a number with its unit, or a name's words; a dash for no value.

    ``digits``: None for the row's.
    """
    row = SHOWN[name]
    if row.enum is not None:
        return _words(row.enum, str(state.get(name)))
    return number(state.get(name), row.shown.digits if digits is None else digits, row.field_unit, sign=row.shown.sign)


def _words(enum: Enumeration, name: str) -> str:
    member = enum.kind.__members__.get(name)
    if member is None:
        return "" if enum.none else "not known"
    return str(getattr(member, "words", name.replace("_", " ").lower()))


def measured(state: dict[str, Any], name: str, digits: int | None = None) -> str:
    """A signal by its row; a dash, and why, where it is not to be trusted."""
    if (doubt := doubts(state).get(SHOWN[name].device)) is not None:
        return f"{NOTHING} ({doubt})"
    return worded(state, name, digits)


class DisplayLine(NamedTuple):
    """A line of a display, at its place among the others."""

    place: int
    label: str
    text: str
    style: str = ""


def lines(state: dict[str, Any], display: str) -> Iterator[DisplayLine]:
    """The signals that have a line on a display of the terminal, a field of `Shown`."""
    for name, row in SHOWN.items():
        if place := getattr(row.shown, display):
            values = (measured(state, one) for one in (name, *row.shown.beside))
            yield DisplayLine(place, row.shown.label, row.shown.line.format(*values), row.shown.style)


def in_order(*found: DisplayLine) -> list[tuple[str, str, str]]:
    """Label, text and style of the lines that have a text, by their places."""
    return [line[1:] for line in sorted(found, key=lambda line: line.place) if line.text]


def mode_style(state: dict[str, Any]) -> str:
    """Colours of the mode."""
    return MODE_STYLE.get(mode(state), "bold white on red")


def why(state: dict[str, Any]) -> str:
    """What is wrong, in one line; empty when nothing is."""
    waits_for = state.get("waits_for")
    if state.get("mode") is None:
        return f"the daemon starts, and waits for: {waits_for}" if waits_for else "the loop has written no record yet"
    if not state["loop_alive"]:
        again = f"; it is started anew, and waits for: {waits_for}" if waits_for else ""
        return f"no record from the loop for {(state['age_ms'] or 0.0) / 1000:.1f} s{again}"
    latched = f"{state['fault']}: {state['fault_text']}" if state["fault"] else ""
    first = next((cause for cause in _active(state) if cause.get("fault") not in explained(state)), None)
    if first is None or first.get("fault") == state["fault"]:
        return latched
    strongest = f"{first.get('fault')}: {first.get('text')}"
    return f"{strongest}; latched: {latched}" if latched else strongest


def causes(state: dict[str, Any]) -> list[str]:
    """Every active cause, the strongest first, marked where it blocks a reset, or that none is active any more."""
    if not state.get("fault") or not state.get("loop_alive"):
        return []
    lines, folded = [], explained(state)
    for cause in _active(state):
        since, text = cause.get("since_wall_ns"), str(cause.get("text"))
        parts = [f"{cause.get('fault')}: {without_steps(text) if cause.get('fault') in folded else text}"]
        parts += [f"since {clock(since)}"] if isinstance(since, int) else []
        parts += ["blocks reset"] if cause.get("blocks_reset") else []
        lines.append(", ".join(parts))
    return lines or ["no cause is active any more; latched until rigctl reset"]


def _active(state: dict[str, Any]) -> list[dict[str, Any]]:
    found = state.get("causes")
    return [cause for cause in found if isinstance(cause, dict)] if isinstance(found, list) else []


RAMPING_SHARE = 1e-3
"""Of the target: a set-point further from it is on its way to a new target."""


def on_ramp(state: dict[str, Any]) -> bool:
    """Whether the set-point is on its way to a new target, so that the error against the target says nothing."""
    setpoint, target, tension, vertical = (state.get(name) for name in _OF_RAMP)
    if state.get("mode") != "COMPENSATING" or not setpoint or not target or not tension:
        return False
    return bool(abs(setpoint * (vertical or 0.0) / tension - target) > RAMPING_SHARE * target)


_OF_RAMP = ("setpoint_n", "target_n", "tension_n", "vertical_n")


def error(state: dict[str, Any]) -> str:
    """Vertical error in newtons and percent, while COMPENSATING."""
    if state.get("error_n") is None:
        return f"{NOTHING} (not COMPENSATING)"
    if (doubt := doubts(state).get("tension")) is not None:
        return f"{NOTHING} ({doubt})"
    if on_ramp(state):
        return f"{NOTHING} (on the way to {worded(state, 'target_n')})"
    return f"{worded(state, 'error_n')} ({worded(state, 'error_pct')})"


def inclination(state: dict[str, Any]) -> str:
    """Both angles, or what is wrong with them."""
    if (doubt := doubts(state).get("inclination")) is not None:
        return f"{NOTHING} ({doubt})"
    return f"tangential {worded(state, 'tangential_deg')}  normal {worded(state, 'normal_deg')}"


def calibration(state: dict[str, Any]) -> tuple[str, str]:
    """Zero and scale of the tension cell and when they are due, with a style."""
    found = state.get("calibration") or {}
    text = f"zero {number(found.get('zero_n'), 3, 'N', sign=True)}, scale {number(found.get('scale'), 5)}"
    if found.get("overdue"):
        waiver = found.get("waiver")
        return f"{text}, waived: {waiver}" if waiver else f"{text}, OVERDUE: no arming", "" if waiver else "red"
    return (f"{text}, due {found['due'][:10]}" if found.get("due") else text), ""


def margins(state: dict[str, Any]) -> str:
    """The sensitivity peak measured last, with its uncertainty; empty without one."""
    peak, error = state.get("sensitivity_peak"), state.get("sensitivity_peak_error")
    return "" if peak is None or error is None else f"measured Ms {peak:.2f} +- {error:.2f} (95 %, over a minute)"


def lease(state: dict[str, Any]) -> str:
    """The holder of the lease, since when and for how much longer."""
    found = state.get("lease")
    if not found:
        return "nobody holds it"
    since = clock(state["wall_ns"] + round((state["age_ms"] or 0) * 1e6) - round(found["held_s"] * 1e9))[:-2]
    return f"{found['holder']}, since {since}, for another {found['left_s']:.0f} s"


def percentiles(figures: dict[str, float] | None) -> str:
    """p50, p99, p99.9, max of the last second in microseconds."""
    if figures is None:
        return NOTHING
    return "  ".join(f"{name} {figures[key]:.0f}" for name, key in _PERCENTILES) + "  us"


_PERCENTILES = (("p50", "p50"), ("p99", "p99"), ("p99.9", "p999"), ("max", "max"))


def flaws(state: dict[str, Any]) -> str:
    """Signals that are not good, without the inclination, whose line shows it; empty when all are good."""
    quality = {name: words for name, words in state["quality"].items() if name != "inclination"}
    return ", ".join(f"{name} {words}" for name, words in quality.items() if words != "good")


def flags(state: dict[str, Any]) -> str:
    """Flags of the newest tick that matter to an operator; may be empty."""
    return ", ".join(name.replace("_", " ") for name in state.get("flag_names", []) if name != "drive_enabled")


def checks(state: dict[str, Any]) -> list[tuple[str, str]]:
    """Checks that refuse arming and those that are waived, each in words with a style; only while DISARMED."""
    found = state.get("preflight") or {}
    if state.get("mode") != "DISARMED":
        return []
    failing = [(words, "yellow") for words in found.get("failing", {}).values()]
    return failing + [(f"waived {name.lower()}: {words}", "") for name, words in found.get("waived", {}).items()]


def e_stop(state: dict[str, Any]) -> list[str]:
    """Emergency stop inputs that are pressed or not seen, in words; the loop checks them while not armed."""
    failing = (state.get("preflight") or {}).get("failing", {})
    looked_at = state.get("mode") in ("DISARMED", "FAULT")
    return [words for name, words in failing.items() if looked_at and name.startswith("E_STOP")]


def recorder(state: dict[str, Any]) -> tuple[str, str]:
    """What the recorder keeps, and where, with a style."""
    audit = state.get("audit")
    if not audit:
        return "nothing is recorded", "yellow"
    entries, failed = int(audit.get("entries") or 0), int(audit.get("failures") or 0)
    parts, failures = [f"audit log {quantity.count(entries, 'entry', 'entries')}"], failed
    if recording := state.get("recording"):
        parts.append(f"recording {recording.get('file') or 'not yet begun'}")
        if lost := recording.get("records_lost"):
            parts.append(f"{quantity.count(lost, 'record')} lost")
            failures += 1
    if failed:
        parts.append(f"{quantity.count(failed, 'write')} failed")
    if dump := state.get("trip_dump"):
        parts.append(f"trip dump {dump}")
    return ", ".join(parts), "yellow" if failures else ""


def counters(state: dict[str, Any]) -> str:
    """Counters of errors on the bus."""
    frames = f"frames lost {state['frames_lost']}, refused {state['frames_refused']}, unsent {state['send_failures']}"
    return f"{frames}, error frames {state['error_frames']}"


def began(origin: Origin | None) -> str:
    """Since when the mode is, and who or what began it; "" where no event says."""
    return "" if origin is None else f"since {clock(origin.since_ns)[:-2]}, {origin.by}"


def clock(wall_ns: int) -> str:
    """Local wall-clock time to the tenth of a second."""
    import datetime

    moment = datetime.datetime.fromtimestamp(wall_ns / 1e9).astimezone()
    return f"{moment:%H:%M:%S}.{moment.microsecond // 100_000}"
