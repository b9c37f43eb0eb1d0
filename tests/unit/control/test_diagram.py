"""The page about the modes is made from the tables."""

from __future__ import annotations

from rigctl.control import diagram
from rigctl.control.modes import TRANSITIONS
from tests.builders.paths import ROOT

PAGE = ROOT / "docs/modes.md"


def test_the_page_is_what_the_tables_give() -> None:
    assert PAGE.read_text() == diagram.document(), "run `python -m rigctl.control.diagram > docs/modes.md`"


def test_every_transition_between_two_modes_is_an_arrow() -> None:
    arrows = [line for line in diagram.document().splitlines() if " --> " in line]
    between = [pair for pair, transition in TRANSITIONS.items() if transition.after is not pair[0]]
    assert len(arrows) == len(between) + 1
