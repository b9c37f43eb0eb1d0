"""No two statements about one state contradict each other: page, status and watch, over modes, faults and losses."""

from __future__ import annotations

import re

import pytest

from rigctl.control.commands.situation import Situation
from rigctl.control.modes import decide
from rigctl.model.faults import Fault
from rigctl.model.states import HeldBy, Mode
from rigctl.model.verbs import Refusal, Verb
from rigctl.page.panel import state_message
from rigctl.wire.offers import BUTTONS
from rigctl.wire.operator_view import KEEP_OUT, LOCK_OUT_FIRST
from tests.builders.exclusions import contradictions, said_by_page, said_by_status, said_by_watch
from tests.builders.page_states import LOCK_OUT, Shown, catalogue, picture_of, state

STATES = list(catalogue())
NAMED = {"", "hold", *(verb.name.lower() for verb in BUTTONS)}


def test_the_catalogue_has_every_mode_and_fault() -> None:
    assert len(STATES) > 800
    assert {shown.state["mode"] for shown in STATES} >= {mode.name for mode in Mode}


def test_no_two_statements_contradict() -> None:
    found = []
    for shown in STATES:
        picture = picture_of(shown)
        said = {"page": said_by_page(picture)}
        if shown.state["mode"] is not None:
            said |= {"status": said_by_status(picture, LOCK_OUT), "watch": said_by_watch(picture)}
        found += [f"{shown.name}, {where}: {each}" for where, lines in said.items() for each in contradictions(lines)]
    assert found == [], f"{len(found)} contradictions, the first: {found[:5]}"


def test_the_table_sees_a_contradiction() -> None:
    """Pairs that were on one picture once."""
    for pair in (
        ["entry KEEP OUT: nothing valid is heard of the drive", "load held by the motor"],
        ["mode FAULT", "tally none"],
        ["alarm high active BUS_SILENT", "bus 0 error frames"],
        ["doubt tension: stale", "vertical 300.04 N"],
        ["blocks nothing: RESET is accepted", "alarm high active LIMIT"],
    ):
        assert contradictions(pair)


def test_every_step_can_be_done() -> None:
    """The first is safe; each is a thing in the hall, or names a button that is there; none asks for what is barred."""
    for shown in STATES:
        message = state_message(picture_of(shown), holds_lease=True)
        steps, mode = message["answers"]["steps"], shown.state["mode"]
        assert steps, shown.name
        assert steps[0]["verb"] == "", shown.name
        assert steps[0]["text"].startswith(("Keep", "See", "Before walking in", "Press the emergency stop")), shown.name
        for step in steps:
            assert step["verb"] in NAMED, shown.name
            refused = message.get("verbs", {}).get(step["verb"], "")
            assert not refused or "once" in step["text"], (shown.name, step, refused)
            for name in re.findall(r"rigctl ([a-z-]+)", step["text"]):
                verb = Verb.__members__.get(name.replace("-", "_").upper())
                if verb is not None and mode is not None:
                    assert decide(Mode[mode], verb, Situation(carry_s=1.0)).refusal is not Refusal.WRONG_MODE, step


@pytest.mark.parametrize("by", [HeldBy.BRAKE, HeldBy.MOTOR])
def test_entry_names_the_lock_out_of_the_rig_file(by: HeldBy) -> None:
    told = state_message(picture_of(Shown("held", state(Mode.HOLD, held_by=by))), holds_lease=True)["answers"]
    assert told["entry"] == (LOCK_OUT_FIRST if by is HeldBy.BRAKE else KEEP_OUT)
    assert (LOCK_OUT in told["entry_why"]) is (by is HeldBy.BRAKE)


def test_two_candidates_come_first_with_the_question() -> None:
    (shown,) = (shown for shown in STATES if shown.name == "two candidates")
    told = state_message(picture_of(shown), holds_lease=True)["answers"]
    assert told["parts"] == ["rope or spring", "tension cell"]
    assert [step["text"] for step in told["steps"]][1:3] == [  # after the lock-out
        "Keep out from under the load.",
        "Does the rope hang loose?",
    ]


def test_one_count_of_what_follows() -> None:
    (shown,) = (shown for shown in STATES if shown.name == "BUS_SILENT active, BRAKE, without []")
    message = state_message(picture_of(shown), holds_lease=True)
    assert len(message["answers"]["follows"]) == 8
    assert message["tally"].startswith("9 active")


def test_the_page_marks_in_its_table_what_it_counts_beside_the_culprit() -> None:
    """A row that is on its own is neither; every display folds the same rows, in one order."""
    (shown,) = (shown for shown in STATES if shown.name == "BUS_SILENT active, BRAKE, without []")
    culprit = {"parts": ["bus"], "text": "", "question": "", "first": "", "follows": ["BUS_SILENT", "DRIVE_STALE"]}
    message = state_message(picture_of(Shown("", shown.state | {"culprit": culprit}, shown.events)), holds_lease=True)
    marked = [row["cause"] for row in message["alarms"] if row["follows"]]
    assert marked == ["BUS_SILENT", *message["answers"]["follows"]] == ["BUS_SILENT", "DRIVE_STALE"]
    assert [row["cause"] for row in message["alarms"]][:2] == marked


def test_the_verbs_without_a_button_are_not_listed_as_impossible() -> None:
    """CARRY and LOWER have one in FAULT alone."""
    held, fault = (
        " ".join(state_message(picture_of(Shown("", shown)), holds_lease=True)["not_now"])
        for shown in (state(Mode.HOLD), state(Mode.FAULT, fault=Fault.CELL_STUCK))
    )
    assert "ARM" in held
    assert "CARRY" not in held
    assert "LOWER" not in held
    assert "ARM" in fault
