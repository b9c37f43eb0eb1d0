"""The answer of ``meta/schema``: enough to decode the fast stream and read the state without this package."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum, IntFlag
from typing import Any

from rigctl.ipc.notes import Note
from rigctl.ipc.record import RECORD
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.signals import ENUMS
from rigctl.model.verbs import Refusal, Verb
from rigctl.wire import block
from rigctl.wire.keys import SEVERITIES, Keys
from rigctl.wire.meanings import (
    ACTIVE_CONFIGURATION,
    ACTS,
    ALARM_DECISIONS,
    ALARM_PAYLOAD,
    ANSWER,
    GATEWAY_EVENT,
    KIND_FIELDS,
    KINDS,
    LEASE_PAYLOAD,
    LOOP_EVENT,
    NOTE_PAYLOAD,
    NOTES,
    PAYLOAD,
    VERBS,
    Rows,
)
from rigctl.wire.note_request import NOTE
from rigctl.wire.state_message import DERIVED

VERSION = 2  # changes only when a subscriber of this version would misread the data; added fields do not change it

_ENUMS: dict[str, type[IntEnum | IntFlag]] = {
    **{enum.table: enum.kind for enum in ENUMS.values()},
    "refusals": Refusal, "verbs": Verb, "event_kinds": Kind, "actions": Action, "note_kinds": Note,
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


def _rows(rows: Rows) -> list[dict[str, Any]]:
    return [{"name": name, "json": kind, "unit": unit, "description": text} for name, kind, unit, text in rows]


def _state_fields() -> list[dict[str, Any]]:
    """The record's fields without those that a derived field of the same name replaces, then the derived fields."""
    derived = {row[0] for row in DERIVED}
    taken: Rows = tuple(
        (row["name"], _json_type(row), row["unit"], row["description"])
        for row in _record_fields()
        if row["name"] not in derived
    )
    return _rows(taken + DERIVED)


def _json_type(row: dict[str, Any]) -> str:
    if row["struct"] == "d":
        return "number?"
    return "integer?" if row["name"].endswith("_age_ns") else "integer"


def _commands(keys: Keys, verbs: Mapping[Any, tuple[str, tuple[str, ...]]], name_of: Callable[[Any], str]) -> Any:
    return {
        name_of(verb): {"key": keys.command(name_of(verb)), "description": text, "options": list(options)}
        for verb, (text, options) in verbs.items()
    }


def schema(rig: str, person: str = "") -> dict[str, Any]:
    """The schema of one rig; ``person``: see `Keys`, ``*`` stands for the name in the asker's certificate."""
    keys = Keys(rig, person)
    verbs, acts = _commands(keys, VERBS, lambda v: str(v.name.lower())), _commands(keys, ACTS, lambda a: str(a.value))
    return {
        "rig": rig,
        "version": VERSION,
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
        "state": {"key": keys.state, "fields": _state_fields()},
        "active": {"key": keys.active, "fields": _rows(ACTIVE_CONFIGURATION)},
        "liveliness": {"key": keys.daemon},
        "events": {
            "keys": {severity: keys.event(severity) for severity in SEVERITIES},
            "sources": {
                "loop": {
                    "fields": _rows(LOOP_EVENT),
                    "kinds": {kind.name: text for kind, text in KINDS.items()},
                    "kind_fields": {kind.name: _rows(rows) for kind, rows in KIND_FIELDS.items()},
                },
                "gateway": {"fields": _rows(GATEWAY_EVENT), "kinds": {note.name: text for note, text in NOTES.items()}},
            },
            "missed": f"get {keys.events_past}?after=SEQ;after_note=SEQ answers a list of those still held: of the "
            "loop's events after the one, of the gateway's notes after the other; each has its own sequence",
        },
        "commands": {"verbs": verbs, "payload": _rows(PAYLOAD), "answer": _rows(ANSWER)},
        "lease": {
            "verbs": acts,
            "payload": _rows(LEASE_PAYLOAD),
            "rule": "one operator commands at a time; hold is accepted from anyone, and takes no lease",
        },
        "alarms": {
            "verbs": _commands(keys, ALARM_DECISIONS, lambda act: str(act.value)),
            "payload": _rows(ALARM_PAYLOAD),
            "rule": "every operator may; the decision is a note of the gateway, and displays fold the alarms from "
            "events and notes",
        },
        "note": {
            "key": keys.command(NOTE),
            "payload": _rows(NOTE_PAYLOAD),
            "rule": "every operator may; the words are an event OPERATOR_NOTE of the gateway",
        },
        "enums": {
            **{name: {member.name: int(member) for member in kind if member.name} for name, kind in _ENUMS.items()},
            "cause_bits": {fault.name: fault.bit for fault in Fault if fault},
        },
        "fault_texts": {fault.name: fault.words for fault in Fault},
    }
