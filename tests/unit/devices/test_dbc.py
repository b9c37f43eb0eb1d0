"""Compiled decoders of plain frames against cantools, and their handling of invalid values."""

from __future__ import annotations

import itertools
import math
import struct
from dataclasses import dataclass
from typing import Any

import cantools
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given
from hypothesis import strategies as st

from rigctl.config import dbc_file
from rigctl.config.plain import FLOAT_CODES, PlainMessage, PlainSignal
from rigctl.devices import dbc
from rigctl.model.samples import Quality

KEY = ("tension_cell", "dbc", "tension")


@dataclass
class Case:
    """A message as cantools has it, and a payload."""

    message: Any
    data: bytes


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """1 to 8 bytes cut into signals side by side, in one byte order, each with a type and scaling of its own."""
    size = draw(st.integers(1, 8))
    big_endian = draw(st.booleans())
    edges = sorted({0, 8 * size, *draw(st.lists(st.integers(1, 8 * size), max_size=3))})
    if draw(st.booleans()):
        edges = sorted({edge // 8 * 8 for edge in edges})
    signals = []
    for i, (low, high) in enumerate(itertools.pairwise(edges)):
        floating = high - low in FLOAT_CODES and draw(st.booleans())
        factors = st.integers(-1000, 1000) | st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-9)
        scale, offset = draw(factors.filter(lambda x: x != 0)), draw(factors)
        signals.append(
            Signal(
                name=f"s{i}",
                start=low // 8 * 8 + 7 - low % 8 if big_endian else low,
                length=high - low,
                byte_order="big_endian" if big_endian else "little_endian",
                is_signed=floating or draw(st.booleans()),
                conversion=BaseConversion.factory(scale=scale, offset=offset, is_float=floating),
                unit="N",
            )
        )
    message = Message(frame_id=1, name="m", length=size, signals=signals, strict=True)
    return Case(message, draw(st.binary(min_size=size, max_size=size)))


@given(cases())
def test_every_signal_reads_as_cantools_reads_it(case: Case) -> None:
    oracle = case.message.decode(case.data, decode_choices=False)
    for signal in case.message.signals:
        layout = dbc_file.signal_layout(KEY, case.message, signal.name, {"N": 1.0})
        found, expected = dbc.reader(layout, len(case.data))(case.data), float(oracle[signal.name])
        if not math.isfinite(expected):
            assert not math.isfinite(found)
            continue
        # cantools keeps integers where scale and offset are integers: one rounding for each of our two operations
        assert abs(found - expected) <= 2.0**-52 * (abs(expected - signal.offset) + abs(signal.offset))


@given(cases())
def test_a_payload_written_by_the_layout_reads_as_cantools_reads_it(case: Case) -> None:
    """Reading, writing and reading again gives the same frame: the simulated sensors write what the loop reads."""
    signals = {
        signal.name: dbc_file.signal_layout(KEY, case.message, signal.name, {"N": 1.0})
        for signal in case.message.signals
        if signal.is_float or signal.length <= 32  # a double carries no more than 53 bits
    }
    plain = PlainMessage(name="m", can_id=1, size=len(case.data), signals=signals)
    raw = case.message.decode(case.data, decode_choices=False, scaling=False)
    values = {name: raw[name] * layout.scale + layout.offset for name, layout in signals.items()}
    if not all(map(math.isfinite, values.values())) or any(s.floating for s in signals.values()):
        return  # a float's last bit is lost in scaling
    again = case.message.decode(plain.payload(values), decode_choices=False, scaling=False)
    assert {name: again[name] for name in signals} == {name: raw[name] for name in signals}


def signal(name: str, start: int, length: int, **changes: Any) -> PlainSignal:
    values = {"big_endian": False, "signed": True, "floating": False, "scale": 1.0, "offset": 0.0, **changes}
    return PlainSignal(name=name, start=start, length=length, **values)


def message(size: int, **signals: PlainSignal) -> PlainMessage:
    return PlainMessage(name="m", can_id=1, size=size, signals=signals)


FLOAT = message(5, tension=signal("t", 0, 32, floating=True), valid=signal("v", 32, 8, signed=False))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_invalid_and_no_number(value: float) -> None:
    tension, quality = dbc.tension_decoder(FLOAT)(struct.pack("<fB", value, 1))
    assert quality == Quality.INVALID
    assert math.isnan(tension)
    angles = message(8, tangential=signal("t", 0, 32, floating=True), normal=signal("n", 32, 32, floating=True))
    for data in (struct.pack("<ff", value, 0.0), struct.pack("<ff", 0.0, value)):
        tangential, normal, quality = dbc.inclination_decoder(angles)(data)
        assert quality == Quality.INVALID
        assert math.isnan(tangential) and math.isnan(normal)


def test_a_finite_value_that_its_scale_makes_infinite_is_invalid_too() -> None:
    wide = message(8, tension=signal("t", 0, 64, floating=True, scale=1e10))
    tension, quality = dbc.tension_decoder(wide)(struct.pack("<d", 1e300))
    assert math.isnan(tension) and quality == Quality.INVALID


def test_valid_at_0_is_invalid_and_at_anything_else_good() -> None:
    decode = dbc.tension_decoder(FLOAT)
    assert decode(struct.pack("<fB", 12.5, 0)) == (12.5, Quality.INVALID)
    assert decode(struct.pack("<fB", 12.5, 1)) == (12.5, 0)
    assert decode(struct.pack("<fB", 12.5, 255)) == (12.5, 0)


def test_without_a_valid_signal_every_finite_value_is_good() -> None:
    plain = message(4, tangential=signal("t", 0, 16), normal=signal("n", 16, 16, scale=0.5, offset=-1.0))
    assert dbc.inclination_decoder(plain)(struct.pack("<hh", -2, 3)) == (-2.0, 0.5, 0)


@given(st.binary(max_size=12))
def test_only_the_right_length_is_decoded(data: bytes) -> None:
    plain = message(5, tangential=signal("t", 0, 16), normal=signal("n", 16, 16))
    for decode in (dbc.tension_decoder(FLOAT), dbc.inclination_decoder(plain)):
        if len(data) == 5:
            decode(bytearray(data))
        else:
            with pytest.raises(ValueError, match="length"):
                decode(data)


def test_an_integer_beyond_its_signal_is_written_saturated() -> None:
    small = message(1, tension=signal("t", 0, 8, scale=0.5))
    decode = dbc.tension_decoder(small)
    assert decode(small.payload({"tension": 1000.0})) == (63.5, 0)
    assert decode(small.payload({"tension": -1000.0})) == (-64.0, 0)


def test_cantools_reads_a_float_signal_of_a_dbc_file_as_we_do() -> None:
    """Through the file format, in which SIG_VALTYPE_ makes the signal a float."""
    text = 'BO_ 5 M: 5 S\n SG_ T : 3|32@1- (2,1) [0|0] "N" X\nSIG_VALTYPE_ 5 T : 1;\n'
    (found,) = cantools.database.load_string(text, "dbc").messages
    layout = dbc_file.signal_layout(KEY, found, "T", {"N": 1.0})
    data = message(5, tension=layout).payload({"tension": 301.25})
    assert found.decode(data) == {"T": 301.25}
    assert dbc.reader(layout, 5)(data) == 301.25
