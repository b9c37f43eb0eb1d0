"""``meta/schema`` is complete: every value the gateway sends has a row with its meaning and unit."""

from __future__ import annotations

import re
import struct
from enum import Enum
from typing import Any

import msgspec
import numpy as np
import pytest

from rigctl.client.decoding import KNOWN_VERSIONS, SchemaError, layout_of
from rigctl.ipc.notes import Note, note_message
from rigctl.ipc.record import EVENT, NOTE, RECORD
from rigctl.model.events import Kind
from rigctl.model.faults import Fault, faults_of
from rigctl.model.lease_acts import LeaseAct
from rigctl.model.verbs import Verb
from rigctl.wire import command_request as request
from rigctl.wire.block import decode, encode
from rigctl.wire.event_message import event_message
from rigctl.wire.lease_request import parse_lease
from rigctl.wire.schema import VERSION, schema

SCHEMA: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(schema("paper_rig")))
UNITS = {"n": "N", "mm": "mm", "mm_s": "mm/s", "rad": "rad", "rad_s": "rad/s", "deg": "deg", "ns": "ns", "ms": "ms",
         "us": "us", "pct": "%", "a": "A", "c": "deg C"}  # fmt: skip


def described(rows: list[dict[str, Any]]) -> set[str]:
    names = [row["name"] for row in rows]
    assert len(set(names)) == len(names)
    assert all(row["description"] and "unit" in row for row in rows)
    return set(names)


def test_every_field_of_the_record_has_type_shape_unit_and_meaning() -> None:
    rows = SCHEMA["fast"]["record"]["fields"]
    assert described(rows) == {"seq", *(field.name for field in RECORD.fields)}
    layout = layout_of(SCHEMA)
    assert layout.dtype == RECORD.dtype
    assert all(row["shape"] == [] and struct.calcsize(f"<{row['struct']}") == row["size"] for row in rows)


def test_a_unit_is_what_the_name_says() -> None:
    rows = [*SCHEMA["fast"]["record"]["fields"], *SCHEMA["state"]["fields"]]
    for row in rows:
        ending = max((end for end in UNITS if row["name"].endswith(f"_{end}")), key=len, default=None)
        if ending is not None and not re.search(r"\d$", row["name"]):
            assert row["unit"] == UNITS[ending], row["name"]


def test_every_kind_of_event_and_every_note_is_there_with_its_fields() -> None:
    loop, gateway = SCHEMA["events"]["sources"]["loop"], SCHEMA["events"]["sources"]["gateway"]
    assert set(loop["kinds"]) == {kind.name for kind in Kind}
    assert set(gateway["kinds"]) == {note.name for note in Note}
    assert all([*loop["kinds"].values(), *gateway["kinds"].values()])
    named = {kind: described(rows) for kind, rows in loop["kind_fields"].items()}
    assert named == {kind.name: {field.name for field in kind.fields} for kind in Kind}
    event = event_message(np.zeros(1, EVENT.dtype)[0], 0)[1]
    note = note_message(np.zeros(1, NOTE.dtype)[0], 0)[1]
    assert described(loop["fields"]) == {*event, "stream"}
    assert described(gateway["fields"]) == {*note, "stream"}


def test_every_verb_is_there_with_just_what_it_takes() -> None:
    verbs, rows = SCHEMA["commands"]["verbs"], described(SCHEMA["commands"]["payload"])
    assert set(verbs) == {verb.name.lower() for verb in Verb}
    examples = {
        "value": 300.0,
        "creep_s": 600.0,
        "gain_file": "text",
        "name": "gains.yaml",
        "where": "hold",
        "by": "cell",
        "supported": True,
    }
    required = {
        "target": {"value"},
        "confirm_stroke": {"value"},
        "move": {"value"},
        "carry": {"value"},
        "gains": {"gain_file", "name"},
        "brake_test": {"supported"},
    }
    for name, said in verbs.items():
        assert said["description"]
        needs = {"operator": "kim"} | {option: examples[option] for option in required.get(name, set())}
        request.parse(Verb[name.upper()], msgspec.json.encode(needs))
        for option in rows - {"operator", "lease", *needs}:
            body = msgspec.json.encode(needs | {option: examples.get(option, True)})
            if option in said["options"]:
                request.parse(Verb[name.upper()], body)
            else:
                with pytest.raises(request.RequestError):
                    request.parse(Verb[name.upper()], body)


def test_the_lease_is_there_with_just_what_it_takes() -> None:
    verbs = SCHEMA["lease"]["verbs"]
    assert set(verbs) == {act.value for act in LeaseAct}
    assert described(SCHEMA["lease"]["payload"]) == {"operator", "reason", "lease", "run_id"}
    for act in LeaseAct:
        body = msgspec.json.encode({"operator": "kim", "reason": "tea"})
        if "reason" in verbs[act.value]["options"]:
            assert parse_lease(act, body).reason == "tea"
        else:
            with pytest.raises(request.RequestError):
                parse_lease(act, body)


def test_every_number_of_an_enumeration_has_its_name() -> None:
    for name, members in SCHEMA["enums"].items():
        assert members, name
        assert not any(isinstance(number, Enum) for number in members.values())
    assert SCHEMA["enums"]["verbs"] == {verb.name: int(verb) for verb in Verb}


def test_every_bit_of_the_causes_in_a_record_has_the_name_of_its_fault() -> None:
    found = {name: faults_of(bit) for name, bit in SCHEMA["enums"]["cause_bits"].items()}
    assert found == {fault.name: [fault] for fault in Fault if fault is not Fault.NONE}


def test_this_client_knows_this_version_and_no_other() -> None:
    assert VERSION in KNOWN_VERSIONS
    for version in (VERSION + 1, 0, "1", None):
        with pytest.raises(SchemaError) as refused:
            layout_of({**SCHEMA, "version": version})
        assert "\n" not in str(refused.value)


def test_an_array_field_is_read_with_its_shape() -> None:
    fields = [
        {"name": "seq", "type": "<u8", "offset": 0, "size": 8},
        {"name": "cov", "type": "<f4", "offset": 12, "size": 16, "shape": [2, 2], "unit": "N^2"},
    ]
    layout = layout_of({"version": VERSION, "fast": {"record": {"size": 32, "fields": fields}}})
    data = struct.pack("<Q4x4f4x", 7, 1, 2, 3, 4)
    block = layout.decode(decode(encode(data, 32, first_seq=7, lost=0, stream=1, head_seq=7)))
    assert block["cov"].tolist() == [[[1.0, 2.0], [3.0, 4.0]]]
    assert layout.fields["cov"].shape == (2, 2)


@pytest.mark.parametrize("fast", [{}, {"record": {"size": 8}}, {"record": {"size": 4, "fields": [
    {"name": "seq", "type": "<u8", "offset": 0, "size": 8}]}}])  # fmt: skip
def test_what_is_no_schema_is_refused_in_one_line(fast: dict[str, Any]) -> None:
    with pytest.raises(SchemaError, match="meta/schema cannot be used: ") as refused:
        layout_of({"version": VERSION, "fast": fast})
    assert "\n" not in str(refused.value)
