"""The emergency stop in ``rigctl status``: which input is pressed or not seen, and no more than the records show."""

from __future__ import annotations

from typing import Any

import pytest

from rigctl.model.checks import Check
from rigctl.wire import state_words as figures


def state(mode: str | None, checks: Check) -> dict[str, Any]:
    failing = {check.name: check.words for check in Check if checks & check}
    return {"mode": mode, "preflight": {"failing": failing, "waived": {}}}


@pytest.mark.parametrize(
    ("check", "words"),
    [
        (Check.E_STOP, "pressed (drive's input)"),
        (Check.E_STOP_IO, "pressed (I/O node's input)"),
        (Check.E_STOP_UNSEEN, "not seen: check the drive's second TPDO"),
        (Check.E_STOP_IO_UNSEEN, "on the I/O node is not seen"),
    ],
)
@pytest.mark.parametrize("mode", ["DISARMED", "FAULT"])
def test_each_input_that_is_pressed_or_not_seen_has_a_line(mode: str, check: Check, words: str) -> None:
    (line,) = figures.e_stop(state(mode, check | Check.DISK))
    assert words in line


def test_both_inputs_of_one_button_are_two_lines_and_nothing_wrong_is_none() -> None:
    assert len(figures.e_stop(state("FAULT", Check.E_STOP | Check.E_STOP_IO))) == 2
    assert figures.e_stop(state("FAULT", Check.DISK)) == []


@pytest.mark.parametrize("mode", ["HOLD", "COMPENSATING", None])
def test_what_was_looked_at_before_arming_is_not_told_as_if_it_were_so_now(mode: str | None) -> None:
    assert figures.e_stop(state(mode, Check.E_STOP_IO)) == []
    assert figures.e_stop({"mode": mode}) == []
