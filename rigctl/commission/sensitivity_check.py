"""Measured against predicted sensitivity, frequency by frequency. Pure functions of arrays.

The design predicts |S| at the plant's input over its family of plants, at every level of the filter: a band at each
frequency. A measured |S| that is outside of it by more than ``SURE`` of its own 95 % half widths, at a frequency where
it could reach ``MATTERS`` within its interval, says that plant or law is another one than the design's, and that what
the design says of the loop's margins does not hold.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rigctl.commission.motion import Array

MATTERS = 1.4
SURE = 2.0  # half widths of 95 %: of thirty lines a minute one in months is beyond that by chance
GRANULAR = 0.02  # of |S|: what a line's neighbours and the rounding of the drive's speed make of it


class SensitivityDifference(NamedTuple):
    """The line with the largest distance from its band: Hz, |S| with its 95 % half width, the band's ends."""

    hz: float
    measured: float
    error: float
    low: float
    high: float

    def in_words(self) -> str:
        """One line."""
        return (
            f"|S| is {self.measured:.2f} +- {self.error:.2f} at {self.hz:.3g} Hz, the design's family has "
            f"{self.low:.2f} to {self.high:.2f}: identify and tune again, no other gains are taken before"
        )

    def as_dict(self) -> dict[str, Any]:
        """For an entry of the ledger."""
        return {name: float(f"{value:.6g}") for name, value in self._asdict().items()}


def difference(hz: Array, measured: Array, error: Array, low: Array, high: Array) -> SensitivityDifference | None:
    """The worst line that is beyond its band where it matters; None if there is none."""
    beyond = np.maximum(measured - high, low - measured) - (SURE * error + GRANULAR * measured)
    matters = measured + error >= MATTERS
    counted = np.where(matters & np.isfinite(beyond), beyond, -np.inf)
    worst = int(np.argmax(counted))
    if not counted[worst] > 0.0:
        return None
    return SensitivityDifference(*(float(column[worst]) for column in (hz, measured, error, low, high)))
