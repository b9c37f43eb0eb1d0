"""The table of played faults where output is no terminal."""

from __future__ import annotations

import pytest

from hil.faults.catalogue import CATALOGUE
from hil.faults.fault_tables import show
from hil.faults.judging.judge import FaultResult
from rigctl.model.faults import Fault


def test_every_name_is_in_one_piece(capsys: pytest.CaptureFixture[str]) -> None:
    longest = max((fault.name for fault in Fault), key=len)
    finding = "the load moved at 0.36 mm/s until the death of the loop stopped it"
    rows = [
        FaultResult(fault.id, "COMPENSATING", "held or ridden through", "ridden through", 3233.0, 1.0, 144.0,
                    236.0, 64.8, 0.03, True, longest, (finding,))
        for fault in CATALOGUE
    ]  # fmt: skip
    show(rows)
    words = set(capsys.readouterr().out.split())
    assert {longest, "COMPENSATING", *(fault.id for fault in CATALOGUE)} <= words
