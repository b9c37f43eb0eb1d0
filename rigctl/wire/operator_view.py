"""The answers an operator needs at a glance, from a state: what is wrong, what the rig does, what to do next."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rigctl.diagnosis.table import suspects
from rigctl.model.faults import Fault, Trait, having
from rigctl.model.parts import Part
from rigctl.model.quantity import count, number
from rigctl.model.signals import DEVICES
from rigctl.model.states import PowerOff
from rigctl.model.verbs import Refusal
from rigctl.wire.alarms import Alarm, figure, follows
from rigctl.wire.instructions import Hands, HandsAt, Instruction, ReadAtRig
from rigctl.wire.offers import reason_now, refused_now
from rigctl.wire.state_words import BRAKE_FAILS, drive, ending, held, if_it_moves, mode
from rigctl.wire.trust import doubts, explained, trusted

KEEP_OUT, LOCK_OUT_FIRST = "KEEP OUT", "LOCK OUT FIRST"
_HALL = "Keep out of the hall."
_START = Instruction(
    "At the rig's computer: rigctl doctor, then start the daemon anew.", places=(HandsAt.COMPUTER,), hands=Hands.START
)
_BY_ONE = Instruction(
    "Where encoder and tension disagree, see at a mark on the cylinder which is right: rigctl lower --by encoder, or "
    "rigctl lower --by cell.", "lower", ReadAtRig.WITNESS,
)  # fmt: skip
_SUPPORTED = (HandsAt.PAYLOAD,)


@dataclass(frozen=True)
class FaultCause:
    """A cause of a fault. ``since_ns``: wall clock, None where it is not known. ``stands``: active, else latched."""

    fault: str
    text: str
    value: str
    limit: str
    since_ns: int | None
    blocks_reset: bool
    remedy: str
    stands: bool = True


@dataclass(frozen=True)
class OperatorView:
    """One state as it is to be shown.

    ``parts``: what is named first: one or two parts of the rig, else the fault. ``text``: it in a sentence.
    ``follows``: alarms, active or latched, that follow from the culprit, or all others without one.
    ``steps``: what to do, the first one safe.
    ``entry``: `KEEP_OUT` or `LOCK_OUT_FIRST`; ``entry_why``: why, or what is to be locked out.
    ``unheld``: nothing shows that the load is held.
    """

    causes: tuple[FaultCause, ...]
    does: str
    blocks: str
    steps: tuple[Instruction, ...]
    entry: str
    entry_why: str
    parts: tuple[str, ...] = ()
    text: str = ""
    follows: tuple[str, ...] = ()
    priority: str = ""
    unheld: bool = False

    @property
    def next_step(self) -> str:
        """The steps in one line, numbered."""
        return "  ".join(self.numbered)

    @property
    def numbered(self) -> list[str]:
        """The steps, each with its number."""
        return [f"{at} {step.text}" for at, step in enumerate(self.steps, 1)]


_NOT_SHOWN = (PowerOff.AWAITED.name, PowerOff.UNCONFIRMED.name)
_DOES = {
    "DISARMED": "the drive is {drive}; {held}",
    "HOLD": "holds the stroke: {held}",
    "TENSIONING": "ramps the tension up to {target}",
    "COMPENSATING": "keeps the tension at {target}: the stroke moves by itself",
    "RELEASING": "lowers the tension until the rope is slack, then holds",
    "FAULT": "stroke to be held: {held}",
}
_ON_MOTOR = ("MOTOR", "TAKING", "NOTHING")
_SINKING = frozenset(fault.name for fault in having(Trait.LOAD_SINKS))
_SAID = frozenset({*_SINKING, "E_STOP", "STROKE_JUMPED", "DRIVE_FAULT"})
"""Causes with steps of their own."""
_SILENT = "Every device is silent: check the bus, its interface and the devices' power, away from the load."
_RESET_SAID = re.compile(r"[,;]? (?:then reset|before a reset|before tensioning again|no reset while it sinks)")


def view(state: dict[str, Any], alarms: Sequence[Alarm] = (), lock_out: str = "") -> OperatorView:
    """The view of a state message; of one without a record only that nothing is known.

    ``alarms``: rows as of now, which know since when a latched fault is there whose cause is gone.
    ``lock_out``: ``safety.lock_out`` of the rig file.
    """
    if state.get("mode") is None or not state.get("loop_alive"):
        return _without_loop(state)
    causes, flags = _causes(state, alarms), state.get("flag_names", [])
    verbs = refused_now(state)
    entry, why, unheld = _entry(state, flags, lock_out)
    parts, text, after, priority = _headline(state, causes, alarms)
    return OperatorView(causes, _does(state, flags), _blocks(state, causes, verbs),
                        _steps(state, causes, verbs, entry, lock_out), entry, why, parts, text, after,
                        priority, unheld)  # fmt: skip


def _without_loop(state: dict[str, Any]) -> OperatorView:
    """The view while no record comes: the daemon starts, or its loop is started anew, or neither."""
    waits_for = state.get("waits_for")
    wait = f"Wait for: {waits_for}. If it does not come: see the daemon's log."
    last = Instruction(wait, places=(HandsAt.COMPUTER,)) if waits_for else _START
    steps = Instruction(_HALL), Instruction(if_it_moves(state)), last
    starts = bool(waits_for) and state.get("mode") is None
    does = "not known: this start has not enabled the drive" if starts else "not known: the loop writes no records"
    text = f"the daemon starts, and waits for: {waits_for}" if starts else "the loop writes no records"
    return OperatorView((), does, "", steps, KEEP_OUT, "what the rig does is not known", (mode(state),), text)


def _active(state: dict[str, Any]) -> list[dict[str, Any]]:
    found = state.get("causes")
    return [cause for cause in found if isinstance(cause, dict)] if isinstance(found, list) else []


def _causes(state: dict[str, Any], alarms: Sequence[Alarm]) -> tuple[FaultCause, ...]:
    """Active causes, and the latched fault where its own cause is gone; none without a latched fault.

    What the culprit explains comes last, after the latched fault.
    """
    latched = state.get("fault")
    if not latched:
        return ()
    result = []
    for cause in _active(state):
        name = str(cause.get("fault", ""))
        fault, since = Fault.__members__.get(name, Fault.NONE), cause.get("since_wall_ns")
        value, limit = (figure(fault, key, cause.get(key), str(cause.get("text", ""))) for key in ("value", "limit"))
        result.append(
            FaultCause(
                name,
                str(cause.get("text", "")),
                value,
                limit,
                since if isinstance(since, int) else None,
                bool(cause.get("blocks_reset")),
                fault.remedy,
            )
        )
    if not any(cause.fault == latched for cause in result):
        fault = Fault.__members__.get(str(latched), Fault.NONE)
        row = _row_of(str(latched), str(state.get("fault_text", "")), alarms)
        value, limit, since = (row.value, row.limit, row.last_ns) if row is not None else ("", "", None)
        result.append(FaultCause(str(latched), str(state.get("fault_text", "")), value, limit, since, False,
                                 fault.remedy, stands=False))  # fmt: skip
    folded = explained(state)
    return tuple(sorted(result, key=lambda cause: cause.fault in folded and cause.fault != latched))


def _row_of(fault: str, text: str, alarms: Sequence[Alarm]) -> Alarm | None:
    """The newest row of a fault; of a rig file's limit the row of that limit, which begins the fault's text."""
    rows = [row for row in alarms if row.cause == fault or row.cause.startswith(f"{fault} ")]
    own = [row for row in rows if text.startswith(row.cause.partition(" ")[2])]
    return max(own, key=lambda row: row.last_ns, default=None)


def _headline(
    state: dict[str, Any], causes: tuple[FaultCause, ...], alarms: Sequence[Alarm]
) -> tuple[tuple[str, ...], str, tuple[str, ...], str]:
    """What is named first, in words; the alarms that follow from it; its priority."""
    if not causes:
        return (), "", (), ""
    root = causes[0]
    row = _row_of(root.fault, root.text, alarms)
    culprit = state.get("culprit")
    culprit = culprit if isinstance(culprit, dict) else {}
    named = culprit.get("parts")
    open_rows = [alarm for alarm in alarms if (alarm.stands or alarm.latched) and alarm is not row]
    rows = [alarm.cause for alarm in open_rows if not named or follows(alarm, state)]
    after = rows if alarms else list(dict.fromkeys(cause.fault for cause in causes if cause.fault != root.fault))
    parts = tuple(str(part) for part in named[:2]) if isinstance(named, list) and named else (root.fault,)
    aged = root.text and Trait.AGE in Fault.__members__.get(root.fault, Fault.NONE).traits
    text = str(culprit.get("text") or (f"{root.text} at the trip" if aged else root.text))  # it goes on getting older
    return parts, text, tuple(after), row.priority.name if row is not None else ""


def _does(state: dict[str, Any], flags: list[str]) -> str:
    mode_name = str(state["mode"])
    if "drive" in doubts(state):
        return "not known: nothing valid is heard of the drive"
    if mode_name == "FAULT" and "stopping" in flags and "drive_enabled" in flags:
        return "stops the drive, then takes it off power"
    disarms = state.get("held_by") == "CLOSING"  # a DISARM that waits for the drive has the flag too
    if mode_name == "DISARMED" and "arming" in flags and not disarms:
        return "checks before arming; then the drive comes on"
    target = state.get("target_n")
    words = _DOES.get(mode_name, mode_name).format(
        target=number(target, 1, "N") if isinstance(target, int | float) else "-",
        held=held(state),
        drive=drive(state),
    )
    words = f"{words}; then FAULT" if mode_name == "RELEASING" and state.get("fault") else words
    return "; ".join(filter(None, (words, ending(state))))


def _blocks(state: dict[str, Any], causes: tuple[FaultCause, ...], verbs: dict[str, str]) -> str:
    """What keeps a reset from being accepted; "" without a latched fault."""
    if not state.get("fault"):
        return ""
    active = list(dict.fromkeys(cause.fault for cause in causes if cause.stands))
    if not verbs["reset"]:
        blocking = [cause.fault for cause in causes if cause.stands and cause.blocks_reset]
        if blocking:
            return f"nothing: {_ANEW}"
        return (
            f"nothing, but {', '.join(active)} is active and may trip again" if active else "nothing: RESET is accepted"
        )
    match reason_now(state, "reset"):
        case Refusal.CAUSE_PRESENT.name:
            blocking = [cause.fault for cause in causes if cause.stands and cause.blocks_reset]
            return ", ".join(dict.fromkeys(blocking)) or verbs["reset"]
        case Refusal.STOP_RUNNING.name:
            return "the drive is still stopping"
        case Refusal.WRONG_MODE.name:
            return "the tension is being lowered first"
    return verbs["reset"]


_ANEW = "RESET is accepted, and starts all devices anew"


def _steps(
    state: dict[str, Any], causes: tuple[FaultCause, ...], verbs: dict[str, str], entry: str, lock_out: str
) -> tuple[Instruction, ...]:
    """What to do, in order: the first step is safe, and each is a thing in the hall or a button that is there."""
    if ending(state):
        lower = (Instruction("LOWER has the motor lower the load now.", "lower"),) if not verbs["lower"] else ()
        text = "Support the payload from below, or wait until the motor has lowered it."
        support = Instruction(text, places=_SUPPORTED, hands=Hands.SUPPORT)
        return Instruction(_HALL), support, *lower
    if state.get("fault"):
        return _after_fault(state, causes, verbs, entry, lock_out)
    mode_name = str(state["mode"])
    if _slips(state):
        return Instruction(_HALL), *_on_brake_that_fails(state, verbs)
    if mode_name == "DISARMED":
        failing = list(((state.get("preflight") or {}).get("failing") or {}).values())
        barred = [Instruction(f"{_sentence(words)}") for words in failing[:2]]
        if len(failing) > 2:
            barred.append(Instruction(f'See {len(failing) - 2} more under "before arming".'))
        clears = [Instruction("RESET clears the drive's own fault.", "reset")] if not verbs["reset"] else []
        ready = "ARM." if not verbs["arm"] else "ARM, once nothing bars it."
        return (Instruction("See that the hall is empty."), *barred, *clears, Instruction(ready, "arm"))
    if mode_name == "HOLD" and BRAKE_FAILS in state.get("flag_names", []):
        test = "Support the payload from below; rigctl brake-test shows whether the brake holds."
        slack = (Instruction("RELEASE lowers the load.", "release"),) if not verbs["release"] else ()
        off = Instruction("DISARM, once the rope is slack.", "disarm")
        return Instruction(_HALL), Instruction(test, places=_SUPPORTED), *slack, off
    if mode_name == "HOLD":
        lowers = "RELEASE lowers the load, DISARM leaves it to the brake."
        out = Instruction(lowers if not verbs["release"] else "DISARM.", "disarm")
        return Instruction("See that the hall is empty."), Instruction("TENSION goes on.", "tension"), out
    last = (Instruction("RELEASE ends the run.", "release"),) if not verbs["release"] else ()
    return Instruction(_HALL), Instruction("HOLD stops the stroke at any time.", "hold"), *last


def _after_fault(
    state: dict[str, Any], causes: tuple[FaultCause, ...], verbs: dict[str, str], entry: str, lock_out: str
) -> tuple[Instruction, ...]:
    steps: list[Instruction] = []
    culprit = state.get("culprit")
    culprit = culprit if isinstance(culprit, dict) else {}
    parts = tuple(map(str, culprit.get("parts") or ())) or (HandsAt.RIG,)
    stopped = any(cause.stands and cause.fault == Fault.E_STOP.name for cause in causes)
    if _slips(state):
        steps += _on_brake_that_fails(state, verbs)
    elif state.get("power_off") == PowerOff.UNCONFIRMED.name and stopped:
        steps.append(Instruction("Keep out and secure the load: nothing shows that the drive has no power."))
    elif state.get("power_off") == PowerOff.UNCONFIRMED.name:
        unpowered = "Press the emergency stop and secure the load: nothing shows that the drive has no power."
        steps.append(Instruction(unpowered, places=(HandsAt.E_STOP,), hands=Hands.PRESS))
    said = _slips(state) and parts == (Part.BRAKE,)  # of a brake that fails, the first steps are given already
    name = lock_out or "the drive"
    if entry == LOCK_OUT_FIRST:
        steps.append(Instruction(f"Before walking in, lock out {name}."))
    if culprit.get("first") and not said:
        steps.append(Instruction(_sentence(str(culprit["first"])), places=parts, hands=Hands.MEND))
    elif not steps:
        blind = f"Keep out. To go in: emergency stop, lock out {name}."
        steps.append(Instruction(blind if "drive" in doubts(state) else _HALL))
    if culprit.get("question"):
        steps.append(Instruction(_sentence(str(culprit["question"])), places=parts))
    steps += _of_other_causes(state, causes, parts if culprit.get("first") else ())
    carried = reason_now(state, "reset") == Refusal.CARRIED.name
    if (carried or any(cause.fault in _SINKING for cause in causes)) and not verbs["lower"]:
        steps.append(Instruction("LOWER has the motor lower the load.", "lower"))
    if entry == LOCK_OUT_FIRST:
        steps.append(Instruction("See that the hall is empty; take the lock-out off."))
    if any(cause.stands and cause.fault == Fault.STROKE_JUMPED.name for cause in causes):
        measured = "Give the stroke measured at the cylinder: rigctl confirm-stroke MM."
        steps.append(Instruction(measured, "confirm-stroke", ReadAtRig.STROKE))
        homed = "Where the drive has another position, home it with its own tool, or have its encoder repaired."
        steps += [] if Part.ENCODER in parts else [Instruction(homed, places=(Part.ENCODER,), hands=Hands.MEND)]
    if stopped:
        steps.append(Instruction("Release the emergency stop.", places=(HandsAt.E_STOP,), hands=Hands.RELEASE))
    return *steps, *_reset(state, causes, verbs)


def _of_other_causes(
    state: dict[str, Any], causes: tuple[FaultCause, ...], parts: tuple[str, ...]
) -> Iterator[Instruction]:
    """What the active causes need that the step of the culprit, at ``parts``, does not say."""
    quality = state.get("quality") or {}
    if all(quality.get(device, "good") != "good" for device in DEVICES) and Part.BUS not in parts:
        yield Instruction(_SILENT, places=(Part.BUS,), hands=Hands.MEND)
        return
    active = [cause for cause in causes if cause.stands and cause.fault not in explained(state)]
    root = next((cause for cause in active if cause.blocks_reset), next(iter(active), causes[0]))
    over = bool(active) and all(cause.fault != state.get("fault") for cause in active) and root.fault not in _SAID
    said = root.fault == Fault.E_STOP.name  # its release is a step of its own, after a look at the hall
    if root.remedy and not said and (over or not parts):  # the remedy of a symptom leads astray
        places = suspects(Fault.__members__.get(root.fault, Fault.NONE)) or (HandsAt.RIG,)
        remedy = _sentence(_RESET_SAID.sub("", root.remedy).rstrip("."))
        yield Instruction(remedy, places=places, hands=Hands.MEND)


def _slips(state: dict[str, Any]) -> bool:
    """The brake has a load that it is known not to hold, or that a motor did not hold for it."""
    fails = BRAKE_FAILS in state.get("flag_names", []) or reason_now(state, "lower") == Refusal.DISAGREE.name
    slack = reason_now(state, "carry") == Refusal.SLACK.name
    return fails and not slack and state.get("held_by") not in _ON_MOTOR


def _on_brake_that_fails(state: dict[str, Any], verbs: dict[str, str]) -> tuple[Instruction, ...]:
    """The motor alone can hold the load; where it cannot be switched on, hands do from below."""
    if not verbs["carry"]:
        carry = Instruction("The brake does not hold the load: CARRY has the motor hold it, LOWER lowers it.", "carry")
        return carry, _BY_ONE
    slack_s = state.get("slack_s")
    when = f"in about {slack_s:.0f} s" if isinstance(slack_s, int | float) else "at a time that is not known"
    why = f"the brake does not hold it ({verbs['carry']}), and the rope is slack {when}"
    return (Instruction(f"Support the payload from below: {why}.", places=_SUPPORTED, hands=Hands.SUPPORT),)


def _reset(state: dict[str, Any], causes: tuple[FaultCause, ...], verbs: dict[str, str]) -> tuple[Instruction, ...]:
    """The reset, when it is accepted, and what is left where it is not."""
    blocking = list(dict.fromkeys(cause.fault for cause in causes if cause.stands and cause.blocks_reset))
    active = any(cause.stands for cause in causes)
    if not verbs["reset"]:
        words = "RESET; it starts all devices anew." if blocking else "RESET; the fault may trip again."
        return (Instruction(words if active else "RESET.", "reset"),)
    match reason_now(state, "reset"):
        case Refusal.CAUSE_PRESENT.name if blocking:
            silent = any(Trait.DEVICE_SILENT in Fault[name].traits for name in blocking if name in Fault.__members__)
            others = count(len(blocking) - 1, "other cause")
            gone = f"{blocking[0]} is gone" if len(blocking) == 1 else f"{blocking[0]} and {others} are gone"
            anew = Instruction("Else start the daemon anew.", places=(HandsAt.COMPUTER,), hands=Hands.START)
            return Instruction(f"RESET, once {gone}.", "reset"), *((anew,) if silent else ())
        case Refusal.WRONG_MODE.name:
            return (Instruction("RESET, once the rope is slack.", "reset"),)
        case Refusal.STOP_RUNNING.name:
            return (Instruction("RESET, once the drive has stopped.", "reset"),)
        case Refusal.CARRIED.name:
            return (Instruction("RESET, once the motor has lowered the load.", "reset"),)
    return (Instruction("RESET, once nothing bars it.", "reset"),)


def _sentence(words: str) -> str:
    """Words as a sentence."""
    return f"{words[:1].upper()}{words[1:]}" + ("" if words[-1:] in ".?!" else ".")


def _entry(state: dict[str, Any], flags: list[str], lock_out: str) -> tuple[str, str, bool]:
    """No promise of safety: the lock-out at the rig makes it safe, not this program. Third: the load is not held."""
    if "drive" in doubts(state):
        return KEEP_OUT, "nothing valid is heard of the drive", True
    if "drive_enabled" in flags:
        return KEEP_OUT, "the drive is on, the stroke may move at any time", False
    named = {str(state.get("fault")), *(str(cause.get("fault")) for cause in _active(state))}
    if named & _SINKING or BRAKE_FAILS in flags:
        return KEEP_OUT, f"the brake does not hold the load: {held(state)}", True
    unsafe = isinstance(state.get("slack_s"), int | float) or state.get("power_off") in _NOT_SHOWN
    if state.get("held_by") not in ("BRAKE", None) or unsafe:
        return KEEP_OUT, held(state), unsafe
    tension = trusted(state, "tension_n")
    carries = number(tension, 1, "N") if tension is not None else "an unknown tension"
    name = lock_out or "the drive; its lock-out has no name (safety.lock_out)"
    return LOCK_OUT_FIRST, f"{name}: rope and brake carry {carries}", False
