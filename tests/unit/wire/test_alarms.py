"""Alarms: one row for each cause, whatever the order and number of its events."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config import rig_file
from rigctl.ipc.notes import Note
from rigctl.ipc.notes import worded as worded_note
from rigctl.model.event_row import Priority
from rigctl.model.events import Kind, worded
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault, Trait
from rigctl.model.reactions import Action
from rigctl.model.states import EndStep
from rigctl.wire.alarm_words import alarm_rows, block, in_brief, listed, standing, tally
from rigctl.wire.alarms import CHATTERING_NS, LONGEST_SHELF_S, LOOP_SILENT, ROWS, Alarms, as_message, cause_of, figure
from tests.builders.paths import ROOT

S = 1_000_000_000
CALM: dict[str, Any] = {"mode": "HOLD", "loop_alive": True, "age_ms": 1.0, "wall_ns": 0, "causes": []}


def event(kind: Kind, at_s: float, a: int = 0, b: int = 0, value: float = 0.0, limit: float = 0.0, about: str = "",
          ) -> dict[str, Any]:  # fmt: skip
    """An event as the gateway words it."""
    words = worded(kind, a, b, value, limit, about)
    return {
        "source": "loop", "kind": kind.name, "a": a, "b": b, "value": value, "limit": limit, "about": about,
        "text": words.text, "severity": words.severity, "wall_ns": round(at_s * S), "t_ns": round(at_s * S),
    }  # fmt: skip


def trip(at_s: float, fault: Fault = Fault.CELL_STALE, action: Action = Action.HOLD) -> dict[str, Any]:
    return event(Kind.TRIP, at_s, fault, action, 12e6, 5e6)


def over(at_s: float, fault: Fault = Fault.CELL_STALE) -> dict[str, Any]:
    return event(Kind.CAUSE_OVER, at_s, fault, Action.HOLD, 12e6, 5e6)


def cause(fault: Fault, action: Action = Action.HOLD) -> dict[str, Any]:
    """A standing cause of a state message."""
    return {
        "fault": fault.name, "text": "words", "action": action.name, "value": 12e6, "limit": 5e6,
        "since_wall_ns": 7 * S,
    }  # fmt: skip


def note(kind: Note, at_s: float, cause: str, reason: str = "") -> dict[str, Any]:
    return {
        "source": "gateway", "kind": kind.name, "operator": "kim", "other": cause, "reason": reason,
        "wall_ns": round(at_s * S),
    }  # fmt: skip


def reset(at_s: float, fault: Fault = Fault.CELL_STALE) -> dict[str, Any]:
    return event(Kind.RESET, at_s, fault)


HIGH, URGENT = Priority.HIGH, Priority.URGENT
ACKNOWLEDGED = note(Note.ALARM_ACKNOWLEDGED, 1, "CELL_STALE")
LIMIT = [event(Kind.TRIP, at, Fault.LIMIT, Action.HOLD, 9, 5, "tension_n above") for at in (0.0, 60.0)]
DRIVE = [event(Kind.TRIP, at, Fault.DRIVE_FAULT, Action.HOLD, 9, 5) for at in (0.0, 60.0)]
ERROR, NO_ERROR = (event(Kind.EMERGENCY, at, 5, code, about="00") for at, code in ((0, 0x8130 | 0x11 << 16), (1, 0)))
COURSES: dict[str, tuple[list[dict[str, Any]], dict[str, Any] | None, list[tuple[Priority, str, int]]]] = {
    "a trip has the priority of the rig's reaction: a ramp down": (
        [trip(0, action=Action.RAMP_DOWN)], None, [(HIGH, "active", 1)]
    ),
    "a hold": ([trip(0)], None, [(HIGH, "active", 1)]),
    "a quick stop": ([trip(0, action=Action.QUICK_STOP)], None, [(URGENT, "active", 1)]),
    "a power off": ([trip(0, action=Action.POWER_OFF)], None, [(URGENT, "active", 1)]),
    "the strongest reaction of one cause is its priority": (
        [trip(0, action=Action.POWER_OFF), over(1), trip(2)], None, [(URGENT, "active", 2)]
    ),
    "so is that of the state": (
        [trip(0)], CALM | {"causes": [cause(Fault.CELL_STALE, Action.QUICK_STOP)]}, [(URGENT, "active", 1)]
    ),
    "a cause that trips while it is active has come once": (
        [trip(0), event(Kind.CAUSE, 1.0, Fault.CELL_STALE, Action.HOLD, 12e6, 5e6)], None, [(HIGH, "active", 1)]
    ),
    "one that no event has ended and no state names is not watched": ([trip(0)], CALM, [(HIGH, "not watched", 1)]),
    "it stays once it is over": ([trip(0), over(1)], CALM, [(HIGH, "cleared", 1)]),
    "until its reset": ([trip(0), over(1), reset(2)], CALM, []),
    "which does not hide what comes again": ([trip(0), over(1), reset(2), trip(3)], None, [(HIGH, "active", 2)]),
    "nor where the end of its cause was not reported": ([DRIVE[0], reset(30, Fault.DRIVE_FAULT)], CALM, []),
    "but again": ([DRIVE[0], reset(30, Fault.DRIVE_FAULT), DRIVE[1]], None, [(HIGH, "active", 2)]),
    "a limit too": ([LIMIT[0], event(Kind.RESET, 30, Fault.LIMIT)], CALM, []),
    "and again": ([LIMIT[0], event(Kind.RESET, 30, Fault.LIMIT), LIMIT[1]], None, [(HIGH, "active", 2)]),
    "or its acknowledgement": ([trip(0), ACKNOWLEDGED, over(3)], None, []),
    "after which it comes again": ([trip(0), ACKNOWLEDGED, over(3), trip(5)], None, [(HIGH, "active", 2)]),
    "a device withdraws its emergency": ([ERROR, NO_ERROR], CALM, [(Priority.LOW, "cleared", 1)]),
    "and until then it is active": ([ERROR], CALM, [(Priority.LOW, "active", 1)]),
    "a restart of the loop ends what was active": (
        [event(Kind.LIMIT, 0, Fault.LIMIT, Action.LOG, 9, 5, "tension_n above"), event(Kind.STARTED, 1)], CALM,
        [(Priority.LOW, "cleared", 1)],
    ),
    "lateness is no alarm": ([event(Kind.CLOCK, 0, 3)], CALM, []),
}  # fmt: skip
"""Events and newest state, and of each row its priority, condition and how often it has come."""


@pytest.mark.parametrize("course", COURSES)
def test_of_events_and_state_come_these_rows(course: str) -> None:
    events, state, expected = COURSES[course]
    rows = Alarms(events).rows(state, 61 * S)
    assert [(row.priority, row.condition, row.count) for row in rows] == expected
    assert not any(row.acknowledged for row in rows)


def test_an_acknowledged_row_stays_while_its_cause_is_active() -> None:
    (row,) = Alarms([trip(0), ACKNOWLEDGED]).rows(None, 2 * S)
    assert row.acknowledged == "kim"


def test_a_chattering_alarm_is_one_row() -> None:
    events = [event for at in range(50) for event in (trip(at), over(at + 0.5))]
    (row,) = Alarms(events).rows(CALM, 50 * S)
    assert (row.count, row.first_ns, row.last_ns, row.stands) == (50, 0, 49 * S, False)
    assert row.chatters(50 * S)
    assert not row.chatters(50 * S + CHATTERING_NS)


def test_a_trip_is_a_row_with_words_remedy_value_and_limit() -> None:
    (row,) = Alarms([trip(3.0)]).rows(CALM | {"causes": [cause(Fault.CELL_STALE)]}, 4 * S)
    assert (row.cause, row.priority, row.count, row.first_ns) == ("CELL_STALE", Priority.HIGH, 1, 3 * S)
    assert (row.value, row.limit) == ("12 ms", "5 ms")
    assert row.text == fault_text(Fault.CELL_STALE, 12e6, 5e6)
    assert row.remedy == Fault.CELL_STALE.remedy
    assert row.stands


def test_a_stuck_cell_has_its_limit_and_a_unit() -> None:
    stuck = event(Kind.TRIP, 0.0, Fault.CELL_STUCK, Action.HOLD, 38.0, 20.0)
    (row,) = Alarms([stuck]).rows(None, S)
    assert (row.value, row.limit) == ("38 times", "20 times")


def test_the_row_of_the_latched_fault_is_before_those_that_follow_from_it() -> None:
    """With a silent bus eight newer rows hid it, and the list showed five."""
    alarms = Alarms([trip(0, Fault.BUS_SILENT), trip(1, Fault.CELL_STALE, Action.POWER_OFF)])
    active = [cause(Fault.CELL_STALE), cause(Fault.BUS_SILENT)]
    culprit = {"parts": ["bus"], "follows": ["CELL_STALE", "BUS_SILENT"]}
    state = CALM | {"fault": "BUS_SILENT", "causes": active, "culprit": culprit}
    assert [row.cause for row in alarms.rows(state, 2 * S)] == ["BUS_SILENT", "CELL_STALE"]
    assert [row.cause for row in alarms.rows(state | {"culprit": None}, 2 * S)] == ["CELL_STALE", "BUS_SILENT"]


def test_rows_are_sorted_by_priority_then_by_the_time_when_they_came_whatever_became_of_them() -> None:
    """An alarm that was cleared or acknowledged had been below those of a lower priority."""
    alarms = Alarms([
        event(Kind.LIMIT, 0, Fault.LIMIT, Action.LOG, 9, 5, "tension_n above"), trip(1, Fault.CELL_STALE),
        event(Kind.CAUSE, 2, Fault.DRIVE_FAULT, Action.POWER_OFF), event(Kind.CAUSE, 3, Fault.DRIVE_STALE, Action.HOLD),
        event(Kind.CAUSE_OVER, 4, Fault.DRIVE_FAULT, Action.POWER_OFF), note(Note.ALARM_ACKNOWLEDGED, 5, "CELL_STALE"),
    ])  # fmt: skip
    expected = ["DRIVE_FAULT", "CELL_STALE", "DRIVE_STALE", "LIMIT tension_n above"]
    assert [row.cause for row in alarms.rows(None, 6 * S)] == expected
    alarms.note(trip(7, Fault.CELL_STALE))
    assert [row.cause for row in alarms.rows(None, 8 * S)] == expected, "coming again moves no row"


def test_what_follows_is_together_at_its_strongest_priority_on_every_display() -> None:
    culprit = {"parts": ["bus"], "text": "cut", "follows": ["BUS_SILENT", "DRIVE_UNASKED"]}
    state = CALM | {"fault": "BUS_SILENT", "causes": [cause(Fault.BUS_SILENT)], "culprit": culprit}
    alarms = Alarms([
        event(Kind.ENDING, 0, EndStep.WAITS, 0, 10.0, 300.0), event(Kind.CAUSE, 0.5, Fault.CELL_STALE, Action.HOLD),
        trip(1, Fault.BUS_SILENT), event(Kind.CAUSE, 2, Fault.DRIVE_UNASKED, Action.POWER_OFF),
    ])  # fmt: skip
    rows = alarms.rows(state, 3 * S)
    order = ["BUS_SILENT", "DRIVE_UNASKED", "ENDING", "CELL_STALE"]
    assert [row.cause for row in rows] == order
    assert in_brief(rows, 3 * S, state) == ["URGENT BUS_SILENT +1 that follow", "URGENT ENDING", "HIGH CELL_STALE"]
    labels = [(label, words.split(",")[0]) for label, words, _ in alarm_rows(rows, 3 * S, state)]
    assert labels == [("follows", "HIGH BUS_SILENT"), ("follows", "URGENT DRIVE_UNASKED"), ("alarm", "URGENT ENDING"),
                      ("alarm", "HIGH CELL_STALE")]  # fmt: skip
    lines = [line for line in listed(rows, state, 3 * S) if not line.startswith(("         ", "        ->"))]
    assert [next(name for name in ["CULPRIT", "FIRST", *order] if name in line) for line in lines[:4]] == [
        "CULPRIT", "FIRST", "BUS_SILENT", "DRIVE_UNASKED",
    ]  # fmt: skip
    assert [as_message(row, 3 * S, state)["follows"] for row in rows] == [True, True, False, False]


def test_an_urgent_alarm_is_above_a_culprit_whose_alarms_are_high() -> None:
    state = CALM | {"mode": "FAULT", "fault": "CELL_STALE", "causes": [cause(Fault.CELL_STALE)],
                    "culprit": {"parts": ["tension cell"], "text": "silent", "follows": ["CELL_STALE"]}}  # fmt: skip
    alarms = Alarms([trip(0), event(Kind.ENDING, 1, EndStep.WAITS, 0, 10.0, 300.0)])
    rows = alarms.rows(state, 2 * S)
    assert [row.cause for row in rows] == ["ENDING", "CELL_STALE"]
    lines = listed(rows, state, 2 * S)
    assert lines[0].startswith("URGENT  ENDING")
    assert lines[3].startswith("CULPRIT tension cell")


def test_a_priority_does_not_fall_while_the_alarm_is_open() -> None:
    """The state had lowered that of an escalation again: its own reaction had been the weaker one."""
    escalation = event(Kind.ESCALATION, 1, Fault.BUS_SILENT, 1)
    alarms = Alarms([trip(0, Fault.BUS_SILENT), escalation])
    state = CALM | {"mode": "FAULT", "fault": "BUS_SILENT", "causes": [cause(Fault.BUS_SILENT)]}
    (row,) = alarms.rows(state, 2 * S)
    assert row.priority is Priority.URGENT
    alarms.note(note(Note.ALARM_ACKNOWLEDGED, 3, "BUS_SILENT"))
    alarms.note(over(4, Fault.BUS_SILENT))
    alarms.note(event(Kind.CAUSE, 5, Fault.BUS_SILENT, Action.HOLD, 16e6, 15e6))  # latched meanwhile, so still open
    (row,) = alarms.rows(state, 6 * S)
    assert row.priority is Priority.URGENT
    alarms.note(over(7, Fault.BUS_SILENT))
    alarms.note(event(Kind.RESET, 8, Fault.BUS_SILENT))
    alarms.note(trip(9, Fault.BUS_SILENT))
    (row,) = alarms.rows(state, 10 * S)
    assert (row.priority, row.count) == (Priority.HIGH, 3)


def test_each_limit_of_the_rig_file_has_its_own_row() -> None:
    names = ("tension_n above", "stroke_mm above")
    alarms = Alarms([event(Kind.LIMIT, at, Fault.LIMIT, Action.LOG, 9, 5, name) for at, name in enumerate(names)])
    rows = alarms.rows(CALM, 3 * S)
    assert {(row.cause, row.value, row.priority) for row in rows} == {
        ("LIMIT tension_n above", "9 N", Priority.LOW), ("LIMIT stroke_mm above", "9 mm", Priority.LOW),
    }  # fmt: skip
    assert all(row.stands for row in rows)
    alarms.note(event(Kind.LIMIT_OVER, 4, Fault.LIMIT, Action.LOG, 4, 5, names[0]))
    assert [row.cause for row in alarms.rows(CALM, 5 * S) if row.stands] == ["LIMIT stroke_mm above"]


def test_a_limit_that_is_not_watched_any_more_is_not_cleared() -> None:
    name = "cell_age_ms above"
    alarms = Alarms([event(Kind.LIMIT, 0, Fault.LIMIT, Action.LOG, 9, 8, name)])
    left = event(Kind.LIMIT_OVER, 1, Fault.LIMIT, Action.LOG, math.nan, 8, name)
    assert left["text"] == "limit not watched any more: cell_age_ms above 8 ms"
    for value in (math.nan, None):  # in this process, and in JSON
        alarms.note(left | {"value": value})
        (row,) = alarms.rows(CALM, 2 * S)
        assert (row.condition, row.stands, as_message(row, 2 * S)["watched"]) == ("not watched", False, False)
        assert tally([row], 2 * S) == "1 not watched"
    alarms.note(event(Kind.LIMIT_OVER, 3, Fault.LIMIT, Action.LOG, 8, 8, name))
    (row,) = alarms.rows(CALM, 4 * S)
    assert row.condition == "cleared"


def test_a_bus_silent_while_disarmed_is_the_alarm_of_its_fault() -> None:
    """The state names no cause of a row that is only logged, also after the fault has tripped in an armed mode."""
    begins = event(Kind.LIMIT, 3, Fault.BUS_SILENT, Action.LOG, 1016e6, 15e6)
    ends = event(Kind.LIMIT_OVER, 5, Fault.BUS_SILENT, Action.LOG, 15e6, 15e6)
    assert (begins["text"], begins["severity"]) == (
        "BUS_SILENT is active: no frame on the bus for 1016 ms (limit 15 ms)", "warning",
    )  # fmt: skip
    assert ends["text"] == "BUS_SILENT is cleared"
    left = event(Kind.LIMIT_OVER, 5, Fault.BUS_SILENT, Action.LOG, math.nan, 15e6)
    assert left["text"] == "BUS_SILENT is not watched any more"
    for before in ((), (trip(0, Fault.BUS_SILENT), over(1, Fault.BUS_SILENT))):
        alarms = Alarms([*before, begins])
        (row,) = alarms.rows(CALM | {"mode": "DISARMED"}, 4 * S)
        assert (row.cause, row.condition, row.value, row.limit) == ("BUS_SILENT", "active", "1016 ms", "15 ms")
        assert row.text == "no frame on the bus for 1016 ms (limit 15 ms)"
        assert row.remedy == Fault.BUS_SILENT.remedy
        alarms.note(ends)
        assert alarms.rows(CALM | {"mode": "DISARMED"}, 6 * S)[0].condition == "cleared"


@pytest.mark.parametrize("kind", [Kind.BUS_ERROR, Kind.SEND_FAILED, Kind.RECEIVE_FAILED])
def test_a_bus_that_fails_on_is_one_active_alarm_until_a_second_without_a_failure(kind: Kind) -> None:
    """The loop reports it at most once a second; the state's own clock says whether it lasts."""
    alarms = Alarms([event(kind, at, 0x40, about="the rig has gone") for at in range(40)])
    lasts, over = ({**CALM, "wall_ns": round(at * S)} for at in (39.9, 42.0))
    (row,) = alarms.rows(lasts, 99 * S)
    assert (row.condition, row.count, row.chatters(99 * S), row.first_ns) == ("active", 1, False, 0)
    (row,) = alarms.rows(over, 99 * S)
    assert row.condition == "cleared"
    (row,) = [row for row in alarms.rows({**lasts, "loop_alive": False}, 99 * S) if row.cause == kind.name]
    assert row.condition == "cleared", "a loop that has ended reports nothing"
    alarms.note(event(kind, 50, 0x40, about="the rig has gone"))
    assert alarms.rows({**CALM, "wall_ns": 50 * S}, 99 * S)[0].count == 2


@pytest.mark.parametrize("name", ["rig.yaml", "paper_rig.yaml", "plain_rig.yaml"])
def test_the_manual_says_what_the_limit_on_lateness_that_we_ship_does(name: str) -> None:
    (row,) = [row for row in rig_file.load(ROOT / "config" / name).limits if row.signal == "lateness_us"]
    manual = " ".join((ROOT / "docs/operate-reference.md").read_text().split())
    assert f"`lateness_us` {row.high:g} with action `{row.action}`, a LOW alarm" in manual


def test_an_end_that_a_load_delays_is_an_urgent_alarm_until_the_load_is_lowered() -> None:
    alarms = Alarms([event(Kind.ENDING, 1.0, EndStep.WAITS, 0, 10.0, 300.0)])
    (row,) = alarms.rows(CALM, 2 * S)
    assert (row.cause, row.priority, row.stands) == ("ENDING", Priority.URGENT, True)
    assert "300 N" in row.text and "in 10 s the motor lowers the load" in row.text
    alarms.note(event(Kind.ENDING, 11.0, EndStep.LOWERS, 0, 0.0, 300.0))
    (row,) = alarms.rows(CALM, 12 * S)
    assert (row.stands, row.count) == (True, 1)
    alarms.note(event(Kind.ENDING, 19.0, EndStep.LOWERED, 0, 18.0, 0.2))
    (row,) = alarms.rows(CALM, 20 * S)
    assert not row.stands


@pytest.mark.parametrize("step", [EndStep.LEFT, EndStep.GONE, EndStep.LATE])
def test_a_load_that_an_end_leaves_stays_an_alarm(step: EndStep) -> None:
    (row,) = Alarms([event(Kind.ENDING, 1.0, step, 0, 18.0, 300.0)]).rows(CALM, 2 * S)
    assert row.stands
    assert "leaves 300 N to the brake" in row.text


def test_the_state_says_what_stands_where_an_event_is_missing() -> None:
    state = CALM | {"causes": [cause(Fault.BUS_SILENT), cause(Fault.E_STOP, Action.POWER_OFF)]}
    first, second = Alarms().rows(state, 9 * S)
    assert (first.cause, first.priority, first.first_ns) == ("E_STOP", Priority.URGENT, 7 * S)
    assert (second.cause, second.value) == ("BUS_SILENT", "12 ms")
    (row,) = Alarms([trip(0)]).rows(CALM, S)
    assert not row.stands


@pytest.mark.parametrize("state", [{"mode": None, "loop_alive": False, "age_ms": None}, CALM | {"loop_alive": False}])
def test_a_silent_loop_is_the_first_alarm(state: dict[str, Any]) -> None:
    rows = Alarms([trip(0)]).rows(state, S)
    assert rows[0].cause == LOOP_SILENT
    assert rows[0].priority is Priority.URGENT


def test_a_start_is_no_silent_loop_and_a_loop_that_is_started_again_says_what_it_waits_for() -> None:
    start = {"mode": None, "loop_alive": False, "age_ms": None, "waits_for": "rings in shared memory"}
    assert Alarms().rows(start, S) == []
    (row,) = Alarms().rows(CALM | {"loop_alive": False, "waits_for": "heartbeat of the drive"}, S)
    assert row.cause == LOOP_SILENT
    assert row.remedy == "A new loop starts, and waits for: heartbeat of the drive."


def test_a_port_that_another_program_has_is_an_alarm_until_it_is_back() -> None:
    taken, back = (
        {
            "source": "gateway", "kind": note.name, "wall_ns": at, "other": "tcp/a:1",
            "text": worded_note(note, "", "tcp/a:1", "")[1],
        }
        for at, note in ((1, Note.ENDPOINT_TAKEN), (2, Note.ENDPOINT_BACK))
    )  # fmt: skip
    alarms = Alarms([taken, event(Kind.STARTED, 2)])  # another loop gets nobody off the port
    (row,) = alarms.rows(CALM, 3 * S)
    assert (row.cause, row.priority, row.stands) == ("ENDPOINT_TAKEN", Priority.LOW, True)
    assert row.text.startswith("another program has tcp/a:1: ")
    alarms.note(back)
    assert [row.stands for row in alarms.rows(CALM, 3 * S)] == [False]


def test_a_changed_audit_log_is_an_alarm_until_it_is_acknowledged() -> None:
    text = worded_note(Note.AUDIT_LOG_CHANGED, "", "", "was renamed or deleted")[1]
    note = {"source": "gateway", "kind": Note.AUDIT_LOG_CHANGED.name, "wall_ns": 1, "other": "", "text": text}
    alarms = Alarms([note])
    (row,) = alarms.rows(CALM, 3 * S)
    assert (row.cause, row.priority, row.condition, row.is_open) == ("AUDIT_LOG_CHANGED", Priority.LOW, "cleared", True)
    assert row.text.startswith("the audit log was renamed or deleted while the daemon ran; ")
    alarms.note({"source": "gateway", "kind": "ALARM_ACKNOWLEDGED", "operator": "kim", "other": row.cause})
    assert alarms.rows(CALM, 3 * S) == []


def test_words_and_json_of_a_row() -> None:
    (row,) = Alarms([trip(3.0)]).rows(None, 4 * S)
    head, words, remedy = block(row, 4 * S)
    assert "HIGH" in head
    assert words.strip() == row.text
    assert row.remedy in remedy
    assert standing(row, 4 * S) == "active, not acknowledged"
    assert alarm_rows([row], 4 * S)[0][0] == "alarm"
    assert as_message(row, 4 * S)["priority"] == "high"


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault])
def test_value_and_limit_are_those_of_the_words(fault: Fault) -> None:
    scale = 1e6 if Trait.AGE in fault.traits else 1.0
    words = fault_text(fault, 12 * scale, 5 * scale, "tension_n above")
    for name, number in (("value", 12 * scale), ("limit", 5 * scale)):
        assert figure(fault, name, number, "tension_n above") in words
        assert ("{" + name in fault.words) == bool(figure(fault, name, number, "tension_n above"))
        assert figure(fault, name, None) == figure(fault, name, math.nan) == ""


def test_a_shelved_row_is_last_until_its_time_is_over() -> None:
    alarms = Alarms([trip(0, Fault.E_STOP, Action.POWER_OFF), trip(1, Fault.CELL_STALE)])
    alarms.note(note(Note.ALARM_SHELVED, 2, "E_STOP", "60 s: being repaired"))
    assert [row.cause for row in alarms.rows(None, 61 * S)] == ["CELL_STALE", "E_STOP"]
    assert "shelved until" in standing(alarms.rows(None, 61 * S)[1], 61 * S)
    assert alarm_rows(alarms.rows(None, 61 * S), 61 * S)[-1] == ("shelved", "1 alarm: rigctl alarms", "")
    assert [row.cause for row in alarms.rows(None, 62 * S)] == ["E_STOP", "CELL_STALE"]
    alarms.note(note(Note.ALARM_UNSHELVED, 3, "E_STOP"))
    assert alarms.rows(None, 4 * S)[0].cause == "E_STOP"


@pytest.mark.parametrize("reason", ["", "x s: y", "60: y", "9999999 s: y", "-5 s: y"])
def test_a_note_of_another_form_shelves_nothing(reason: str) -> None:
    alarms = Alarms([trip(0), note(Note.ALARM_SHELVED, 1, "CELL_STALE", reason)])
    assert not alarms.rows(None, 2 * S)[0].shelved(2 * S)


def test_no_shelf_lasts_longer_than_a_shift() -> None:
    alarms = Alarms([trip(0), note(Note.ALARM_SHELVED, 0, "CELL_STALE", "999999 s: long")])
    assert not alarms.rows(None, LONGEST_SHELF_S * S)[0].shelved(LONGEST_SHELF_S * S)


KINDS = st.sampled_from([Kind.TRIP, Kind.CAUSE, Kind.CAUSE_OVER, Kind.RESET, Kind.STARTED, Kind.LIMIT, Kind.LIMIT_OVER])
EVENTS = st.lists(st.tuples(KINDS, st.sampled_from([Fault.CELL_STALE, Fault.E_STOP, Fault.LIMIT]),
                            st.sampled_from(["tension_n above", "stroke_mm below"])), max_size=60)  # fmt: skip


@given(EVENTS)
def test_any_events_make_one_row_for_each_cause(raw: list[tuple[Kind, Fault, str]]) -> None:
    events = [event(kind, at, fault, Action.HOLD, 9.0, 5.0, about) for at, (kind, fault, about) in enumerate(raw)]
    now = len(events) * S
    rows = Alarms(events).rows(None, now)
    causes = [row.cause for row in rows]
    assert len(set(causes)) == len(causes)
    onsets = [one for one in events if one["kind"] in ("TRIP", "CAUSE", "LIMIT")]
    assert set(causes) <= {cause_of(one) for one in onsets}
    for row in rows:
        mine = [one for one in onsets if cause_of(one) == row.cause]
        assert 1 <= row.count <= len(mine)
        assert mine[0]["wall_ns"] == row.first_ns <= row.last_ns == mine[-1]["wall_ns"]
        assert row.stands or not row.acknowledged
    order = [(row.shelved(now), row.priority, row.first_ns) for row in rows]
    assert order == sorted(order)


@pytest.mark.study
@given(st.lists(st.text(max_size=20), min_size=ROWS + 5, max_size=ROWS + 9, unique=True))
def test_invented_causes_fill_no_memory(names: list[str]) -> None:
    events = [trip(at, Fault.LIMIT) | {"about": name} for at, name in enumerate(names)]
    assert len(Alarms(events).rows(None, S)) <= ROWS


def test_the_row_of_a_latched_fault_stays_until_the_reset() -> None:
    """Seen: "0 standing" under a red FAULT."""
    alarms = Alarms([trip(3.0), over(4.0)])
    alarms.note(note(Note.ALARM_ACKNOWLEDGED, 4.5, "CELL_STALE"))
    latched = CALM | {"mode": "FAULT", "fault": "CELL_STALE", "fault_text": "no tension sample"}
    (row,) = alarms.rows(latched, 5 * S)
    assert row.condition == "latched"
    assert tally([row], 5 * S) == "1 latched"
    assert alarms.rows(CALM, 5 * S) == []
    assert tally([], 5 * S, barred=2) == "2 checks bar ARM"
