"""Refusals in words: what stands against the command, and what to do first."""

from __future__ import annotations

import pytest

from rigctl.model.faults import Fault, Trait, bits_of
from rigctl.model.refusal_words import refusal_text
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

LIMITS = (50.0, 350.0)


def said(refusal: Refusal, verb: Verb = Verb.RESET, mode: Mode = Mode.FAULT, checks: int = 0, **more: object) -> str:
    return refusal_text(refusal, verb, mode, checks, Fault.CELL_STALE, LIMITS, **more)  # type: ignore[arg-type]


def test_every_cause_that_stands_is_named_the_strongest_first_with_its_figures_where_known() -> None:
    standing = {Fault.TENSION_HIGH: "401.0 N, limit 400 N", Fault.E_STOP: "the emergency stop is pressed"}
    bits = bits_of({Fault.E_STOP, Fault.TENSION_HIGH, Fault.CELL_INVALID})
    assert said(Refusal.CAUSE_PRESENT, checks=bits, standing=standing) == (
        "cause still present: TENSION_HIGH (401.0 N, limit 400 N), E_STOP (the emergency stop is pressed), CELL_INVALID"
    )
    assert said(Refusal.CAUSE_PRESENT).startswith("cause still present: CELL_STALE (a device that was switched off")


@pytest.mark.parametrize(
    ("mode", "verb", "hint"),
    [
        (Mode.FAULT, Verb.TENSION, ": reset first"), (Mode.DISARMED, Verb.TENSION, ": arm first"),
        (Mode.COMPENSATING, Verb.DISARM, ": hold first"), (Mode.HOLD, Verb.CONFIRM_STROKE, ": disarm first"),
        *((mode, Verb.RESET, ": there is no fault") for mode in Mode if mode is not Mode.FAULT),
    ],
)  # fmt: skip
def test_a_command_in_the_wrong_mode_is_told_what_comes_first(mode: Mode, verb: Verb, hint: str) -> None:
    assert said(Refusal.WRONG_MODE, verb, mode) == f"{verb.name.lower()} is not possible in {mode.name}{hint}"


@pytest.mark.parametrize(
    "fault", [Fault.BUS_SILENT, Fault.CELL_STALE, Fault.INCLINATION_STALE, Fault.DRIVE_STALE, Fault.STATUS_STALE]
)
def test_a_device_that_says_nothing_may_have_been_switched_off(fault: Fault) -> None:
    assert said(Refusal.CAUSE_PRESENT, checks=fault.bit).endswith("needs the daemon started anew)")
    assert Trait.AGE in fault.traits  # told in ms
