"""The operator's view: an answer to each question in every mode, and none that is not known."""

from __future__ import annotations

from typing import Any

import pytest

from rigctl.model.checks import Check
from rigctl.model.events import Kind
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault
from rigctl.model.parts import Part
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Verb
from rigctl.wire import state_words
from rigctl.wire.alarm_words import banner_rows
from rigctl.wire.alarms import Alarms
from rigctl.wire.operator_view import KEEP_OUT, LOCK_OUT_FIRST, view
from tests.builders.offered import offered
from tests.builders.page_states import catalogue
from tests.unit.wire.test_alarms import event, over, trip

STALE = {
    "fault": "CELL_STALE", "text": fault_text(Fault.CELL_STALE, 12e6, 5e6), "action": "HOLD", "value": 12e6,
    "limit": 5e6, "since_wall_ns": 3, "blocks_reset": True,
}  # fmt: skip


def state(mode: Mode, *flags: str, **more: Any) -> dict[str, Any]:
    made = {
        "mode": mode.name, "loop_alive": True, "flag_names": list(flags), "fault": None, "causes": [],
        "target_n": 300.0, "tension_n": 298.7, "quality": {"drive": "good"}, **more,
    }  # fmt: skip
    return {"offers": offered(made), **made}


@pytest.mark.parametrize("mode", Mode)
def test_every_mode_says_what_the_rig_does(mode: Mode) -> None:
    assert view(state(mode, "drive_enabled")).does not in ("", mode.name)
    assert "{" not in view(state(mode)).does


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING, Mode.FAULT])
def test_nobody_walks_in_while_the_drive_is_on_or_unknown(mode: Mode) -> None:
    assert view(state(mode, "drive_enabled")).entry == KEEP_OUT
    assert view(state(mode, quality={"drive": "stale"})).entry == KEEP_OUT
    assert view({"mode": None, "loop_alive": False}).entry == KEEP_OUT


def test_a_drive_that_is_off_leaves_the_load_on_the_brake_to_be_looked_at() -> None:
    found = view(state(Mode.DISARMED), lock_out="main switch Q1")
    assert found.entry == LOCK_OUT_FIRST
    assert found.entry_why == "main switch Q1: rope and brake carry 298.7 N"
    assert "safety.lock_out" in view(state(Mode.DISARMED)).entry_why


@pytest.mark.parametrize("shown", ["AWAITED", "UNCONFIRMED"])
def test_nobody_walks_in_before_a_power_off_is_confirmed(shown: str) -> None:
    found = view(state(Mode.FAULT, held_by="BRAKE", fault="CELL_STALE", causes=[STALE], power_off=shown))
    assert found.entry == KEEP_OUT
    assert ("emergency stop" in found.next_step) is (shown == "UNCONFIRMED")
    assert ("UNCONFIRMED" in found.does) is (shown == "UNCONFIRMED")


def test_a_confirmed_power_off_says_by_what() -> None:
    found = view(state(Mode.FAULT, held_by="BRAKE", fault="CELL_STALE", causes=[STALE], power_off="TENSION"))
    assert found.entry == LOCK_OUT_FIRST
    on, *_, empty, reset, _anew = found.steps
    assert on.text == "Before walking in, lock out the drive."
    assert empty.text == "See that the hall is empty; take the lock-out off."  # who went in comes out again
    assert reset.verb == "reset"
    assert "a tension at rest" in found.does


def test_a_cause_that_blocks_a_reset_is_named_with_value_limit_and_remedy() -> None:
    found = view(state(Mode.FAULT, "drive_enabled", held_by="MOTOR", fault="CELL_STALE", causes=[STALE]))
    (cause,) = found.causes
    assert (cause.value, cause.limit, cause.since_ns) == ("12 ms", "5 ms", 3)
    assert found.blocks == "CELL_STALE"
    assert found.text.endswith(" at the trip"), "beside a device that is 8 s old it read as an age of now"
    assert [step.text for step in found.steps] == [
        "Keep out of the hall.", Fault.CELL_STALE.remedy,
        "RESET, once CELL_STALE is gone.",
        "Else start the daemon anew.",
    ]  # fmt: skip
    assert found.does == "stroke to be held: held by the motor"


@pytest.mark.parametrize(
    ("more", "gone"),
    [
        (1, "CELL_STALE and 1 other cause are gone"),
        (2, "CELL_STALE and 2 other causes are gone"),
    ],
)
def test_several_causes_that_block_a_reset_are_counted(more: int, gone: str) -> None:
    others = [{**STALE, "fault": name} for name in ("INCLINATION_STALE", "DRIVE_STALE")]
    causes = [STALE, *others[:more]]
    found = view(state(Mode.FAULT, "drive_enabled", held_by="MOTOR", fault="CELL_STALE", causes=causes))
    assert f"RESET, once {gone}." in [step.text for step in found.steps]


def test_where_nothing_is_heard_of_the_drive_there_is_a_way_to_the_devices() -> None:
    """BUS_SILENT sent people to the devices while they had to keep out, without a lock-out to come in by."""
    unheard = {"tension": "good", "inclination": "good", "drive": "stale"}
    found = view(state(Mode.FAULT, fault="BUS_SILENT", causes=[STALE], quality=unheard), lock_out="switch Q1")
    steps = [step.text for step in found.steps]
    assert found.entry == KEEP_OUT
    assert steps[0] == "Keep out. To go in: emergency stop, lock out switch Q1."


def test_a_reset_beside_an_active_cause_says_so_and_waits_for_nothing() -> None:
    """STROKE_END goes by the motion after a reset alone: to wait for its end would be a circle."""
    active = {**STALE, "fault": "DRIVE_FAULT", "blocks_reset": False}
    found = view(state(Mode.FAULT, held_by="BRAKE", fault="DRIVE_FAULT", causes=[active]))
    assert found.steps[-1].text == "RESET; the fault may trip again."


def test_a_latched_fault_whose_cause_is_gone_may_be_reset() -> None:
    rows = Alarms([trip(3.0), over(4.0)]).rows(None, 5)
    found = view(state(Mode.FAULT, fault="CELL_STALE", fault_text="words"), rows)
    (cause,) = found.causes
    assert not cause.stands
    assert (cause.value, cause.since_ns) == ("12 ms", 3_000_000_000)
    assert found.blocks == "nothing: RESET is accepted"
    assert found.steps[-1].text == "RESET."


def test_a_latched_limit_has_value_and_limit_of_its_own_row() -> None:
    """Every limit of the rig file is the fault LIMIT; the page showed the words of one with the numbers of another."""
    names = ("tension_rate_n_s above", "stroke_mm above")
    rows = Alarms([
        event(Kind.TRIP, 1.0, Fault.LIMIT, Action.HOLD, 38400.0, 10000.0, names[0]),
        event(Kind.LIMIT, 2.0, Fault.LIMIT, Action.LOG, 51.0, 50.0, names[1]),
    ]).rows(None, 5)  # fmt: skip
    told = state(Mode.FAULT, fault="LIMIT", fault_text="tension_rate_n_s above 10000 N/s (38400 N/s)")
    (cause,) = view(told, rows).causes
    assert (cause.value.split()[0], cause.limit.split()[0], cause.since_ns) == ("38400", "10000", 1_000_000_000)
    (cause,) = view(told | {"fault_text": "stroke_mm above 50 mm (51 mm)"}, rows).causes
    assert (cause.value, cause.limit) == ("51 mm", "50 mm")


def test_a_stop_that_still_runs_blocks_a_reset() -> None:
    found = view(state(Mode.FAULT, "drive_enabled", "stopping", fault="E_STOP", fault_text=""))
    assert "still stopping" in found.blocks
    assert found.does == "stops the drive, then takes it off power"


@pytest.mark.parametrize(("left_s", "shown"), [(7.2, "in 7 s the motor lowers"), (0.0, "the motor lowers")])
def test_an_end_that_a_load_delays_is_what_the_rig_does(left_s: float, shown: str) -> None:
    carried = state(Mode.FAULT, "drive_enabled", "brake_fails", "carries", held_by="MOTOR", fault="BRAKE_SLIPS",
                    fault_text="words", end_s=left_s)  # fmt: skip
    found = view(carried)
    assert found.does.startswith("stroke to be held: held by the motor; THE DAEMON IS TO END: " + shown)
    assert "2 Support the payload from below" in found.next_step
    assert [step.verb for step in found.steps] == ["", "", "lower"]
    assert "DAEMON" not in view(carried | {"end_s": None}).does


@pytest.mark.parametrize(("held_by", "arms"), [("BRAKE", True), ("TAKING", True), ("CLOSING", False)])
def test_a_disarm_under_way_is_no_arming(held_by: str, arms: bool) -> None:
    found = view(state(Mode.DISARMED, "arming", held_by=held_by)).does
    assert found.startswith("checks before arming" if arms else "the drive is")


def test_what_bars_arming_is_the_next_step_while_disarmed() -> None:
    failing = {"E_STOP": Check.E_STOP.words}
    found = view(state(Mode.DISARMED, preflight={"failing": failing}))
    assert [step.verb for step in found.steps] == ["", "", "arm"]
    assert "mergency stop is pressed" in found.steps[1].text
    assert "mergency" not in view(state(Mode.HOLD, preflight={"failing": failing})).next_step


def test_a_load_that_the_motor_carries_can_be_lowered_whatever_fault_is_latched() -> None:
    made = state(Mode.FAULT, "drive_enabled", held_by="MOTOR", fault="DRIVE_CONTRADICTS")
    found = view(made | {"offers": offered(made, carried_s=59.0)})
    assert [step.verb for step in found.steps if step.verb] == ["lower", "reset"]


def test_where_every_device_is_silent_the_bus_is_looked_at_whatever_was_found_at_the_trip() -> None:
    culprit = {"parts": ["tension cell's amplifier"], "first": "check the amplifier", "text": "", "follows": []}
    silent = dict.fromkeys(("drive", "tension", "inclination"), "stale")
    latched = {"fault": "CELL_STALE", "causes": [STALE], "culprit": culprit}
    assert Part.BUS in {
        place for step in view(state(Mode.FAULT, **latched, quality=silent)).steps for place in step.places
    }
    one = view(state(Mode.FAULT, **latched, quality=silent | {"drive": "good"}))
    assert Part.BUS not in {place for step in one.steps for place in step.places}


def test_a_cause_that_came_after_the_latched_one_was_over_has_a_step_of_its_own() -> None:
    culprit = {"parts": ["inclinometer"], "first": "check the inclinometer", "text": "", "follows": []}
    found = view(state(Mode.FAULT, fault="INCLINATION_STALE", causes=[STALE], culprit=culprit))
    (mends,) = (step for step in found.steps if step.text == Fault.CELL_STALE.remedy)
    assert Part.AMPLIFIER in mends.places
    beside = view(state(Mode.FAULT, fault="CELL_STALE", causes=[STALE], culprit=culprit))
    assert not any(step.text == Fault.CELL_STALE.remedy for step in beside.steps)


def test_a_motor_that_did_not_follow_leaves_the_load_to_be_supported_from_below() -> None:
    made = state(Mode.FAULT, held_by="BRAKE", fault="LOAD_SINKS")
    found = view(made | {"offers": offered(made, strays=True, apart_mm=0.6)})
    assert found.steps[0].text.startswith("Support the payload from below")
    assert "lower" not in {step.verb for step in found.steps}


def test_the_rows_of_status_and_watch_hold_every_answer() -> None:
    told = state(Mode.FAULT, fault="CELL_STALE", causes=[STALE])
    labels = [label for label, _, _ in banner_rows(told, view(told))]
    assert labels == ["does now", "blocks reset", "next step", "entry"]


@pytest.mark.parametrize(
    ("power", "name", "shown"),
    [
        ("OFF", "SWITCH_ON_DISABLED", "off"), ("OFF", "FAULT", "off"), ("NOT_OFF", "SWITCHED_ON", "not off"),
        ("STOPPING", "QUICK_STOP_ACTIVE", "stopping"), ("STOPPING", "READY_TO_SWITCH_ON", "stopping"),
    ],
)  # fmt: skip
def test_the_drive_is_shown_with_the_state_that_it_reports(power: str, name: str, shown: str) -> None:
    found = state(Mode.DISARMED, held_by="CLOSING", drive_power=power, drive_state=name)
    assert state_words.drive(found) == shown
    assert state_words.drive_with_state(found) == f"{shown} ({name.replace('_', ' ')})"
    silent = found | {"quality": found["quality"] | {"drive": "stale"}}
    assert state_words.drive_with_state(silent) == "not known"


def test_every_step_is_a_command_of_the_loop_or_hands_at_a_place() -> None:
    """So that a step can be taken by whoever gets the values alone, as `hil.ways_out` does."""
    shown = list(catalogue())
    assert shown
    for one in shown:
        for step in view(one.state).steps:
            assert step.verb.replace("-", "_").upper() in {"", *Verb.__members__}
            assert step.text
            assert all(step.places)
