"""Words of events, refusals, faults, checks and notes, by a name that holds the values they were made from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import product
from types import MappingProxyType

from hil.texts import event_samples
from hil.texts.event_samples import in_name
from rigctl.ipc import notes, supervision
from rigctl.model.checks import Check
from rigctl.model.device_states import DriveState
from rigctl.model.events import worded
from rigctl.model.faults import Fault, Trait
from rigctl.model.refusal_words import refusal_text
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

Named = Iterator[tuple[str, str]]
_LIMITS_N = (50.0, 350.0)
_DRIVE = (Refusal.DRIVE_TIMEOUT, Refusal.DRIVE_STATE, Refusal.OFF_UNSEEN)
_OF_VERB_AND_MODE = (Refusal.WRONG_MODE, Refusal.ALREADY, Refusal.OUT_OF_RANGE)


def words() -> dict[str, str]:
    """All of them by name."""
    return {name: text for part in (_events(), _refusals(), _faults(), _notes()) for name, text in part}


def _events() -> Named:
    for sample in event_samples.samples():
        found = worded(*sample)
        yield sample.name, f"{found.severity}: {found.text}"


def _refusals() -> Named:
    for refusal in Refusal:
        if refusal in _OF_VERB_AND_MODE:
            for verb, mode in product(Verb, Mode):
                yield f"refusal {refusal.name} {verb.name} {mode.name}", _refused(refusal, verb=verb, mode=mode)
        elif refusal in _DRIVE:
            for state in (*DriveState, math.nan):
                yield f"refusal {refusal.name} {in_name(state)}", _refused(refusal, value=state)
        elif refusal is Refusal.PREFLIGHT:
            for check in Check:
                yield f"refusal PREFLIGHT {check.name}", _refused(refusal, checks=check)
            details = {Check.DRIVE_FAULT: "its details"}
            several = _refused(refusal, checks=Check.CELL_STALE | Check.DRIVE_FAULT, known=details)
            yield "refusal PREFLIGHT with details", several
        elif refusal is Refusal.CAUSE_PRESENT:
            for fault in filter(None, Fault):
                yield f"refusal CAUSE_PRESENT {fault.name}", _refused(refusal, checks=fault.bit)
            yield "refusal CAUSE_PRESENT of the fault", _refused(refusal)
            both = Fault.E_STOP.bit | Fault.LIMIT.bit
            several = _refused(refusal, checks=both, standing={Fault.LIMIT: "its words"})
            yield "refusal CAUSE_PRESENT of several", several
        else:
            for value in (12.345, -0.001):
                yield f"refusal {refusal.name} {value:g}", _refused(refusal, value=value)


def _refused(
    refusal: Refusal,
    *,
    verb: Verb = Verb.ARM,
    mode: Mode = Mode.FAULT,
    checks: int = 0,
    value: float = math.nan,
    known: Mapping[Check, str] = MappingProxyType({}),
    standing: Mapping[Fault, str] = MappingProxyType({}),
) -> str:
    return refusal_text(refusal, verb, mode, checks, Fault.CELL_STALE, _LIMITS_N, value, known, standing)


_WORDED = (Trait.BLOCKS_RESET, Trait.AGE, Trait.DEVICE_SILENT)
"""Traits that change words or the offer of a reset; the other ones are sets that the loop looks at."""


def _faults() -> Named:
    for fault in Fault:
        traits = ", ".join(trait.name or "" for trait in _WORDED if trait in fault.traits)
        yield f"fault {fault.name}", f"{fault.words}\n{fault.remedy}\n{traits}"


def _notes() -> Named:
    for note, others in product(notes.Note, (("kim", "lee", "a reason"), ("kim", "", ""), ("", "", ""))):
        severity, text = notes.worded(note, *others)
        yield " ".join((f"note {note.name}", *others)).rstrip(), f"{severity}: {text}"
    for doing, process in product(supervision.Doing, ("gateway", "")):
        for reason in ("a reason", ""):
            name = " ".join(filter(None, (f"supervision {doing.name}", process, reason)))
            yield name, ": ".join(supervision.worded(doing, process, reason))
