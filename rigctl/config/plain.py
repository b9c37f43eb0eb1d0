"""Layout of a plain frame: a message of a DBC file, reduced to the signals that the rig needs.

Both ends use this table: the control process compiles its decoders from it (`rigctl.devices.dbc`), the simulated
sensors encode their frames with it. It is made once, when the rig file is loaded (`rigctl.config.dbc_file`), and
crosses to the other processes with the settings; bit numbers are those of the DBC format.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

FLOAT_CODES = {16: "e", 32: "f", 64: "d"}
"""IEEE 754 formats a signal may have, by length in bits."""


class _Layout(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class PlainSignal(_Layout):
    """One signal: ``value = raw * scale + offset``, with scale and offset already in N or rad.

    ``start`` is the least significant bit of a little-endian signal and the most significant one of a big-endian
    signal, bit ``n`` being bit ``n % 8`` (0 = least significant) of byte ``n // 8``.
    """

    name: str
    start: int = Field(ge=0, le=63)
    length: int = Field(ge=1, le=64)
    big_endian: bool
    signed: bool
    floating: bool
    scale: float
    offset: float
    declared_least: float | None = None
    declared_most: float | None = None
    """Range of the values by the DBC file; None: it gives none."""

    def shift(self, size: int) -> int:
        """Right shift that brings the signal to bit 0, in ``size`` bytes read as one integer of its byte order."""
        if not self.big_endian:
            return self.start
        above = 8 * (self.start // 8) + 7 - self.start % 8
        return 8 * size - above - self.length

    @property
    def raw_limits(self) -> tuple[int, int]:
        """Lowest and highest raw integer."""
        if self.signed:
            return -(1 << self.length - 1), (1 << self.length - 1) - 1
        return 0, (1 << self.length) - 1

    @property
    def least(self) -> float:
        """Lowest value that a frame carries, by the signal's bits and by the range that its file gives."""
        return max(min(self._ends), -math.inf if self.declared_least is None else self.declared_least)

    @property
    def most(self) -> float:
        """Highest such value."""
        return min(max(self._ends), math.inf if self.declared_most is None else self.declared_most)

    @property
    def _ends(self) -> tuple[float, float]:
        """The values of both ends of the raw range."""
        if self.floating:
            return -math.inf, math.inf
        low, high = self.raw_limits
        return low * self.scale + self.offset, high * self.scale + self.offset

    def raw_bits(self, value: float) -> int:
        """``value`` as the signal's bits; an integer signal saturates at its limits."""
        raw = (value - self.offset) / self.scale
        if self.floating:
            return int.from_bytes(struct.pack(">" + FLOAT_CODES[self.length], raw), "big")
        low, high = self.raw_limits
        return min(max(round(raw), low), high) & (1 << self.length) - 1

    def __str__(self) -> str:
        kind = "float" if self.floating else "signed" if self.signed else "unsigned"
        order = "big" if self.big_endian else "little"
        return f"{self.name}: {self.length} bit {kind}, {order}-endian, from bit {self.start}, x {self.scale:g}" + (
            f" + {self.offset:g}" if self.offset else ""
        )


class PlainMessage(_Layout):
    """A standard frame that its device sends without a request; ``signals`` by their meaning to the rig."""

    name: str
    can_id: Annotated[int, Field(ge=0, le=0x7FF)]
    size: int = Field(ge=1, le=8)
    cycle_ms: int | None = Field(default=None, ge=1)
    signals: dict[str, PlainSignal]

    def rate_hz(self, loop_rate_hz: int) -> float:
        """Frames per second by the DBC file's cycle time, or the loop's rate where it has none."""
        return 1000.0 / self.cycle_ms if self.cycle_ms else float(loop_rate_hz)

    def payload(self, values: Mapping[str, float]) -> bytes:
        """The frame's data with ``values`` (N, rad) by meaning; every other bit is 0."""
        little = big = 0
        for meaning, signal in self.signals.items():
            bits = (signal.raw_bits(values[meaning]) if meaning in values else 0) << signal.shift(self.size)
            if signal.big_endian:
                big |= bits
            else:
                little |= bits
        return (little | int.from_bytes(big.to_bytes(self.size, "big"), "little")).to_bytes(self.size, "little")
