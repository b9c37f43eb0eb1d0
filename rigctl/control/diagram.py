"""``python -m rigctl.control.diagram > docs/modes.md``: the modes as the tables in `rigctl.control.modes` have them."""

from __future__ import annotations

import sys
from itertools import product

from rigctl.control import load_at_rest
from rigctl.control.arming import AWAIT_NS, BRAKE_TEST_MM, BRAKE_TEST_NS, LONG_TEST_NS
from rigctl.control.brake_flag import FALLS, FALLS_NS, MOVED_MM, TESTED_SHARE
from rigctl.control.carried_load import FOLLOWS_MM, FOLLOWS_NS, LOWERS_MM_S, SPARE_MM
from rigctl.control.ending import LIMIT_S, WAITS_NS
from rigctl.control.escalation import STEPS
from rigctl.control.faults import Trait, having
from rigctl.control.loop import SAFE_FRAMES
from rigctl.control.machine import LOWERED_NS
from rigctl.control.modes import CARRY_S, TRANSITIONS, WITHOUT_EVENT, Event, Guard, Mode, Refusal, Verb, decide
from rigctl.control.orders import RECHECK_NS
from rigctl.control.parking import REST_NS, UNDO_MM
from rigctl.control.power_seen import SETTLES_NS, STILL_NS, UNDO_NS
from rigctl.control.safety import BRAKE_SLIP_MM_S, CORRECTED_MM, NOT_HELD_MM, SINK_MM_S, Action
from rigctl.control.situation import Situation
from rigctl.control.stage import ARM_LIMIT_NS, ROWS, STAGES, DriveStage, Sequence, StageRow
from rigctl.control.stroke_hold import AUTHORITY_MM_S, CREEP_MM_S, SAID_MM
from rigctl.control.tension import PAYS_OUT_MM_S

_LOAD_REST_S = load_at_rest.REST_NS * 1e-9
_ENDS = "\n".join(f"- {fault.name}" for fault in sorted(having(Trait.STOPS_CARRYING)))
_TRIALS = "`identify` and `response`"
_HEAD = f"""\
# Modes

Generated from `rigctl/control/modes.py` by `python -m rigctl.control.diagram`; a test holds this file to it.

Every change of mode is an event that names both modes, what caused it, and how many commands of no speed went out in a
row before it. {SAFE_FRAMES} such safe frames are sent before the drive is switched on, and as many, at standstill,
before it is switched off.

A trip latches the first fault. RELEASING with a fault latched is a ramp down that a limit began: whatever ends it
(slack, hold, stop, a stronger trip) ends in FAULT. Only `reset` leaves FAULT, once its cause is gone; `lower`, or
`release` while the motor carries the load, leaves it for as long as the motor lowers the load. `reset` leads to HOLD,
held by the brake, if the rig was armed and FAULT has parked it. It leads to DISARMED, so that a whole arming with its
brake test follows, if the rig was not armed, was disarmed in FAULT, its drive is or was in a fault of its own, or its
power was taken away (by `quick_stop` and stronger actions, which an emergency stop has too, or by the drive itself).
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
    Action.HOLD: "FAULT: the motor stops the stroke; at standstill the brake takes the load and the drive goes off",
    Action.QUICK_STOP: "FAULT: the drive stops on its own ramp (0x6085), then closes its brake and goes off",
    Action.POWER_OFF: "the same, and power is cut, which closes the brake, once the drive has had its time to stop",
    Action.SILENCE: "power off by SDO and NMT stop to the drive, then neither command nor heartbeat: its own "
    "supervision stops it; `reset` starts all devices up again",
}
_STAGES = """
## Drive, brake and load

One machine, whatever the mode, in the words of IEC 61800-5-2: STO (safe torque off), SS1 (safe stop 1), SOS (safe
operating stop), SBC (safe brake control) and SBT (safe brake test). A command that needs the motor waits in PREPARE,
ENABLE or RESET; where it is refused or aborted, the stage is again the one before. Only ENABLE switches a drive on.
"""
_ROWS_HEAD = """
What ends the wait of a command, and the motor's hold, in order:

| stage | when | then | answer |
|---|---|---|---|
"""
_HOLDS = {
    DriveStage.OFF: "the brake",
    DriveStage.STOP: "the motor, then the brake",
    DriveStage.RUN: "the motor",
    DriveStage.QUICK: "the motor, then the brake",
    DriveStage.CUT: "the brake, once it has closed",
    DriveStage.SILENT: "the drive's own supervision: the motor, then the brake",
    DriveStage.PREPARE: "the brake",
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
and on a rig without a brake, the motor goes on |
| `CLOSING` | brake closing | the drive stops, closes its brake and goes off; for {SETTLES_NS * 1e-9:g} s the load may \
not be seen at rest yet |
| `BRAKE` | held by the brake | SBC: the drive reports that it is off, for as long as its brake takes to close, and \
the load is at rest (`load_at_rest`); DISARMED, and a parked HOLD or FAULT |
| `TAKING` | motor takes the load | the drive comes on, its motor takes the load, its brake opens |
| `UNKNOWN` | not known what holds the load | the drive does not report, or the load is not seen at rest on the closed \
brake |
| `NOTHING` | moved by the motor | TENSIONING, COMPENSATING, RELEASING |

Two statements are made beside it, each with what shows it. `power_off`: a drive that was commanded off has no power
([operate.md](operate.md#modes)). `load_at_rest`: the load has been at rest for {_LOAD_REST_S:g} s, by the tension,
which has stayed within {load_at_rest.REST_MM:g} mm of stretch, by the stroke, or by both; `MOVES` if one that is seen
moves; `UNKNOWN` if neither is seen. A cell that is stale or in doubt shows nothing, nor does a slack rope. On the
closed brake a load that begins to move is an event, and so is its rest.

A stroke that is still not at rest {REST_NS * 1e-9:g} s after a stop should have ended is parked all the same: the
drive's own stop and brake end it. {_TRIALS} have the motor hold by name and for a stated time, then the load is parked
again; `tare` and `calibrate` measure on the brake, which takes the load for them at standstill. A rig without a brake
(`cylinder.brake_waiver`) is held by the motor.

`release` MM pays out so much of a slack rope, in HOLD, at {PAYS_OUT_MM_S:g} mm/s: the way back of a cylinder that has
reached the end of its stroke without a load (`reset`, or `arm --near-end`, leads to HOLD).

`tension`, `release`, {_TRIALS} take a parked load back first: drive on, motor carries, brake open, motion. The command
is answered when the motion begins, with "taking the load from the brake" and the time that it took. A refusal leaves
the brake closed. While the drive comes on, also by `arm`, the rows of HOLD are watched: a loss is a FAULT, and the
brake closes.

| check | at `arm` | when a parked load is taken back |
|---|---|---|
| devices and signals: fresh, valid, operational, within their limits | yes | each time, until the drive has its power |
| standstill, drive off, brake closed | yes | each time, within {AWAIT_NS * 1e-9:g} s |
| drive enabled within {ARM_LIMIT_NS * 1e-9:g} s | yes | each time |
| every supervised object read back | yes | after {RECHECK_NS // 60_000_000_000} min on the brake, and once after a \
fault; else one object after the other, all the time |
| brake test (SBT), {BRAKE_TEST_NS * 1e-9:g} s | yes | never: a parked load that stays where it is tests the brake |
| computer, calibration, distance from the ends of the stroke | yes | never: nothing of it has changed since |

A parking whose brake slips in its first second is undone: if, within {UNDO_NS * 1e-9:g} s, stroke and tension both
show that the load has sunk by {UNDO_MM:g} mm, and no other cause is active, the fault BRAKE_SLIPS is latched, and the
motor takes the load back and holds it as by `carry`, for {LOWERED_NS // 60_000_000_000} min. If the load sinks later,
or if only one of the two shows it, the drive stays off until the operator gives `carry` or `lower`.

## A brake that slips

A stroke that moves on the closed brake, faster than {SINK_MM_S:g} mm/s over 5 s or {BRAKE_SLIP_MM_S:g} mm/s at once, is
STROKE_MOVES in every mode that keeps the stroke, with its speed and the time until the rope is slack. No `reset` is
accepted while the load sinks.

It also sets the flag `brake_fails`: the brake is known not to hold. BRAKE_SLIPS sets it too, as do a net motion of
{MOVED_MM:g} mm on the closed brake since the stroke was last commanded to move, and a tension that has lost
{FALLS:g} times the limit of LOAD_SINKS for {FALLS_NS * 1e-9:g} s while the encoder is in doubt. No reset clears it, nor
does a start of the daemon, only a brake test: {LONG_TEST_NS * 1e-9:g} s of `arm` with at least {TESTED_SHARE:.0%} of
the load at which the brake slipped (of `tension.target_max_n` where that is not known). If the load moves in that test,
the motor takes it. With a slack rope the flag stays, and `arm` is accepted; `tension` then ends in HOLD in place of
COMPENSATING, for `brake-test`: with the payload supported from below, the brake has the load for the same
{LONG_TEST_NS * 1e-9:g} s, and the motor takes it back, in FAULT where it has moved by {BRAKE_TEST_MM:g} mm.

While the flag is set the operator has two commands in FAULT, HOLD and DISARMED; outside FAULT they latch BRAKE_SLIPS
first:

- `carry` SECONDS (operator, with the lease): the motor takes the load and holds it for {CARRY_S[0]:g} to
  {CARRY_S[1]:g} s; the fault stays latched and shown. `reset` is refused meanwhile; `carry` again prolongs it. When its
  time is over the motor lowers the load. `disarm` gives it back to the brake.
- `lower`, or `release` while the motor carries the load: the motor lowers it until the rope is slack. A `hold` stops
  it, and the motor carries for {LOWERED_NS // 60_000_000_000} min.

Both follow one witness where the other is in doubt: the encoder alone lowers at {LOWERS_MM_S:g} mm/s, until the rope is
slack by its last credible tension and {SPARE_MM:g} mm more. Where encoder and tension disagree by themselves the
command is refused, and the operator names one (`--by encoder`, `--by cell`). A fault of the drive's own is cleared by
the command, once, but for those of feedback, brake and power stage. Only what concerns moving the load stops the motor,
by quick stop:

{_ENDS}

and a tension that is for {FOLLOWS_NS * 1e-9:g} s more than {FOLLOWS_MM:g} mm from the commanded stroke where it alone
is followed. Everything else is reported. Without the flag, and in FAULT, `carry` needs both witnesses, and any other
cause gives the load back to the brake.

An end in order does not give the load back either. The record's flag `carries` is set while the motor carries or lowers
a load, or has a tight rope with a brake known not to hold. The loop then goes on for {WAITS_NS * 1e-9:g} s after the
request, has the motor lower the load as by `lower` (outside FAULT BRAKE_SLIPS is latched first), and ends once the rope
is slack. It ends earlier when the motor has the load no more, or by a second request, which leaves the load, and after
{LIMIT_S:g} s in any case ([operate.md](operate.md#an-end-while-the-motor-carries)).
"""
_HELD = f"""
## The stroke that is held

HOLD, FAULT and DISARMED keep the stroke. It is latched where it comes to rest once such a mode begins, again when the
motor has taken the load, after a trial that moved it, and when a fault is reset. While the motor holds, a position
loop brings the stroke back to its latch at no more than {AUTHORITY_MM_S:g} mm/s (a drive that needs more trips
DRIVE_NOT_FOLLOWING); an event reports a drive that goes on needing more than {CREEP_MM_S:g} mm/s, and once a stroke
more than {SAID_MM:g} mm from the latch. Beyond {NOT_HELD_MM:g} mm the drive is taken off power and its brake closes
(STROKE_NOT_HELD): the stroke then stands within 1 mm.

The encoder alone does not keep a load. While the motor holds, the tension is latched with the stroke, and the two check
each other by the stiffness without a memory that leaks. Where they disagree nothing is moved: the brake takes the load
(STRETCH_UNEXPLAINED). A cell that has stopped measuring denies nothing either, so the correction is bounded by its sum:
beyond {CORRECTED_MM:g} mm the brake takes the load (POSITION_DRIFTS), be it the drive that creeps or the encoder that
drifts. On the brake a tension that falls is a load that sinks (LOAD_SINKS), DISARMED too. A rope that carried and is
slack has lost its load (TENSION_LOW), however fast, in HOLD and FAULT. `rigctl check` prints the limits for its rig.
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
    "drive is enabled, and after `disarm` in FAULT the drive is off. A guard in brackets refuses the command if its",
    "condition is not met.",
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
    parts += ["```", "", "## Guards", ""]
    guards = {transition.guard for transition in TRANSITIONS.values()} | set(WITHOUT_EVENT.values())
    named = sorted((guard for guard in guards if guard is not None), key=lambda guard: guard.__name__)
    parts += [f"- `{guard.__name__}`: {_said(guard)}" for guard in named]
    parts += ["", "## Commands", "", *_LEGEND, "| command | " + " | ".join(mode.name for mode in Mode) + " |"]
    parts += ["|---" * (len(Mode) + 1) + "|"]
    parts += [f"| `{verb.name.lower()}` | " + " | ".join(_cell(mode, verb) for mode in Mode) + " |" for verb in Verb]
    parts += ["", "## Actions of the safety table, the weakest first", ""]
    parts += [f"- `{action.name.lower()}`: {_ACTIONS[action]}" for action in Action]
    steps = [f"| `{step.action.name.lower()}` | {step.shows} | {_next(step.after)} | {step.why} |" for step in STEPS]
    return "\n".join(parts) + "\n" + _stages() + _PARKED + _HELD + _ESCALATION + "\n".join(steps) + "\n"


def _stages() -> str:
    """The machine of drive, brake and load: its picture and both its tables."""
    arrows: dict[tuple[DriveStage, DriveStage], list[str]] = {}
    for (stage, input_), after in STAGES.items():
        arrows.setdefault((stage, after), []).append(input_.value)
    parts = [_STAGES, "```mermaid", "stateDiagram-v2", f"    [*] --> {Sequence().stage.name}"]
    parts += [
        f"    {one.name} --> {to.name}: {', or '.join(why).replace('`', '')}" for (one, to), why in arrows.items()
    ]
    parts += ["```", "", "| stage | meaning | the load is held by |", "|---|---|---|"]
    parts += [f"| {stage.name} | {stage.value} | {_HOLDS[stage]} |" for stage in DriveStage]
    rows = [f"| {row.stage.name} | {row.words} | {_leads_to(row)} | {_answer(row.answer)} |" for row in ROWS]
    return "\n".join(parts) + "\n" + _ROWS_HEAD + "\n".join(rows) + "\n"


def _leads_to(row: StageRow) -> str:
    after = STAGES.get((row.stage, row.input))
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
