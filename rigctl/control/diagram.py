"""``python -m rigctl.control.diagram > docs/modes.md``: the modes as the tables in `rigctl.control.modes` have them."""

from __future__ import annotations

import sys

from rigctl.control.escalation import STEPS
from rigctl.control.loop import SAFE_FRAMES
from rigctl.control.modes import TRANSITIONS, WITHOUT_EVENT, Event, Guard, Mode, Situation, Verb, decide
from rigctl.control.safety import DOUBT_MM, NOT_HELD_MM, Action
from rigctl.control.stroke_hold import AUTHORITY_MM_S, CREEP_MM_S, SAID_MM

_HEAD = f"""\
# Modes

Generated from `rigctl/control/modes.py` by `python -m rigctl.control.diagram`; a test holds this file to it.

Every change of mode is an event that names both modes, what caused it, and how many commands of no speed went out in a
row before it. {SAFE_FRAMES} such safe frames are sent before the drive is switched on, and as many, at standstill,
before it is switched off.

A trip latches the first fault. RELEASING with a fault latched is a ramp down that a limit began: whatever ends it
(slack, hold, stop, a stronger trip) ends in FAULT. Only `reset` leaves FAULT, once its cause is gone.
"""
_EVENTS = {
    Event.ENABLED: "drive enabled after `arm`",
    Event.TENSION: "`tension`",
    Event.TENSIONED: "target reached",
    Event.RELEASE: "`release`",
    Event.SLACK: "rope slack",
    Event.HOLD: "`hold`",
    Event.DISARM: "`disarm`",
    Event.TRIP: "trip",
    Event.RESET_HELD: "`reset`, drive on",
    Event.RESET_OFF: "`reset`, drive off",
    Event.STOP: "daemon stops",
    Event.RAMP_DOWN: "limit asks for a ramp down",
}
_ACTIONS = {
    Action.LOG: "an event when it begins and when it is over",
    Action.RAMP_DOWN: "the tension is lowered on its ramp until the rope is slack, then FAULT; a hold ends it",
    Action.HOLD: "FAULT: the stroke is held under power, at its latch",
    Action.QUICK_STOP: "FAULT: the drive stops on its own ramp (0x6085), then closes its brake and goes off",
    Action.POWER_OFF: "the same, and power is cut, which closes the brake, once the drive has had its time to stop",
}
_HELD = f"""
## The stroke that is held

HOLD, FAULT and DISARMED keep the stroke. It is latched where it comes to rest once such a mode begins, again when the
drive is armed, after a trial that moved it, and when a fault is reset. With the drive on, a position loop brings the
stroke back to its latch at no more than {AUTHORITY_MM_S:g} mm/s (a drive that needs more trips DRIVE_NOT_FOLLOWING);
an event reports a drive that goes on needing more than {CREEP_MM_S:g} mm/s, and once a stroke more than {SAID_MM:g} mm
from the latch. Beyond {NOT_HELD_MM:g} mm the drive is taken off power and its brake closes (STROKE_NOT_HELD): the
stroke then stands within 1 mm. A correction of {DOUBT_MM:g} mm and more that the tension or the drive's reported speed
shows to have moved the load, while its position stood still, ends the same way (POSITION_DRIFTS).
"""
_ESCALATION = """
## When a reaction does not help

Watched once the reaction has had its time: the stop on the drive's own ramp, the brake. Every line that comes true is
an event with the value found and the limit.

| after | what shows it | next | why |
|---|---|---|---|
"""


def document() -> str:
    """The whole page, in Markdown with a Mermaid diagram."""
    parts = [_HEAD, "```mermaid", "stateDiagram-v2", "    [*] --> DISARMED"]
    parts += [
        f"    {mode.name} --> {transition.after.name}: {_EVENTS[event].replace('`', '')}{_brackets(transition.guard)}"
        for (mode, event), transition in TRANSITIONS.items()
        if mode is not transition.after
    ]
    parts += ["```", "", "## Guards", ""]
    guards = {transition.guard for transition in TRANSITIONS.values()} | set(WITHOUT_EVENT.values())
    named = sorted((guard for guard in guards if guard is not None), key=lambda guard: guard.__name__)
    parts += [f"- `{guard.__name__}`: {_said(guard)}" for guard in named]
    parts += ["", "## Commands", "", "| command | " + " | ".join(mode.name for mode in Mode) + " |"]
    parts += ["|---" * (len(Mode) + 1) + "|"]
    parts += [f"| `{verb.name.lower()}` | " + " | ".join(_cell(mode, verb) for mode in Mode) + " |" for verb in Verb]
    parts += ["", "## Actions of the safety table, the weakest first", ""]
    parts += [f"- `{action.name.lower()}`: {_ACTIONS[action]}" for action in Action]
    steps = [f"| `{step.action.name.lower()}` | {step.shows} | {_next(step.after)} | {step.why} |" for step in STEPS]
    return "\n".join(parts) + "\n" + _HELD + _ESCALATION + "\n".join(steps) + "\n"


def _next(action: Action | None) -> str:
    return "nothing stronger is left: it is reported" if action is None else f"`{action.name.lower()}`"


def _brackets(guard: Guard | None) -> str:
    return "" if guard is None else f" [{guard.__name__}]"


def _said(guard: Guard) -> str:
    return (guard.__doc__ or "").strip()


def _cell(mode: Mode, verb: Verb) -> str:
    """Mode after a command in a mode; a dash where it is always refused."""
    if (mode, verb) in WITHOUT_EVENT:
        return f"carried out{_brackets(WITHOUT_EVENT[mode, verb])}"
    found = {
        TRANSITIONS[mode, event].after.name
        for enabled in (True, False)
        if (event := decide(mode, verb, _situation(enabled)).event) is not None
    }
    return " or ".join(sorted(found)) or "-"


def _situation(enabled: bool) -> Situation:
    return Situation(drive_enabled=enabled, unloaded=True, wanted_n=1.0, measured_mm=1.0, target_max_n=1.0)


if __name__ == "__main__":
    sys.stdout.write(document())
