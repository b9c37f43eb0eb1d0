"""A number as a person types it: one reader for the command line, a question on a terminal and a field of the page."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from rigctl.model.quantity import significant

_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_WHOLE = re.compile(r"[+-]?[0-9]+")
_LONGEST = 40
_WHOLE_BELOW = 2**63


class TypedNumberError(ValueError):
    """Text that is no such number; ``str()`` is one line: what was found, and what is expected with an example."""


@dataclass(frozen=True)
class TypedNumber:
    """What is expected: digits 0 to 9, a point before decimals, a hyphen as the minus sign, no grouping.

    ``of``: the unit, or what is counted, in words; "" where the option's name says it. ``least``, ``most``: the bounds,
    which are allowed themselves; None: whoever takes the number has a bound of its own, or there is none.
    """

    of: str = ""
    least: float | None = None
    most: float | None = None
    whole: bool = False

    def read(self, text: str | float) -> float:
        """The number, an ``int`` where it is to be whole; of a number, as a program's default is one, the same.

        Raises:
            TypedNumberError: other text, or a number beyond the bounds.
        """
        typed = str(text).strip()
        form = _WHOLE if self.whole else _DECIMAL
        value = math.nan
        if len(typed) <= _LONGEST and form.fullmatch(typed):
            value = int(typed) if self.whole else float(typed)
        if not math.isfinite(value) or (self.whole and abs(value) >= _WHOLE_BELOW):
            raise TypedNumberError(f"found {str(text)[:_LONGEST]!r}, expected {self._words(',' in typed)}")
        if (self.least is not None and value < self.least) or (self.most is not None and value > self.most):
            raise TypedNumberError(f"found {typed}, expected {f'{self.bounds} {self.of}'.rstrip()}")
        return value

    @property
    def bounds(self) -> str:
        """``1 to 480``, ``at least 1``, or "" without a bound."""
        least, most = ("" if bound is None else significant(bound) for bound in (self.least, self.most))
        return f"{least} to {most}" if least and most else f"at least {least}" if least else most and f"at most {most}"

    def _words(self, comma: bool) -> str:
        """What is expected of the text; ``comma``: a decimal comma may have been typed."""
        kind = f"a {'whole ' if self.whole else ''}number{f' of {self.of}' if self.of else ''}"
        if self.whole:
            return f"{kind} such as 3"
        return f"{kind}{' with a decimal point,' if comma else ''} such as 290.5"
