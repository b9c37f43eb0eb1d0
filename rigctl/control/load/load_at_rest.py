"""Whether the load is at rest, and which measurement shows it: the tension, the stroke, or both.

It is a value of its own beside what holds the load and whether the power is off: each may be so without the others.
"""

from __future__ import annotations

import math

from rigctl.config.settings import RigSettings
from rigctl.control.snapshot import Snapshot
from rigctl.model.faults import Trait, bits_of, having
from rigctl.model.states import REST_S, LoadAtRest

REST_NS = round(REST_S * 1e9)
REST_MM = 0.1  # of stretch: in 2 s a motor moves more at 0.05 mm/s
STILL_MM = 0.02  # of stretch: the swing of a payload on air bearings falls and rises again by 0.01 mm
BOUNCE_NS = 750_000_000  # a fall of more: that of a payload that bounces ends sooner, seen over 0.5 s
_SMOOTH_S = 0.05  # of the cell's noise
CELL_BITS, STROKE_BITS = bits_of(having(Trait.CELL_DOUBTED)), bits_of(having(Trait.STROKE_DOUBTED))
"""Causes, see `Fault.bit`, while which a tension or a stroke at rest shows nothing."""


class LoadRest:
    """How long the tension has stayed where it is, and what shows that the load is at rest.

    ``tension_seen``: the cell is alive and not in doubt. ``slack``: it shows no load. ``tension_ns``: time for which
    the smoothed tension has stayed within `REST_MM` of stretch; 0 where it is not seen.
    """

    def __init__(self, settings: RigSettings) -> None:
        self._rest_n = REST_MM * settings.plant.stiffness_n_mm
        self._still_n = STILL_MM * settings.plant.stiffness_n_mm
        self._slack_n = settings.tension.slack_n
        self._share = settings.loop.period_ns * 1e-9 / _SMOOTH_S
        self._tension_n = self._reference_n = math.nan
        self._from_ns = 0
        self.tension_seen = self.slack = False
        self.tension_ns = self._falls_ns = 0
        self.shown = LoadAtRest.UNKNOWN

    def look(self, causes: int, snapshot: Snapshot) -> LoadAtRest:
        """One tick; ``causes``: the fault that is latched and the causes that are active, see `Fault.bit`."""
        self.tension_seen = (
            not causes & CELL_BITS and not snapshot.probe.cell_frozen
            and snapshot.cell_quality == 0 and snapshot.cell_heard
        )  # fmt: skip
        self.slack = self.tension_seen and snapshot.tension_n < self._slack_n
        self.tension_ns = self._tension_at_rest_ns(snapshot)
        if abs(snapshot.held_tension.sinks_n) <= self._still_n:
            self._falls_ns = snapshot.t_ns
        by_tension = self.tension_seen and not self.slack
        by_stroke = not causes & STROKE_BITS and snapshot.drive_heard
        falls = snapshot.t_ns - self._falls_ns >= BOUNCE_NS
        # Also of a rope that is slack by now, and of a cell that has come into doubt since.
        moved = snapshot.t_ns - self._from_ns < REST_NS
        tension_moves = moved or (by_tension and falls)
        stroke_moves = by_stroke and snapshot.still_ns < REST_NS
        if not (by_tension or by_stroke):
            self.shown = LoadAtRest.UNKNOWN
        elif tension_moves or stroke_moves or snapshot.sinking.speed_mm_s:
            self.shown = LoadAtRest.MOVES
        elif by_tension and by_stroke:
            self.shown = LoadAtRest.BOTH
        else:
            self.shown = LoadAtRest.TENSION if by_tension else LoadAtRest.STROKE
        return self.shown

    def _tension_at_rest_ns(self, snapshot: Snapshot) -> int:
        if not self.tension_seen:
            self._tension_n = math.nan
            return 0
        if math.isnan(self._tension_n):
            self._tension_n, self._reference_n = snapshot.tension_n, math.inf
        self._tension_n += (snapshot.tension_n - self._tension_n) * self._share
        if abs(self._tension_n - self._reference_n) > self._rest_n:
            self._reference_n, self._from_ns = self._tension_n, snapshot.t_ns
        return snapshot.t_ns - self._from_ns
