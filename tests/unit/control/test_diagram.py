"""The page about the modes is made from the tables."""

from __future__ import annotations

from rigctl.control import diagram, load_picture
from rigctl.control.modes import TRANSITIONS
from rigctl.control.power.stage import ROWS, STAGES
from tests.builders.paths import ROOT

PAGE = ROOT / "docs/modes.md"


def test_the_page_is_what_the_tables_give() -> None:
    assert PAGE.read_text() == diagram.document(), "run `python -m rigctl.control.diagram > docs/modes.md`"


def test_the_picture_of_who_holds_the_load_is_what_the_table_gives() -> None:
    picture = (ROOT / "docs/pictures/load.svg").read_text()
    assert picture == load_picture.document(), "run `python -m rigctl.control.load_picture > docs/pictures/load.svg`"


def test_every_transition_between_two_modes_is_an_arrow() -> None:
    picture = diagram.document().partition("## Guards")[0]
    arrows = [line for line in picture.splitlines() if " --> " in line]
    between = [pair for pair, transition in TRANSITIONS.items() if transition.after is not pair[0]]
    assert len(arrows) == len(between) + 1


def test_every_stage_of_the_drive_is_in_the_picture_with_all_that_leads_to_it() -> None:
    picture = diagram.document().partition("## Drive, brake and load")[2].partition("| stage |")[0]
    arrows = {tuple(line.strip().split(":")[0].split(" --> ")) for line in picture.splitlines() if " --> " in line}
    assert arrows == {
        ("[*]", "STOP"),
        ("SILENT", "[*]"),
        *((before.name, after.name) for (before, _), after in STAGES.items()),
    }


def test_every_row_that_ends_a_wait_is_in_the_table() -> None:
    assert all(f"| {row.stage.name} | {row.words} |" in diagram.document() for row in ROWS)
