"""The fault card agrees with the page on who may enter."""

from __future__ import annotations

import pytest

from rigctl.model.faults import Fault
from rigctl.model.states import Mode
from rigctl.wire.fault_card import SITUATIONS, document
from rigctl.wire.operator_view import view
from tests.builders.page_states import LOCK_OUT, state

CAUSES = [(row.entry, cause) for row in SITUATIONS for cause in row.causes]


@pytest.mark.parametrize(("entry", "cause"), CAUSES, ids=lambda value: getattr(value, "name", value))
def test_the_card_has_the_entry_of_the_page(entry: str, cause: Fault) -> None:
    assert view(state(Mode.FAULT, fault=cause), lock_out=LOCK_OUT).entry == entry


def test_a_cause_is_on_one_row() -> None:
    causes = [cause for _, cause in CAUSES]
    assert len(set(causes)) == len(causes)


def test_every_row_names_a_part() -> None:
    assert "*None*" not in document()
