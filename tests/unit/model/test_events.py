"""The rows of events: what the loop writes has a name, and every row can be worded from its names alone."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from enum import IntEnum

import numpy as np
import pytest

from hil.texts.event_samples import of_row, samples
from rigctl.ipc.record import EVENT
from rigctl.model.device_states import NmtState
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.loop_event import LoopEvent
from rigctl.model.reactions import Action
from rigctl.model.states import Event, Mode
from rigctl.wire.event_message import event_message
from rigctl.wire.keys import SEVERITIES
from tests.builders.paths import ROOT

SLOTS = ("a", "b", "value", "limit", "text")
WRITERS = {"event": ("t_ns", "kind", *SLOTS), "notice": ("t_ns", "kind", "a", "b", "text", "value")}
"""Parameters of the methods of `rigctl.control.logbook.Logbook` that write an event."""


def faults_of_row(kind: Kind) -> list[str]:
    """What is wrong with a row by itself."""
    names = [field.name for field in kind.fields]
    slots = [field.slot for field in kind.fields]
    wrong = [] if kind.meaning else ["has no meaning"]
    wrong += [f"{name} is there twice" for name in set(names) if names.count(name) > 1]
    wrong += [f"{field.name} has no meaning" for field in kind.fields if not field.meaning]
    wrong += [] if slots == sorted(slots, key=SLOTS.index) else ["its fields are not in the order of the slot"]
    for sample in of_row(kind):
        try:
            found = worded(*sample)
        except (AttributeError, KeyError) as error:
            wrong.append(f"{sample.name}: {type(error).__name__}: {error}")
            continue
        wrong += [] if found.severity in SEVERITIES and found.text else [f"{sample.name}: {found}"]
    return wrong


def unnamed(kind: Kind) -> set[str]:
    """Values that a sample of a kind has, or a line of the loop writes, and that the row does not name."""
    slots = {slot for written, slot in WRITTEN if written is kind}
    return slots - {field.slot for field in kind.fields}


def written_in(source: str) -> Iterator[tuple[Kind, str]]:
    """Kinds and values that the calls of a module write, but for a plain 0."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in WRITERS:
            given = dict(zip(WRITERS[node.func.attr], node.args, strict=False))
            given |= {keyword.arg or "": keyword.value for keyword in node.keywords}
            kind = given.get("kind")
            if isinstance(kind, ast.Attribute) and ast.unparse(kind.value) == "Kind":
                for slot in SLOTS:
                    if slot in given and ast.unparse(given[slot]) != "0":
                        yield Kind[kind.attr], slot


LINES = {call for file in (ROOT / "rigctl/control").rglob("*.py") for call in written_in(file.read_text())}
WRITTEN = LINES | {
    (event.kind, slot)
    for event in samples()
    for slot in SLOTS
    if (found := getattr(event, slot)) or isinstance(found, IntEnum)
}
"""Kinds and values of their slots that are used."""


@pytest.mark.parametrize("kind", Kind)
def test_a_row_is_complete_and_can_be_worded_from_its_fields(kind: Kind) -> None:
    assert faults_of_row(kind) == []


@pytest.mark.parametrize("kind", Kind)
def test_every_value_that_is_written_has_a_name(kind: Kind) -> None:
    assert unnamed(kind) == set()


def test_the_lines_of_the_loop_that_write_events_are_found() -> None:
    assert len({kind for kind, _ in LINES}) > len(Kind) // 2


def test_a_row_without_one_of_its_fields_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in Kind:
        for field in kind.fields:
            with monkeypatch.context() as patch:
                patch.setattr(kind, "fields", tuple(other for other in kind.fields if other is not field))
                shared = field.slot in {other.slot for other in kind.fields}
                assert shared or unnamed(kind) or faults_of_row(kind), (kind, field.name)


def test_fields_are_read_from_the_values_of_a_slot_and_from_bits_of_them() -> None:
    event = LoopEvent.of(7, Kind.EMERGENCY, 4, 0x8130 | 0x11 << 16, text="00")
    assert event.fields == {"node": 4, "code": 0x8130, "register": 0x11, "manufacturer": "00"}
    event = LoopEvent.of(7, Kind.SETTING_LOST, 4, 0x6085 << 8 | 2, 5.0, 7.0, "words")
    assert (event.fields["index"], event.fields["sub_index"], event.fields["wanted"]) == (0x6085, 2, 7.0)
    mode = LoopEvent.of(7, Kind.MODE, Mode.HOLD, Mode.FAULT, float(Event.TRIP)).fields
    assert (mode["from"], mode["to"], mode["why"]) == (Mode.HOLD, Mode.FAULT, Event.TRIP)
    assert LoopEvent.of(7, Kind.BRAKE_FLAG, 1, 0).fields["fails"] is True


def test_a_number_that_no_enumeration_has_stays_a_number_and_is_worded_only_where_its_row_says_so() -> None:
    assert LoopEvent.of(7, Kind.TRIP, 99).fields["fault"] == 99
    with pytest.raises(ValueError, match="99 is no fault"):
        worded(Kind.TRIP, 99, Action.HOLD, 1.0, 1.0, "")
    assert LoopEvent.of(7, Kind.NODE_STATE, 4, NmtState.OPERATIONAL).fields["state"] is NmtState.OPERATIONAL
    assert worded(Kind.NODE_STATE, 4, 99, 0.0, 0.0, "").text == "node 4: unknown state 99"


def test_slots_of_a_kind_that_this_version_does_not_have_are_left_out() -> None:
    slots = np.zeros(2, EVENT.dtype)
    slots["kind"], slots["seq"], slots["text"] = (9999, Kind.CAUSE_OVER), (1, 2), b"tension_n above"
    (event,) = LoopEvent.of_slots(slots)
    assert (event.seq, event.kind, event.fields["fault"]) == (2, Kind.CAUSE_OVER, Fault.NONE)
    assert event.fields["seen"] == "tension_n above"


def test_a_message_has_the_names_beside_the_numbers() -> None:
    slot = np.zeros(1, EVENT.dtype)[0]
    slot["kind"], slot["a"], slot["b"], slot["limit"] = Kind.LIMIT_OVER, Fault.CELL_STALE, Action.LOG, 5e6
    slot["value"], slot["text"] = math.nan, b"tension_n above"
    message = event_message(slot, 0)[1]
    assert (message["a"], message["b"], message["limit"], message["about"]) == (3, 0, 5e6, "tension_n above")
    assert message["fields"] == {
        "fault": "CELL_STALE", "action": "LOG", "value": None, "limit": 5e6, "seen": "tension_n above"
    }  # fmt: skip
    slot["kind"] = 9999
    assert event_message(slot, 0)[1]["fields"] == {}
