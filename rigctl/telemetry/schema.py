"""What ``meta/schema`` answers: enough to decode the fast stream and read the state without this package."""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any

from rigctl.control.gate import Verdict
from rigctl.control.modes import Mode, Refusal, Verb
from rigctl.control.safety import Check, Fault
from rigctl.telemetry import block
from rigctl.telemetry.events import FAULT_TEXT, Kind
from rigctl.telemetry.keys import SEVERITIES, Keys
from rigctl.telemetry.lease import Act
from rigctl.telemetry.notes import Note
from rigctl.telemetry.record import RECORD, Flag, Quality
from rigctl.telemetry.state import DERIVED

_ENUMS: dict[str, type[IntEnum | IntFlag]] = {
    "modes": Mode, "faults": Fault, "flags": Flag, "quality": Quality, "verdicts": Verdict,
    "checks": Check, "refusals": Refusal, "verbs": Verb, "event_kinds": Kind, "note_kinds": Note,
}  # fmt: skip


def _record_fields() -> list[dict[str, Any]]:
    dtype = RECORD.dtype
    described = {field.name: field for field in RECORD.fields}
    rows: list[dict[str, Any]] = []
    for name in dtype.names or ():
        kind, offset = dtype.fields[name][:2]  # type: ignore[index]
        field = described.get(name)
        rows.append(
            {
                "name": name,
                "type": kind.str if kind.itemsize > 1 else kind.str.replace("|", ""),
                "struct": field.code if field else "Q",
                "offset": offset,
                "size": kind.itemsize,
                "shape": [],
                "unit": field.unit if field else "",
                "description": field.description if field else "sequence number, from 1, without gaps",
            }
        )
    return rows


def _header_fields() -> list[dict[str, Any]]:
    return [{"name": name, "struct": code, "description": text} for name, code, text in block.HEADER_FIELDS]


def schema(rig: str) -> dict[str, Any]:
    """The schema of one rig."""
    keys = Keys(rig)
    return {
        "rig": rig,
        "version": block.VERSION,
        "fast": {
            "key": keys.fast,
            "byte_order": "little",
            "header": {"struct": block.HEADER.format, "size": block.HEADER.size, "fields": _header_fields()},
            "record": {
                "struct": "<Q" + RECORD.layout.format.lstrip("<"),
                "size": RECORD.dtype.itemsize,
                "fields": _record_fields(),
            },
            "missed": f"get {keys.fast}?after=SEQ answers one block with the records after SEQ that are still held",
        },
        "state": {
            "key": keys.state,
            "fields": "names of the record, and derived",
            "derived": [{"name": name, "unit": unit, "description": text} for name, unit, text in DERIVED],
        },
        "events": {
            "keys": {severity: keys.event(severity) for severity in SEVERITIES},
            "sources": {"loop": "kind is one of event_kinds", "gateway": "kind is one of note_kinds"},
            "missed": f"get {keys.events_past}?after=SEQ;after_note=SEQ answers a list of those still held: of the "
            "loop's events after the one, of the gateway's notes after the other; each has its own sequence",
        },
        "commands": {
            "keys": {verb.name.lower(): keys.command(verb.name.lower()) for verb in Verb},
            "payload": {
                "operator": "text, who gives it",
                "lease": "id from an earlier answer; without it the lease nobody holds is taken",
                "value": "newtons: the target, or the known weight of calibrate",
                "shunt": "true: calibrate against the shunt",
                "adopt": "true: calibrate sets the scale",
                "tight": "true: identify only a tight rope",
                "near_end": "true: arm at an end of the stroke, to drive away from it",
            },
        },
        "lease": {
            "keys": {act.name.lower(): keys.command(act.value) for act in Act},
            "payload": {
                "operator": "text, who asks",
                "lease": "id from an earlier answer",
                "reason": "text: why it is taken over from another",
            },
            "rule": "one operator commands at a time; hold is accepted from anyone, and takes no lease",
        },
        "enums": {name: {member.name: int(member) for member in kind if member.name} for name, kind in _ENUMS.items()},
        "fault_texts": {fault.name: text for fault, text in FAULT_TEXT.items()},
    }
