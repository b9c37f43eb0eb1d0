"""The newest credible tension of a tight rope, with the stroke then: a load that the cell does not show any more."""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.load.load_at_rest import CELL_BITS
from rigctl.control.snapshot import Snapshot
from rigctl.model.faults import Fault

CONTRADICTED_BIT = Fault.STRETCH_UNEXPLAINED.bit
"""Encoder and tension contradict each other, so either may be wrong."""
LEFT_SHARE, LEFT_SLACKS = 0.5, 3.0
"""Of the tension, and of that of a slack rope: what the stroke has to show on a rope that is slack by the cell."""


class RopeMemory:
    """``tension_n``: newest credible tension of a tight rope, NaN before the first."""

    def __init__(self, settings: RigSettings) -> None:
        self._slack_n, self._stiffness = settings.tension.slack_n, settings.plant.slow_stiffness_n_mm
        self.tension_n = self._at_mm = math.nan

    def look(self, standing: int, snapshot: Snapshot) -> None:
        """One tick; ``standing``: causes that are active, see `Fault.bit`."""
        if (
            snapshot.tension_n >= self._slack_n
            and not (snapshot.cell_quality or standing & CELL_BITS)
            and snapshot.cell_heard
        ):
            self.tension_n, self._at_mm = snapshot.tension_n, snapshot.stroke_mm

    def by_stroke_n(self, stroke_mm: float) -> float:
        """Tension by the stroke since then; NaN before the first credible one."""
        return self.tension_n + self._stiffness * (stroke_mm - self._at_mm)

    def slack_in_doubt(self, snapshot: Snapshot) -> bool:
        """The cell shows a slack rope, the stroke one that carries the load: one of them is wrong, or the rope gone."""
        by_stroke_n = self.by_stroke_n(snapshot.stroke_mm)
        return snapshot.tension_n < self._slack_n and by_stroke_n > max(
            LEFT_SLACKS * self._slack_n, LEFT_SHARE * self.tension_n
        )

    def cell_in_doubt(self, standing: int, snapshot: Snapshot) -> bool:
        """The cell shows no tension that may be relied on."""
        silent = not snapshot.cell_heard or snapshot.cell_quality != 0
        return silent or bool(standing & CELL_BITS & ~CONTRADICTED_BIT) or self.slack_in_doubt(snapshot)
