"""Every standing cause of a fault is shown, the strongest first, with its start time, and what blocks a reset."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from hil.faults import on_bus
from hil.faults.stand import Stand
from hil.lockstep import Lockstep
from hil.wire import FRAME
from rigctl.cli import status
from rigctl.devices import objects
from rigctl.gateway.active import ActiveConfiguration
from rigctl.gateway.gateway_process import StateView
from rigctl.gateway.published_position import Cursor
from rigctl.gateway.streams import past_messages
from rigctl.ipc.ledger import Standing
from rigctl.model.events import Kind, worded
from rigctl.model.faults import Fault
from rigctl.model.requests import Request
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.operations.preflight import PreflightVerdict
from rigctl.page.panel import state_message
from rigctl.page.picture import Picture
from rigctl.wire import state_words as figures
from rigctl.wire.alarms import Alarm, Alarms
from rigctl.wire.command_request import NewestRecord, answer
from rigctl.wire.state_message import Causes

CELL = 0x182


class Shown:
    """The state message of a lockstep rig, as its gateway would publish it."""

    def __init__(self, rig: Lockstep) -> None:
        self._rig = rig
        self.view = StateView(rig.runtime, rig.settings, ActiveConfiguration(rig.runtime), {})
        self._cursor = Cursor(rig.runtime.gateway_cursor, rig.runtime.records.path, 0)

    def state(self) -> dict[str, Any]:
        made = self.view.make(self._rig.clock.now(), 0, Standing(), None, PreflightVerdict(), self._cursor)
        return dict(msgspec.json.decode(made))

    def events(self, now_ns: int) -> list[dict[str, Any]]:
        """Those that the rings hold, at ``now_ns`` (wall clock)."""
        rings = self._rig.runtime
        return past_messages(rings.events.reader(), rings.notes.reader(), 0, 0, now_ns - self._rig.clock.now(), 1)

    def alarms(self, state: dict[str, Any]) -> tuple[list[Alarm], int]:
        """The open rows with a state, and the wall clock."""
        now_ns = time.time_ns()
        return Alarms(self.events(now_ns)).rows(state, now_ns), now_ns


@pytest.fixture
def shown(rig: Lockstep) -> Iterator[Shown]:
    assert rig.command(Verb.ARM) is Refusal.NONE
    yield Shown(rig)


def cut(rig: Lockstep, seconds: float) -> None:
    """Drop every frame for a while."""
    on_bus.burst(math.inf)(Stand(rig, "cut"))
    rig.run(seconds)
    rig.hub.tap = None
    rig.run(0.4)


def silent(rig: Lockstep, can_id: int) -> None:
    rig.hub.tap = lambda _, frame: () if FRAME.unpack(frame)[0] == can_id else (frame,)


def test_an_emergency_stop_pressed_after_another_fault_is_shown_first(rig: Lockstep, shown: Shown) -> None:
    cut(rig, 0.03)
    assert rig.loop.machine.fault is Fault.BUS_SILENT
    rig.rig.drive.press_e_stop(True)
    pressed_ns = rig.clock.now()
    rig.run(0.2)
    state = shown.state()
    assert state["fault"] == "BUS_SILENT"
    first = state["causes"][0]
    assert (first["fault"], first["action"], first["value"]) == ("E_STOP", "QUICK_STOP", 1.0)
    assert first["text"] == "emergency stop pressed (drive's input)"
    assert 0 <= first["since_ns"] - pressed_ns <= 5_000_000
    assert first["blocks_reset"]
    why = figures.why(state)
    assert why.startswith("E_STOP: emergency stop pressed (drive's input); latched: BUS_SILENT: no frame on the bus")
    rows = [value for label, value, _ in status.rows(state | {"warnings": []}) if label == "active"]
    assert rows[0].startswith("E_STOP: emergency stop pressed (drive's input), since ")
    assert rows[0].endswith("blocks reset")


def test_a_reset_is_refused_with_everything_that_blocks_it(rig: Lockstep, shown: Shown) -> None:
    silent(rig, CELL)
    rig.run(0.05)
    rig.rig.drive.press_e_stop(True)
    rig.run(0.2)
    shown.state()
    assert rig.command(Verb.RESET) is Refusal.CAUSE_PRESENT
    assert int(rig.reply["checks"]) == Fault.CELL_STALE.bit | Fault.E_STOP.bit
    snapshot = NewestRecord(Fault.CELL_STALE, standing=shown.view.standing)
    text = answer(Request(Verb.RESET, "kim"), rig.reply, snapshot, (0.0, 1.0))["text"]
    assert text.startswith(
        "RESET refused: cause still present: E_STOP (emergency stop pressed (drive's input)), "
        "CELL_STALE (no tension sample for 16 ms (limit 15 ms))"
    )


def test_what_is_gone_is_no_longer_shown_and_told_as_over(rig: Lockstep, shown: Shown) -> None:
    silent(rig, CELL)
    rig.run(0.05)
    assert [cause["fault"] for cause in shown.state()["causes"]] == ["CELL_STALE"]
    rig.events.read()
    rig.hub.tap = None
    rig.run(0.05)
    state = shown.state()
    assert state["causes"] == []
    assert figures.causes(state) == ["no cause is active any more; latched until rigctl reset"]
    (over,) = [event for event in rig.events.read() if event["kind"] == Kind.CAUSE_OVER]
    assert worded(over["kind"], over["a"], over["b"], 0.0, 0.0, "").text == "CELL_STALE is cleared"
    assert rig.command(Verb.RESET) is Refusal.NONE
    assert figures.causes(shown.state()) == []


def test_the_trip_itself_is_told_once_and_a_further_cause_as_one(rig: Lockstep, shown: Shown) -> None:
    rig.events.read()
    silent(rig, CELL)
    rig.run(0.03)
    rig.inject(FRAME.pack(objects.EMCY_BASE + 3, 8, bytes([0x10, 0x50, 0x01, 0, 0, 0, 0, 0])))
    rig.run(0.03)
    told = [(Kind(e["kind"]), Fault(e["a"])) for e in rig.events.read() if e["kind"] in (Kind.TRIP, Kind.CAUSE)]
    assert told == [(Kind.TRIP, Fault.CELL_STALE), (Kind.CAUSE, Fault.SENSOR_EMERGENCY)]
    assert [cause["fault"] for cause in shown.state()["causes"]] == ["CELL_STALE", "SENSOR_EMERGENCY"]


def test_a_row_of_a_mode_that_was_left_stands_no_more(rig: Lockstep, shown: Shown) -> None:
    tilted = rig.rig.plant.parameters
    assert rig.command(Verb.TENSION) is Refusal.NONE
    rig.run(2.0)
    tilted["free_length"] += 1000.0  # the rope breaks: TENSION_LOW, or a limit on its rate, of the modes that move
    rig.run(0.5)
    assert rig.loop.machine.mode is Mode.FAULT
    watched = {row.fault.name for row in shown.view._causes._rows if Mode.FAULT in row.modes}
    assert {cause["fault"] for cause in shown.state()["causes"]} <= watched


def test_a_gateway_that_has_missed_the_events_shows_the_cause_without_figures(rig: Lockstep, shown: Shown) -> None:
    silent(rig, CELL)
    rig.run(0.05)
    record = shown.view._records.latest()
    assert record is not None
    (cause,) = Causes(shown.view._causes._rows).of(record, 0)
    assert (cause["fault"], cause["text"], cause["since_ns"], cause["value"]) == (
        "CELL_STALE", "cell stale", None, None)  # fmt: skip


def test_the_page_says_the_same(rig: Lockstep, shown: Shown) -> None:
    silent(rig, CELL)
    rig.run(0.05)
    rig.rig.drive.press_e_stop(True)
    rig.run(0.2)
    state = shown.state()
    picture = Picture("tcp/x")
    picture.take_state(state | {"warnings": []})
    message = state_message(picture, False)
    assert message["causes"] == figures.causes(state)
    assert message["causes"][0].startswith("E_STOP")
    assert any(words.startswith("CELL_STALE") for words in message["causes"])


@pytest.mark.parametrize("causes", [None, "x", [1], [{}], [{"fault": None, "since_wall_ns": "x"}]])
def test_causes_of_another_version_are_shown_not_raised(causes: object) -> None:
    state = {"mode": "FAULT", "loop_alive": True, "fault": "E_STOP", "fault_text": "pressed", "causes": causes}
    assert "E_STOP: pressed" in figures.why(state)
    assert figures.causes(state)


def test_rows_of_one_fault_with_other_reactions_are_told_apart(rig: Lockstep, shown: Shown) -> None:
    """A lost setting holds; only one the drive needs to obey takes its power: the state shows the row that stands."""
    answers = objects.SDO_TX_BASE + rig.rig.drive.id
    silent(rig, answers)
    rig.run(2.0)
    (lost,) = [cause for cause in shown.state()["causes"] if cause["fault"] == "SUPERVISION_LOST"]
    assert (lost["action"], lost["blocks_reset"]) == ("HOLD", True)


def test_what_the_state_says_blocks_a_reset_is_what_does(rig: Lockstep, shown: Shown) -> None:
    """A limit of the drive's own may stand until its fault is reset."""
    rig.rig.plant.parameters["stroke_high"] = rig.rig.plant.state["motor"]
    rig.run(0.5)
    (limited,) = [cause for cause in shown.state()["causes"] if cause["fault"] == "DRIVE_REFUSES"]
    assert not limited["blocks_reset"]
    assert rig.command(Verb.RESET) is Refusal.NONE
