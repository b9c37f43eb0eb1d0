"""Figures in messages: no exponent, no negative zero, a unit behind each."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.model.events import Kind, worded
from rigctl.model.fault_words import fault_text
from rigctl.model.faults import Fault
from rigctl.model.quantity import Number, count, number, significant
from rigctl.model.reactions import Action, Symptom
from rigctl.model.signals import WATCHED
from rigctl.model.states import Mode
from rigctl.wire import state_words as figures

VALUES = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([-0.0, -1e-9, 37090.0, 1e17, 3.4e38, -0.004])
EXPONENT = re.compile(r"\d[eE][+-]?\d")
OTHERS = (Kind.STROKE_LEFT, Kind.ESCALATION)  # whose numbers are members of other enumerations
NEGATIVE_ZERO = re.compile(r"-0(\.0+)?(?![.\d])")


HEXADECIMAL = re.compile(r"\b0x[0-9A-F]+\b")  # a code, not a figure: 0x7E00


def reads_well(text: str) -> bool:
    figures_only = HEXADECIMAL.sub("", text)
    return not EXPONENT.search(figures_only) and not NEGATIVE_ZERO.search(figures_only)


@given(VALUES, st.integers(0, 6), st.integers(1, 12), st.sampled_from(["", "+", "8", "+8", ">8"]))
def test_no_exponent_and_no_negative_zero(value: float, decimals: int, digits: int, width: str) -> None:
    assert reads_well(f"{Number(value):.{digits}g}")
    if width != ">8":
        assert reads_well(f"{Number(value):{width}.{decimals}f}")
    assert reads_well(number(value, decimals, "N"))
    assert reads_well(figures.number(value, decimals, "N", sign=True))
    assert reads_well(significant(value, "N"))


@given(VALUES)
def test_a_figure_is_the_value(value: float) -> None:
    if math.isfinite(value):
        assert float(significant(value, digits=17)) == value
        assert float(f"{Number(value):.4g}") == float(f"{value:.4g}")


@pytest.mark.parametrize("fault", Fault)
@given(value=VALUES, limit=VALUES)
def test_every_fault_in_words(fault: Fault, value: float, limit: float) -> None:
    assert reads_well(fault_text(fault, value, limit, "tension_n above"))


@pytest.mark.parametrize(
    ("kind", "a", "b"),
    [
        *((kind, Fault.LIMIT, Action.LOG) for kind in Kind if kind not in (Kind.MODE, Kind.TRIP, Kind.RESET, *OTHERS)),
        *((Kind.STROKE_LEFT, mode, 0) for mode in Mode),
        *((Kind.ESCALATION, Fault.LIMIT, symptom) for symptom in Symptom),
    ],
)
@given(value=VALUES, limit=VALUES)
def test_every_event_in_words(kind: Kind, a: int, b: int, value: float, limit: float) -> None:
    assert reads_well(worded(kind, a, b, value, limit, "stroke_mm above").text)


@pytest.mark.parametrize("signal", WATCHED)
def test_a_limit_event_has_its_unit(signal: str) -> None:
    unit = WATCHED[signal].unit
    gap = f" {unit}" if unit else ""
    passed = worded(Kind.LIMIT, int(Fault.LIMIT), int(Action.LOG), 37092.6, 500.0, f"{signal} above").text
    assert passed == f"limit: {signal} above 500{gap} (37090{gap})"
    kept = worded(Kind.LIMIT_OVER, int(Fault.LIMIT), int(Action.LOG), 1.0, 500.0, f"{signal} above").text
    assert kept == f"limit cleared: {signal} above 500{gap}"
    words = f"{signal} changing by more per second than"
    trip = worded(Kind.TRIP, int(Fault.LIMIT), int(Action.HOLD), -3.0, 0.5, words)
    rate = f" {unit}/s" if unit else ""
    assert trip.text == f"trip LIMIT: {words} 0.5{rate} (-3{rate})"


def test_a_signal_that_never_came_has_no_age() -> None:
    words = fault_text(Fault.CELL_STALE, float((1 << 61) + 12345), 20e6)
    assert words == "no tension sample for as long as the loop has run (limit 20 ms)"


def test_one_and_many() -> None:
    assert [count(n, "tick") for n in (0, 1, 2)] == ["0 ticks", "1 tick", "2 ticks"]
    assert worded(Kind.CLOCK, 1, 0, 0.0, 0.0, "").text == "1 tick skipped at once"
