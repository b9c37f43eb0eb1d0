"""``python -m rigctl.control.diagram > docs/modes.md``: the modes as the tables in `rigctl.control.modes` have them."""

from __future__ import annotations

import sys
from itertools import product

from rigctl.control.commands.situation import Situation
from rigctl.control.modes import TRANSITIONS, WITHOUT_EVENT, Guard, decide
from rigctl.control.power.arming import AWAIT_NS
from rigctl.control.power.drive_command import SAFE_FRAMES, STOP_LIMIT_NS
from rigctl.control.power.machine import SUPERVISED_NS
from rigctl.control.power.power_seen import SETTLES_NS, STILL_NS
from rigctl.control.power.stage import ARM_LIMIT_NS, ROWS, STAGES, DriveStage, Input, Sequence, StageRow
from rigctl.control.watch.escalation import STEPS
from rigctl.model.reactions import Action
from rigctl.model.states import Event, Mode
from rigctl.model.verbs import OFF_LIMIT_NS, Refusal, Verb

_HEAD = f"""\
# Modes

Generated from the tables of `rigctl/control/modes.py`, `stage.py` and `escalation.py` by `python -m
rigctl.control.diagram`; a test holds this file to it.

Every change of mode is an event with both modes, its cause, and how many commands of no speed went out in a row before
it: {SAFE_FRAMES} such safe frames are sent before the drive is switched on, and as many before it is switched off.

A trip latches the first fault. RELEASING with a fault latched is a ramp down that a limit began, and ends in FAULT.
Only `reset` leaves FAULT, once its cause is gone; `lower`, or `release` while the motor carries the load, leaves it for
as long as the motor lowers the load.

`reset` leads to HOLD only if the rig was armed, FAULT has parked it, the drive was in no fault of its own and has not
gone off by itself, and neither an emergency stop, `quick_stop`, `power_off` nor `silence`, nor `disarm`, has come
since. Else it leads to DISARMED, so that a whole arming with its brake test follows.
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
    Event.RESET_HELD: "`reset`, parked",
    Event.RESET_OFF: "`reset`, not armed or taken off power",
    Event.STOP: "daemon stops",
    Event.RAMP_DOWN: "limit asks for a ramp down",
    Event.UNTESTED: "target reached, the brake fails",
    Event.PAY_OUT: "`release` MM",
    Event.RAMP_ENDS: "a ramp with its fault latched has ended",
    Event.LOWER: "`lower`, or the time of `carry` is over",
}
_ACTIONS = {
    Action.LOG: "an event when it begins and when it is over",
    Action.RAMP_DOWN: "the tension is lowered on its ramp until the rope is slack, then FAULT; a hold ends it",
    Action.HOLD: "FAULT: the motor stops the stroke; at standstill the brake takes the load and the drive goes off, "
    "unless it is known not to hold",
    Action.QUICK_STOP: "FAULT: the drive stops on its own ramp (0x6085), then closes its brake and goes off",
    Action.POWER_OFF: "the same, and power is cut, which closes the brake, once the drive has had its time to stop",
    Action.SILENCE: "power off by SDO and NMT stop to the drive, then neither command nor heartbeat: its own "
    "supervision stops it; `reset` starts all devices up again",
}
_STAGES = """
## Drive, brake and load

One machine, whatever the mode, in the words of IEC 61800-5-2: STO (safe torque off), SS1 (safe stop 1), SOS (safe
operating stop), SBC (safe brake control) and SBT (safe brake test). A command that needs the motor waits in PREPARE,
ENABLE or RESET; where it is refused, aborted or tripped the stage is again the one before, without an arrow here. Only
ENABLE switches a drive on.
"""
_ROWS_HEAD = """
What ends the wait of a command, and the motor's hold, in order:

| stage | when | then | answer |
|---|---|---|---|
"""
WAYS = {
    "parking, `disarm`, end": (
        (DriveStage.STOP, "the motor", f"until the stroke is at rest, at most {STOP_LIMIT_NS * 1e-9:g} s"),
        (DriveStage.STOP, "the motor", "until the brake has closed"),
        (DriveStage.OFF, "the brake", ""),
    ),
    "`quick_stop`": (
        (DriveStage.QUICK, "the motor", "on the drive's own ramp"),
        (DriveStage.QUICK, "the motor", "until the drive has closed its brake"),
        (DriveStage.QUICK, "the brake", ""),
    ),
    "`power_off`": (
        (DriveStage.QUICK, "the motor", "on the drive's own ramp, for the longest stop of the rig"),
        (DriveStage.CUT, "nothing", "no torque, until the brake has closed"),
        (DriveStage.CUT, "the brake", ""),
    ),
    "`silence`": (
        (DriveStage.SILENT, "the motor", "power cut by SDO, NMT stop"),
        (DriveStage.SILENT, "the motor", f"on the drive's own supervision, at most {SUPERVISED_NS * 1e-9:g} s"),
        (DriveStage.SILENT, "the brake", ""),
    ),
    "taking back, `arm`": (
        (DriveStage.PREPARE, "the brake", f"at most {AWAIT_NS * 1e-9:g} s, or its test"),
        (DriveStage.ENABLE, "the motor", f"the brake opens once it has torque, at most {ARM_LIMIT_NS * 1e-9:g} s"),
        (DriveStage.RUN, "the motor", ""),
    ),
}
"""Who holds the load over time: for each way the stage, who holds it, and how long or how."""
_OVER_TIME = """
![Who holds the load over time](pictures/load.svg)

Who holds the load over time (`python -m rigctl.control.load_picture > docs/pictures/load.svg`). The longest stop of the
rig is `tension.speed_max_mm_s` over `cylinder.stop_deceleration_mm_s2`, and two lags.
"""
_HOLDS = {
    DriveStage.OFF: "the brake",
    DriveStage.STOP: "the motor, then the brake",
    DriveStage.RUN: "the motor",
    DriveStage.QUICK: "the motor, then the brake",
    DriveStage.CUT: "the brake, once it has closed",
    DriveStage.SILENT: "the drive's own supervision: the motor, then the brake",
    DriveStage.PREPARE: "as before, until a drive that still stops is off; then the brake",
    DriveStage.ENABLE: "the brake, then the motor",
    DriveStage.RESET: "as before",
}
_PARKED = f"""
## What holds the load

The record's `held_by` is made of the stage, of what the drive reports, and of the load.

| `held_by` | shown as | meaning |
|---|---|---|
| `MOTOR` | held by the motor | SOS: the drive is enabled and follows its commands; the brake takes over after \
`hold.park_s` at standstill in HOLD, after {STILL_NS * 1e-9:g} s in FAULT; during `carry`, \
with a brake known not to hold, and on a rig without a brake, the motor goes on |
| `CLOSING` | brake closing | the drive stops, closes its brake and goes off; for {SETTLES_NS * 1e-9:g} s the load may \
not be seen at rest yet |
| `BRAKE` | held by the brake | SBC: the drive reports that it is off, for as long as its brake takes to close, and \
the load is at rest (`load_at_rest`); DISARMED, and a parked HOLD or FAULT |
| `TAKING` | motor takes the load | the drive comes on, its motor takes the load, its brake opens |
| `UNKNOWN` | not known what holds the load | the drive does not report, or the load is not seen at rest on the closed \
brake |
| `NOTHING` | moved by the motor | TENSIONING, COMPENSATING, RELEASING |

What shows that the load is held, and what happens where it is not: [load.md](load.md).
"""
_ESCALATION = """
## When a reaction does not help

Watched once the reaction has had its time: the stop on the drive's own ramp, the brake. Every line that comes true is
an event with the value found and the limit.

| after | what shows it | next | why |
|---|---|---|---|
"""


_LEGEND = [
    "`-`: the command is refused in this mode. `carried out`: the mode stays as it is; after `arm` it is HOLD once the",
    "drive is enabled, and after `disarm` in FAULT the drive is off; `carry` and `lower` latch BRAKE_SLIPS first, so",
    "that it is FAULT. A guard in brackets refuses the command if its condition is not met.",
    "",
]


def document() -> str:
    """The whole page, in Markdown with a Mermaid diagram."""
    parts = [_HEAD, "```mermaid", "stateDiagram-v2", "    [*] --> DISARMED"]
    parts += [
        f"    {mode.name} --> {transition.after.name}: {_EVENTS[event].replace('`', '')}{_brackets(transition.guard)}"
        for (mode, event), transition in TRANSITIONS.items()
        if mode is not transition.after
    ]
    parts += ["```", "", "## Guards", "", "| guard | met when |", "|---|---|"]
    guards = {transition.guard for transition in TRANSITIONS.values()} | set(WITHOUT_EVENT.values())
    named = sorted((guard for guard in guards if guard is not None), key=lambda guard: guard.__name__)
    parts += [f"| `{guard.__name__}` | {_said(guard)} |" for guard in named]
    parts += ["", "## Commands", "", *_LEGEND, "| command | " + " | ".join(mode.name for mode in Mode) + " |"]
    parts += ["|---" * (len(Mode) + 1) + "|"]
    parts += [
        f"| `{verb.name.lower().replace('_', '-')}` | " + " | ".join(_cell(mode, verb) for mode in Mode) + " |"
        for verb in Verb
    ]
    parts += ["", "## Actions of the safety table, the weakest first", "", "| action | what it does |", "|---|---|"]
    parts += [f"| `{action.name.lower()}` | {_ACTIONS[action]} |" for action in Action]
    steps = [f"| `{step.action.name.lower()}` | {step.shows} | {_next(step.after)} | {step.why} |" for step in STEPS]
    return "\n".join(parts) + "\n" + _stages() + _PARKED + _ESCALATION + "\n".join(steps) + "\n"


def _stages() -> str:
    """The machine of drive, brake and load: its picture and both its tables."""
    arrows: dict[tuple[DriveStage, DriveStage], list[str]] = {}
    for (stage, input_), after in STAGES.items():
        arrows.setdefault((stage, after), []).append(input_.value)
    parts = [_STAGES, "```mermaid", "stateDiagram-v2", f"    [*] --> {Sequence().stage.name}"]
    parts += [
        f"    {one.name} --> {to.name}: {', or '.join(why).replace('`', '').replace(':', ',')}"
        for (one, to), why in arrows.items()
    ]
    parts += [f"    {DriveStage.SILENT.name} --> [*]: reset, start-up brings all devices up again"]
    parts += ["```", "", "| stage | meaning | the load is held by |", "|---|---|---|"]
    parts += [f"| {stage.name} | {stage.value} | {_HOLDS[stage]} |" for stage in DriveStage]
    rows = [f"| {row.stage.name} | {row.words} | {_leads_to(row)} | {_answer(row.answer)} |" for row in ROWS]
    rows += [
        "| any | `disarm` waits, and the drive is seen off | OFF from STOP, else as before | carried out |",
        f"| any | the same, and it is not seen off after {OFF_LIMIT_NS * 1e-9:g} s | as before | `off_unseen` |",
    ]
    return "\n".join(parts) + "\n" + _OVER_TIME + _ROWS_HEAD + "\n".join(rows) + "\n"


def _leads_to(row: StageRow) -> str:
    after = STAGES.get((row.stage, row.input))
    if row.input is Input.RESET:
        return "the stage before; STOP from QUICK and CUT"
    return after.name if after is not None else row.stage.name if row.answer is None else "the stage before"


def _answer(refusal: Refusal | None) -> str:
    if refusal is None:
        return "-"
    return "carried out" if refusal is Refusal.NONE else f"`{refusal.name.lower()}`"


def _next(action: Action | None) -> str:
    return "nothing stronger would help: it is reported" if action is None else f"`{action.name.lower()}`"


def _brackets(guard: Guard | None) -> str:
    return "" if guard is None else f" [{guard.__name__}]"


def _said(guard: Guard) -> str:
    return (guard.__doc__ or "").strip()


def _cell(mode: Mode, verb: Verb) -> str:
    """Mode after a command in a mode; a dash where it is always refused."""
    if (mode, verb) in WITHOUT_EVENT:
        return f"carried out{_brackets(WITHOUT_EVENT[mode, verb])}"
    situations = (
        Situation(armed=armed, carried_s=float(carried), fault=int(latched))
        for armed, carried, latched in product((True, False), repeat=3)
    )
    found = {event for one in situations if (event := decide(mode, verb, one).event) is not None}
    shown = (f"{to.after.name}{_brackets(to.guard)}" for to in (TRANSITIONS[mode, event] for event in sorted(found)))
    return " or ".join(shown) or "-"


if __name__ == "__main__":
    sys.stdout.write(document())
