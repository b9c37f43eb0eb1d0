"""The culprit in the state message, and first in what status, watch and alarms show."""

from __future__ import annotations

from typing import Any

from rigctl.diagnosis.diagnose import Culprit
from rigctl.model.event_row import Priority
from rigctl.model.faults import Fault
from rigctl.model.parts import Part
from rigctl.wire.alarm_words import alarm_rows, culprit_rows, listed
from rigctl.wire.alarms import Alarm
from rigctl.wire.operator_view import view
from rigctl.wire.state_message import culprit_of
from tests.builders.offered import offered

FOUND = Culprit((Part.ROPE, Part.CELL), "The tension fell.", "does the rope hang loose?", "Keep out.", ("CELL_STUCK",))
ALIVE = {"loop_alive": True, "mode": "FAULT"}
STUCK, STOP = (Alarm(name, Priority.HIGH, f"{name} text", "remedy", 0, 0) for name in ("CELL_STUCK", "E_STOP"))


def state() -> dict[str, Any]:
    return {"culprit": culprit_of(FOUND, [{"fault": "TENSION_LOW"}], ALIVE)}


def test_the_message_has_the_parts_in_words_and_what_stands_follows_too() -> None:
    assert culprit_of(FOUND, [{"fault": "TENSION_LOW"}], ALIVE) == {
        "parts": ["rope or spring", "tension cell"],
        "text": "The tension fell.",
        "question": "does the rope hang loose?",
        "first": "Keep out.",
        "follows": ["CELL_STUCK", "TENSION_LOW"],
    }


def test_a_loop_that_is_silent_is_a_process_and_one_that_never_was_is_nothing() -> None:
    silent = culprit_of(FOUND, [], {"loop_alive": False, "mode": "HOLD"})
    assert silent is not None
    assert silent["parts"] == ["a process of this program"]
    assert silent["follows"] == ["LOOP_SILENT"]
    assert culprit_of(None, [], {"loop_alive": False, "mode": None}) is None


def test_where_no_part_is_named_there_is_no_culprit() -> None:
    assert culprit_of(None, [], ALIVE) is None
    assert culprit_of(Culprit((), "text", "", "", ()), [], ALIVE) is None
    assert culprit_rows({"culprit": None}) == culprit_rows({}) == []


def test_the_culprit_comes_first_with_its_question_and_what_to_do() -> None:
    rows = [(label, words) for label, words, _ in culprit_rows(state())]
    assert rows == [
        ("culprit", "rope or spring or tension cell: The tension fell."),
        ("decide", "does the rope hang loose?"),
        ("first", "Keep out."),
    ]


def test_alarms_that_follow_are_listed_under_it_without_their_remedies() -> None:
    lines = listed([STUCK, STOP], state(), 0)
    assert lines[0].startswith("CULPRIT rope or spring")
    (following,) = [line for line in lines if "CELL_STUCK" in line]
    assert following.startswith("        follows: ")
    assert lines.index(following) < next(i for i, line in enumerate(lines) if "E_STOP" in line)
    assert [line for line in lines if "remedy" in line] == ["        -> remedy"]
    assert [label for label, *_ in alarm_rows([STUCK, STOP], 0, state())] == ["follows", "alarm"]
    assert [label for label, *_ in alarm_rows([STOP, STUCK], 0)] == ["alarm", "alarm"]


def test_the_next_step_is_the_culprits_and_not_the_symptoms_remedy() -> None:
    shown = state() | ALIVE | {"fault": "CELL_STUCK", "fault_text": "", "causes": [], "flag_names": [], "quality": {}}
    shown["offers"] = offered(shown)
    way_back = "4 See that the hall is empty; take the lock-out off.  5 RESET."
    assert (
        view(shown).next_step
        == f"1 Before walking in, lock out the drive.  2 Keep out.  3 Does the rope hang loose?  {way_back}"
    )
    assert Fault.CELL_STUCK.remedy.rstrip(".") in view(shown | {"culprit": None}).next_step
