"""The numbers of docs/load.md are those of the code."""

from __future__ import annotations

import re

import pytest

from rigctl.control.commands.command_checks import RECHECK_NS
from rigctl.control.law.tension import PAYS_OUT_MM_S
from rigctl.control.load import load_at_rest
from rigctl.control.load.brake_flag import FALLS, FALLS_NS, MOVED_MM, TESTED_SHARE
from rigctl.control.load.carried_load import FOLLOWS_MM, FOLLOWS_NS, LOWERS_MM_S, SPARE_MM
from rigctl.control.load.stroke_hold import AUTHORITY_MM_S, CREEP_MM_S, SHOWN_MM
from rigctl.control.power.arming import AWAIT_NS, BRAKE_TEST_MM, BRAKE_TEST_NS, LONG_TEST_NS
from rigctl.control.power.ending import LIMIT_S, WAITS_NS
from rigctl.control.power.parking import REST_NS, UNDO_MM
from rigctl.control.power.power_seen import UNDO_NS
from rigctl.control.power.stage import ARM_LIMIT_NS, KEPT_NS
from rigctl.control.watch.safety import BRAKE_SLIP_MM_S, CORRECTED_MM, NOT_HELD_MM, SINK_MM_S
from rigctl.model.faults import Trait, having
from rigctl.model.verbs import CARRY_S
from tests.builders.paths import ROOT

PAGE = " ".join((ROOT / "docs/load.md").read_text().split())
MINUTE_NS = 60_000_000_000
SAID = (
    f"at rest for {load_at_rest.REST_NS * 1e-9:g} s, by the tension",
    f"within {load_at_rest.REST_MM:g} mm of stretch",
    f"at no more than {AUTHORITY_MM_S:g} mm/s",
    f"needing more than {CREEP_MM_S:g} mm/s",
    f"a stroke more than {SHOWN_MM:g} mm from the latch",
    f"Beyond {NOT_HELD_MM:g} mm the drive is taken off power",
    f"beyond {CORRECTED_MM:g} mm the brake takes the load",
    f"not at rest {REST_NS * 1e-9:g} s after a stop should have ended",
    f"in HOLD and in FAULT, for {KEPT_NS // MINUTE_NS} min",
    f"in HOLD, at {PAYS_OUT_MM_S:g} mm/s",
    f"each time, within {AWAIT_NS * 1e-9:g} s |",
    f"| drive enabled within {ARM_LIMIT_NS * 1e-9:g} s |",
    f"| yes | after {RECHECK_NS // MINUTE_NS} min on the brake",
    f"| brake test (SBT), {BRAKE_TEST_NS * 1e-9:g} s;",
    f"within {UNDO_NS * 1e-9:g} s, stroke and tension",
    f"has sunk by {UNDO_MM:g} mm",
    f"as by `carry`, for {KEPT_NS // MINUTE_NS} min",
    f"faster than {SINK_MM_S:g} mm/s over 5 s or {BRAKE_SLIP_MM_S:g} mm/s at once",
    f"a net motion of {MOVED_MM:g} mm",
    f"lost {FALLS:g} times the limit of LOAD_SINKS for {FALLS_NS * 1e-9:g} s",
    f"with at least {TESTED_SHARE:.0%} of the load",
    f"tests the brake for {LONG_TEST_NS * 1e-9:g} s",
    f"of a brake known not to hold {LONG_TEST_NS * 1e-9:g} s",
    f"the load for the same {LONG_TEST_NS * 1e-9:g} s",
    f"moves by {BRAKE_TEST_MM:g} mm in either",
    f"holds it for {CARRY_S[0]:g} to {CARRY_S[1]:g} s",
    f"the motor carries for {KEPT_NS // MINUTE_NS} min",
    f"the encoder alone lowers at {LOWERS_MM_S:g} mm/s",
    f"and {SPARE_MM:g} mm more",
    f"for {FOLLOWS_NS * 1e-9:g} s more than {FOLLOWS_MM:g} mm from the commanded stroke",
    f"goes on for {WAITS_NS * 1e-9:g} s after the request",
    f"after {LIMIT_S:g} s in any case",
)


@pytest.mark.parametrize("said", SAID)
def test_the_page_says_the_number_of_the_code(said: str) -> None:
    assert said in PAGE


def test_no_number_of_the_page_is_left_unchecked() -> None:
    """But for 1 mm, in which each of the limits of a held stroke ends."""
    rest = PAGE
    for said in SAID:
        rest = rest.replace(said, "")
    assert re.findall(r"\d[\d.]* (?:mm|s|min|%|N)\b", rest) == ["1 mm"]


def test_the_page_lists_what_stops_a_motor_that_carries() -> None:
    listed = re.findall(r"^- ([A-Z_]+)$", (ROOT / "docs/load.md").read_text(), re.MULTILINE)
    assert listed == [fault.name for fault in sorted(having(Trait.STOPS_CARRYING))]
