"""The part that every fault of the catalogue states, and the judgement of what a diagnosis named for it."""

from __future__ import annotations

import pytest

from hil.faults import processes
from hil.faults.catalogue import ROWS
from hil.faults.drawn.kinds import KINDS
from hil.faults.fault_tables import confusion_lines
from hil.faults.judging.naming import NamedRow, Naming, good, naming, shares
from rigctl.diagnosis.diagnose import Culprit
from rigctl.model.parts import Part


def culprit(*parts: Part, question: str = "") -> Culprit:
    return Culprit(parts, "", question, "", ())


def row(found: Naming, *named: Part) -> NamedRow:
    return NamedRow("a", "HOLD", (Part.ROPE,), named, found, "")


def test_every_fault_of_the_catalogue_and_every_drawn_kind_states_its_part() -> None:
    assert [fault.id for fault in ROWS.values() if not fault.part] == []
    assert [fault.id for fault in processes.CATALOGUE if not fault.part] == []
    assert [kind.name for kind in KINDS if not kind.states] == []
    assert ROWS["cell_silent_parked"].part == ROWS["cell_silent"].part == (Part.AMPLIFIER,)


@pytest.mark.parametrize(
    ("found", "states", "judged"),
    [
        (culprit(Part.ROPE), (Part.ROPE,), Naming.RIGHT),
        (culprit(Part.CELL), (Part.AMPLIFIER, Part.CELL), Naming.RIGHT),
        (culprit(Part.CELL, Part.ROPE, question="?"), (Part.ROPE,), Naming.TWO),
        (culprit(Part.CELL, Part.ROPE), (Part.ROPE,), Naming.SENDS),
        (culprit(Part.CELL), (Part.ROPE,), Naming.SENDS),
        (culprit(Part.AMPLIFIER), (Part.BRAKE,), Naming.SENDS),
        (culprit(Part.ROPE), (Part.CELL,), Naming.WRONG),
        (culprit(Part.BUS), (Part.ROPE,), Naming.WRONG),
        (culprit(), (Part.ROPE,), Naming.UNNAMED),
    ],
)
def test_a_culprit_is_judged_by_the_parts_stated(found: Culprit, states: tuple[Part, ...], judged: Naming) -> None:
    assert naming(found, states) is judged


def test_the_shares_are_good_only_with_nine_tenths_named_few_in_doubt_and_nobody_sent_to_a_loose_load() -> None:
    assert good([row(Naming.RIGHT)] * 70 + [row(Naming.TWO)] * 20 + [row(Naming.WRONG)] * 10)
    assert not good([row(Naming.RIGHT)] * 69 + [row(Naming.TWO)] * 20 + [row(Naming.WRONG)] * 11)
    assert not good([row(Naming.RIGHT)] * 79 + [row(Naming.TWO)] * 21)
    assert not good([row(Naming.RIGHT)] * 99 + [row(Naming.SENDS)])
    assert shares([row(Naming.TWO)])[Naming.TWO] == 1


def test_the_confusion_matrix_has_what_was_named_by_the_part_stated() -> None:
    lines = confusion_lines([row(Naming.RIGHT, Part.ROPE)] * 2 + [row(Naming.TWO, Part.ROPE, Part.PAYLOAD)])
    assert lines[2:] == ["| rope or spring | 3 | rope or spring 2, rope or spring or payload 1 |"]
