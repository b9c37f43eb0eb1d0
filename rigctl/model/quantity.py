"""Figures for operators, formatted here only: no exponent, no negative zero, the unit behind them."""

from __future__ import annotations

import math
from decimal import Decimal

_UNITS = {
    "impulse_n_s": "N s", "_n_s_mm": "N s/mm", "_n_s_m": "N s/m", "_n_mm": "N/mm", "_mm_s2": "mm/s2",
    "_deg_s2": "deg/s2", "_mm_s": "mm/s", "_deg_s": "deg/s", "_mm_m": "mm/m", "_n_s": "N/s", "_n_h": "N/h",
    "_bit_s": "bit/s", "_hz": "Hz", "_us": "us", "_ms": "ms", "_mm": "mm", "_kg": "kg", "_deg": "deg", "_ppm": "ppm",
    "_pct": "%", "_mk": "mK", "_n": "N", "_s": "s",
}  # fmt: skip


class Number(float):
    """A float without exponent and negative zero in any format: ``f"{Number(x):.1f}"``, ``f"{Number(x):.4g}"``."""

    def __format__(self, spec: str) -> str:
        """``g`` gives as many significant digits in positional notation; a zero has no minus."""
        if spec.endswith("g") and math.isfinite(self):
            digits = Decimal(float.__format__(self, spec))
            return format(digits + 0, "f")
        if spec.endswith("f") and "z" not in spec:
            sign, rest = (spec[:1], spec[1:]) if spec[:1] in "+- " else ("", spec)
            spec = f"{sign}z{rest}" if not rest[:1] or rest[:1] not in "<>^=" else spec
        return float.__format__(self, spec)


def number(value: float, digits: int, unit: str = "", *, sign: bool = False) -> str:
    """A value with ``digits`` decimals, and its unit."""
    return f"{Number(value):{'+' if sign else ''}.{digits}f} {unit}".rstrip()


def significant(value: float, unit: str = "", digits: int = 10) -> str:
    """A value with up to ``digits`` significant digits, and its unit: shows a setting as it was written."""
    return f"{Number(value):.{digits}g} {unit}".rstrip()


def count(number: int, one: str, many: str = "") -> str:
    """``1 tick``, ``2 ticks``."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def unit_of(name: str) -> str:
    """Unit a key's name ends in, or an empty string."""
    return next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), "")
