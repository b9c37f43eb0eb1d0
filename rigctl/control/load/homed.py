"""Checks that the drive's position is the stroke: compares it with the last known stroke and watches for jumps.

The stroke's limits are limits on the drive's position, so an encoder that has lost its zero shifts them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rigctl.config.built_type import built
from rigctl.config.cylinder_section import CylinderSettings
from rigctl.model.verbs import STROKE_TOLERANCE_MM

GAP_NS = 100_000_000  # over a longer gap the speed does not predict the stroke


@built
@dataclass(frozen=True)
class LastStroke:
    """The last known stroke at the start of a loop; ``mm`` is None where it is unknown, ``why`` then has the reason.

    At the very first start there is neither stroke nor reason.
    """

    mm: float | None = None
    why: str = ""


@dataclass(frozen=True)
class StrokeVerdict:
    """Verdict on the drive's position; ``last_mm`` is NaN where there is no last known stroke."""

    believed: bool
    reads_mm: float
    last_mm: float
    why: str


class Homed:
    """``known``: the position is believed. ``doubted``: it must be confirmed. ``jump_mm``: jump seen by this loop."""

    def __init__(self, cylinder: CylinderSettings, last: LastStroke) -> None:
        self._absolute, self._waiver, self._last = cylinder.absolute_encoder, cylinder.stroke_waiver, last
        self.known = self.doubted = False
        self.jump_mm = 0.0
        self._seen_mm = self._seen_mm_s = math.nan
        self._seen_ns = 0

    def look(self, stroke_mm: float, speed_mm_s: float, now_ns: int) -> StrokeVerdict | None:
        """Take a new sample of the drive; returns a finding where it is new, else None."""
        before_mm, passed_ns = self._seen_mm, now_ns - self._seen_ns
        usual_mm = 0.5 * (speed_mm_s + self._seen_mm_s) * passed_ns * 1e-9 if passed_ns <= GAP_NS else 0.0
        # Over a longer gap the drive has stopped by its own deadline: within GAP_NS at the speed it had.
        spare_mm = abs(self._seen_mm_s) * GAP_NS * 1e-9 if passed_ns > GAP_NS else 0.0
        self._seen_mm, self._seen_mm_s, self._seen_ns = stroke_mm, speed_mm_s, now_ns
        if math.isnan(before_mm):
            return self._first(stroke_mm)
        jump_mm = abs(stroke_mm - before_mm - usual_mm)
        if jump_mm <= STROKE_TOLERANCE_MM + spare_mm:
            return None
        self.known, self.doubted, reported = False, True, self.jump_mm > 0.0
        self.jump_mm = max(self.jump_mm, jump_mm)
        return None if reported else StrokeVerdict(False, stroke_mm, before_mm, f"{before_mm:.2f} mm the sample before")

    def confirm(self, stroke_mm: float) -> StrokeVerdict:
        """An operator has measured the stroke: the position is right."""
        self.known, self.doubted, self.jump_mm = True, False, 0.0
        return StrokeVerdict(True, stroke_mm, math.nan, "confirmed by an operator")

    def _first(self, stroke_mm: float) -> StrokeVerdict:
        """Compare the first sample with the last known stroke."""
        last, last_mm = self._last, math.nan if self._last.mm is None else self._last.mm
        if not self._absolute:
            against = "its encoder is not absolute"
        elif last.mm is None:
            against = last.why
        else:
            against = f"{last_mm:.2f} mm when last known" if abs(stroke_mm - last_mm) > STROKE_TOLERANCE_MM else ""
        self.known = not against or self._waiver is not None
        self.doubted = not self.known
        why = against or ("as when last known" if last.mm is not None else "none on record to compare it with")
        waived = f", waived: {self._waiver}" if against and self.known else ""
        return StrokeVerdict(self.known, stroke_mm, last_mm, why + waived)
