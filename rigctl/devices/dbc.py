"""Plain frames -> engineering units, compiled once from a message's layout; no I/O, and no cantools in the loop.

Same interface as `rigctl.devices.codecs`: a decoder returns the values and their quality (``Quality`` bits, 0
good); a payload of the wrong length is a ``ValueError``. cantools is the oracle in the tests.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Literal

from rigctl.config.plain import FLOAT_CODES, PlainMessage, PlainSignal
from rigctl.model.samples import Quality

Data = bytes | bytearray
Reader = Callable[[Data], float]

_INVALID = Quality.INVALID.value
_INTEGER_CODES = {8: "b", 16: "h", 32: "i", 64: "q"}


def tension_decoder(message: PlainMessage) -> Callable[[Data], tuple[float, int]]:
    """Decoder of the tension along the rope in N, and quality; NaN if the raw value is no number."""
    size = message.size
    tension, valid = reader(message.signals["tension"], size), _valid_reader(message)
    is_finite, nan = math.isfinite, math.nan

    def decode(data: Data) -> tuple[float, int]:
        if len(data) != size:
            raise ValueError("length")
        value = tension(data)
        if not is_finite(value):
            return nan, _INVALID
        return value, 0 if valid is None or valid(data) else _INVALID

    return decode


def inclination_decoder(message: PlainMessage) -> Callable[[Data], tuple[float, float, int]]:
    """Decoder of tangential and normal rope angle in rad, and quality; NaN if a raw value is no number."""
    size = message.size
    tangential, normal = (reader(message.signals[name], size) for name in ("tangential", "normal"))
    valid = _valid_reader(message)
    is_finite, nan = math.isfinite, math.nan

    def decode(data: Data) -> tuple[float, float, int]:
        if len(data) != size:
            raise ValueError("length")
        first, second = tangential(data), normal(data)
        if not (is_finite(first) and is_finite(second)):
            return nan, nan, _INVALID
        return first, second, 0 if valid is None or valid(data) else _INVALID

    return decode


def reader(signal: PlainSignal, size: int) -> Reader:
    """Function from a payload of ``size`` bytes to the signal's value, ``raw * scale + offset`` (N, rad).

    A float signal may give NaN or an infinity; the caller handles these.
    """
    raw, scale, offset = _raw_reader(signal, size), signal.scale, signal.offset
    return lambda data: raw(data) * scale + offset


def _valid_reader(message: PlainMessage) -> Callable[[Data], bool] | None:
    """Reader of the device's validity signal: a number other than 0 means valid."""
    if "valid" not in message.signals:
        return None
    value = reader(message.signals["valid"], message.size)
    return lambda data: (number := value(data)) != 0 and math.isfinite(number)


def _raw_reader(signal: PlainSignal, size: int) -> Reader:
    codes = FLOAT_CODES if signal.floating else _INTEGER_CODES
    shift = signal.shift(size)
    if shift % 8 == 0 and signal.length in codes:
        return _aligned_reader(signal, size, codes[signal.length])
    order: Literal["little", "big"] = "big" if signal.big_endian else "little"
    mask, from_bytes = (1 << signal.length) - 1, int.from_bytes
    if signal.floating:
        width, unpack = signal.length // 8, struct.Struct(">" + codes[signal.length]).unpack

        def shifted_float(data: Data) -> float:
            number: float = unpack((from_bytes(data, order) >> shift & mask).to_bytes(width, "big"))[0]
            return number

        return shifted_float
    if signal.signed:
        sign = 1 << signal.length - 1
        return lambda data: ((from_bytes(data, order) >> shift & mask) ^ sign) - sign
    return lambda data: from_bytes(data, order) >> shift & mask


def _aligned_reader(signal: PlainSignal, size: int, code: str) -> Reader:
    """Reader of whole bytes of a width that struct supports."""
    shift = signal.shift(size)
    place = size - (shift + signal.length) // 8 if signal.big_endian else shift // 8
    if not (signal.signed or signal.floating):
        code = code.upper()
    unpack = struct.Struct((">" if signal.big_endian else "<") + code).unpack_from
    return lambda data: unpack(data, place)[0]
