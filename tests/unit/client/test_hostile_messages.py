"""Invalid messages from the network are refused in one line, or shown without a traceback and printable."""

from __future__ import annotations

import contextlib
import io
import itertools
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from rich.console import Console

from rigctl.cli import status, watch
from rigctl.cli.watch_screen import Screen
from rigctl.client import shapes
from rigctl.client.block_order import block
from rigctl.client.decoding import SchemaError, layout_of, usable_schema
from rigctl.client.rig_view import RigView
from rigctl.client.shapes import MessageRefusedError, Refusals
from rigctl.config import rig_file as config
from rigctl.ipc.record import RECORD
from rigctl.model.states import Mode
from rigctl.page.panel import events_message, settings_message, state_message
from rigctl.page.picture import Picture
from rigctl.wire.event_message import event_message
from rigctl.wire.schema import schema
from tests.builders.hostile import ESCAPES, NOT_JSON, blocks, schemas, wronged
from tests.builders.paths import ROOT
from tests.unit.wire.test_state_message import event, record, state

SETTINGS = config.load(ROOT / "config" / "paper_rig.yaml")
STATE: dict[str, Any] = {
    **state(record(mode=Mode.COMPENSATING, target_n=300.0, vertical_n=299.0, tension_n=301.0)),
    "rig": "paper_rig",
    "samples_lost": 0,
    "design": "Ms 1.2",
    "calibration": {"zero_n": 0.1, "scale": 1.0, "due": "2027-01-01T00:00:00Z", "overdue": False, "waiver": None},
    "lease": {"holder": "kim", "since_ns": 1, "until_ns": 2, "held_s": 3.0, "left_s": 57.0},
    "preflight": {"failing": {"E_STOP": "pressed"}, "waived": {"TARE": "for a test"}},
    "audit": {"entries": 5, "head": "00", "failures": 0},
    "trip_dump": "x.mcap",
    "recording": {"file": "a.mcap", "records_lost": 0},
    "warnings": ["a warning"],
    "causes": [
        {
            "fault": "E_STOP",
            "text": "pressed",
            "action": "QUICK_STOP",
            "value": 1.0,
            "limit": 0.0,
            "since_ns": 1,
            "since_wall_ns": 2,
            "blocks_reset": True,
        },
    ],
    "read_back": {"t_ns": 1, "settings": 46, "took_s": 0.46},
    "gateway_wall_ns": 1,
    "stream": 1,
    "event_seq": 1,
    "note_seq": 1,
}
EVENT = {**event_message(event(1, 1, 2, 2.0), 10)[1], "stream": 1}
ACTIVE = {"settings": SETTINGS.model_dump(mode="json"), "version": "1"}
SCHEMA = msgspec.json.decode(msgspec.json.encode(schema("paper_rig")))


def shown(view: RigView) -> str:
    """Everything the operator's programs show of a view."""
    assert view.state is not None
    picture = Picture(view.endpoint)
    picture.take_state(view.state)
    picture.take_active({"settings": view.settings})
    picture.add_events(view.events)
    found = [watch.line(view), *(value for _, value, _ in status.rows(view.state))]
    for made in (state_message(picture, False), settings_message(picture.active), events_message(picture)):
        found.append(msgspec.json.encode(made).decode())
    for width, height in ((80, 30), (40, 12)):
        said = io.StringIO()
        Console(file=said, width=width, height=height, highlight=False).print(Screen(view))
        found += said.getvalue().splitlines()
    return "".join(found)


def view_of(state: Any = STATE, event: Any = EVENT, settings: Any = ACTIVE["settings"]) -> RigView:
    view = RigView("tcp/127.0.0.1:1", "paper_rig")
    view.take_state(state)
    view.take_active({"settings": settings or {}})
    view.add_events([event])
    return view


KINDS: dict[str, tuple[Callable[[bytes], Any], dict[str, Any], Callable[[Any], RigView]]] = {
    "state": (shapes.state, STATE, lambda found: view_of(state=found)),
    "event": (shapes.event, EVENT, lambda found: view_of(event=found)),
    "active": (shapes.active, ACTIVE, lambda found: view_of(settings=found.get("settings"))),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_message_of_ours_is_passed_on_as_it_is(kind: str) -> None:
    decode, right, view = KINDS[kind]
    found = decode(msgspec.json.encode(right))
    assert found == msgspec.json.decode(msgspec.json.encode(right))
    assert shown(view(found)).isprintable()
    assert decode(msgspec.json.encode({**right, "new_in_that_version": [1, {"x": None}]})) != right


@pytest.mark.parametrize("kind", KINDS)
def test_a_message_with_any_value_wrong_is_refused_or_shown(kind: str) -> None:
    decode, right, view = KINDS[kind]
    refused = 0
    # These have hundreds of values: steps that share no factor with the 16 wrong values.
    for where, message in itertools.islice(wronged(right), 0, None, {"active": 29, "state": 3}.get(kind, 1)):
        try:
            found = decode(msgspec.json.encode(message))
        except MessageRefusedError as error:
            refused += 1
            assert str(error).isprintable(), where
            continue
        try:
            said = shown(view(found))
        except Exception as error:
            raise AssertionError(where) from error
        assert said.isprintable(), where
    assert refused > 10


@pytest.mark.parametrize("name", NOT_JSON)
def test_what_is_no_message_is_refused_in_one_line(name: str) -> None:
    refusals = Refusals()
    for decode in (shapes.state, shapes.event, shapes.answer, shapes.past_events, usable_schema):
        with pytest.raises(MessageRefusedError) as refused:
            decode(NOT_JSON[name])
        refusals.add("tele/state", refused.value)
        assert str(refused.value).isprintable()
        assert len(str(refused.value)) < 400
    assert refusals.words.startswith("5 messages refused")


def test_escape_sequences_are_shown_and_not_sent_to_the_terminal() -> None:
    found = shapes.event(msgspec.json.encode({**EVENT, "text": ESCAPES}))
    assert found["text"].startswith(r"\x1b]0;owned\x07\x1b[2J")
    assert r"\x1b[31mOWNED" in shown(view_of(event=found))


@pytest.mark.parametrize("name", schemas(SCHEMA))
def test_a_schema_that_no_client_may_go_by_is_refused(name: str) -> None:
    payload = schemas(SCHEMA)[name]
    with pytest.raises(MessageRefusedError) as refused:
        usable_schema(payload)
    assert str(refused.value).isprintable()
    with contextlib.suppress(MessageRefusedError), pytest.raises(SchemaError):
        layout_of(shapes.document(payload))


@pytest.mark.parametrize("name", blocks(RECORD.dtype.itemsize, 1))
def test_a_block_that_is_none_is_refused(name: str) -> None:
    payload = blocks(RECORD.dtype.itemsize, 1)[name]
    if name in ("from a far future", "of another daemon", "records of one byte"):
        return  # like a block: the stream queries the daemon about it, see test_hostile_network.py
    with pytest.raises(MessageRefusedError):
        block(payload)


def test_a_configuration_without_settings_is_refused() -> None:
    """Anyone on the network may answer ``cfg/active`` with an object; the daemon's names its settings."""
    with pytest.raises(MessageRefusedError, match="settings"):
        shapes.active(b"{}")
