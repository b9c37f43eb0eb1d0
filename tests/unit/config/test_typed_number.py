"""A number as a person types it: what is read, what is refused and how the refusal is worded."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config.typed_number import TypedNumber, TypedNumberError
from rigctl.wire.alarms import LONGEST_SHELF_S
from rigctl.wire.typed_values import SHELF_MINUTES, shelf_s

NEWTONS, ENTRIES = TypedNumber("newtons"), TypedNumber("entries", 1, 10, whole=True)


@pytest.mark.parametrize(
    ("text", "value"),
    [("290", 290.0), ("290.5", 290.5), ("-290.5", -290.5), ("+3", 3.0), (".5", 0.5), ("5.", 5.0), ("1e-3", 1e-3),
     (" 290 ", 290.0), (30.0, 30.0), (1e-7, 1e-7)],
)  # fmt: skip
def test_a_decimal_number_is_read(text: str | float, value: float) -> None:
    assert NEWTONS.read(text) == value


def test_a_whole_number_is_an_int() -> None:
    assert [type(ENTRIES.read(text)) for text in ("7", " 10", 1)] == [int, int, int]


NO_NUMBERS = (
    "3_00", "\uff12\uff19\uff10", "\u0663\u0660\u0660", "\u2212290", "\u2013290", "abc", "", " ", "nan", "inf", "1e999",
    "0x10", "1 000", "290 N", "--5", "9" * 41,
)  # fmt: skip
"""Among them: digits grouped by underscore and space, full-width and Arabic digits, a minus sign and a dash."""


@pytest.mark.parametrize("text", NO_NUMBERS)
@pytest.mark.parametrize("number", [NEWTONS, ENTRIES])
def test_other_text_is_refused_with_an_example(number: TypedNumber, text: str) -> None:
    with pytest.raises(TypedNumberError) as refused:
        number.read(text)
    kind = "whole number of entries such as 3" if number.whole else "number of newtons such as 290.5"
    assert str(refused.value) == f"found {text[:40]!r}, expected a {kind}"


@pytest.mark.parametrize("text", ["290,5", "10,5", "1,000", "1.000,5"])
def test_a_comma_is_refused_and_the_decimal_point_named(text: str) -> None:
    with pytest.raises(TypedNumberError) as refused:
        NEWTONS.read(text)
    assert str(refused.value) == f"found {text!r}, expected a number of newtons with a decimal point, such as 290.5"


@pytest.mark.parametrize("text", ["1.5", "3,5", "1e1", str(2**63), f"-{2**63}"])
def test_a_whole_number_has_neither_point_nor_exponent_and_fits_in_64_bits(text: str) -> None:
    with pytest.raises(TypedNumberError, match=r"expected a whole number such as 3$"):
        TypedNumber(whole=True).read(text)


def test_the_bounds_are_allowed_and_what_is_beyond_is_refused() -> None:
    number = TypedNumber("minutes", 0.1, 480)
    assert (number.bounds, number.read("0.1"), number.read("480")) == ("0.1 to 480", 0.1, 480.0)
    for text in ("0.09", "480.5", "-1"):
        with pytest.raises(TypedNumberError, match=f"^found {re.escape(text)}, expected 0.1 to 480 minutes$"):
            number.read(text)
    with pytest.raises(TypedNumberError, match=r"^found 0, expected at least 1 entries$"):
        TypedNumber("entries", 1, whole=True).read("0")
    assert (TypedNumber(most=2.5).bounds, NEWTONS.bounds) == ("at most 2.5", "")


@given(st.text(alphabet="0123456789+-.,eE_ \u2212\uff11\u0661", max_size=12) | st.text(max_size=12))
def test_what_is_read_is_what_is_written(text: str) -> None:
    """What is taken consists of ASCII alone, and has the value that Python's own reader gives it."""
    try:
        value = NEWTONS.read(text)
    except TypedNumberError as refused:
        assert "\n" not in str(refused)
        return
    assert text.strip().isascii() and not {"_", ","} & set(text)
    assert value == float(text)


def test_an_alarm_can_be_shelved_for_as_long_as_the_wire_takes() -> None:
    assert SHELF_MINUTES.most is not None and SHELF_MINUTES.least is not None
    assert shelf_s(SHELF_MINUTES.most) == LONGEST_SHELF_S
    assert shelf_s(SHELF_MINUTES.least) >= 1
