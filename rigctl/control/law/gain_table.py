"""Gains over the operating range: the entry of a table that is in force, by set-point and stroke.

A rope's stiffness rises with its load, and the mechanism's posture changes with the stroke, so that one plant is not
the plant everywhere. Each entry of the table holds gains and the plant and noises that the filter believes; it was
identified at its own tension and stroke and has passed the gate of the design (`rigctl.design.transitions`).

The nearest entry is in force, with a hysteresis, and each entry for at least the dwell time for which the design has
found that no sequence of changes makes the loop unstable. The command makes no step at a change: the next filter goes
on from the state of the last one, the integral takes over what the other gains make of the present errors, and a ramp
under way keeps its stiffness.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rigctl.config.built_type import built
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.estimator import TensionFilter, filter_model
from rigctl.control.law.tension import Gains

NEARER = 0.8
"""The distance to another entry over that to the one in force, below which the other one is taken."""
LEAST_SPAN_N, LEAST_SPAN_MM = 1.0, 1.0


@dataclass(frozen=True)
class TableEntry:
    """Gains for an operating point. ``believes``: values by key of the rig file, in place of those of the settings."""

    tension_n: float
    gains: Gains
    believes: Mapping[str, float | None] = field(default_factory=dict)
    stroke_mm: float | None = None  # None: wherever the stroke is


@built
@dataclass(frozen=True)
class ScheduledGains(Gains):
    """Gains with a table, whose first entry has these gains and believes what the settings say."""

    table: tuple[TableEntry, ...] = ()
    dwell_s: float = 0.0  # shortest time that an entry is in force


def plain(gains: Gains) -> Gains:
    """The gains without a table."""
    return Gains(*gains.in_order)


@dataclass(frozen=True)
class InForce:
    """An entry with its filter."""

    number: int
    gains: Gains
    stiffness_n_mm: float
    filter: TensionFilter


class GainTable:
    """Which entry is in force."""

    def __init__(self, settings: RigSettings, gains: ScheduledGains) -> None:
        self._entries = gains.table
        believed = [changed(settings, entry.believes) for entry in gains.table]
        self._in_force = [
            InForce(number, entry.gains, its.plant.stiffness_n_mm, TensionFilter(filter_model(its)))
            for number, (entry, its) in enumerate(zip(gains.table, believed, strict=True))
        ]
        self._dwell = round(gains.dwell_s * settings.loop.rate_hz)
        self._ticks = 0
        self.number = 0
        """Of the entry in force."""
        strokes = [entry.stroke_mm for entry in gains.table if entry.stroke_mm is not None]
        self._per_n = 1.0 / _span([entry.tension_n for entry in gains.table], LEAST_SPAN_N)
        self._per_mm = 1.0 / _span(strokes, LEAST_SPAN_MM)

    @classmethod
    def of(cls, settings: RigSettings, gains: Gains) -> GainTable | None:
        """The table of the gains; None where there is none, or no choice in it."""
        return cls(settings, gains) if isinstance(gains, ScheduledGains) and len(gains.table) > 1 else None

    def look(self, tension_n: float, stroke_mm: float, now: TensionFilter) -> InForce | None:
        """Take one tick; the entry to change to, or None. Its filter goes on from the state of ``now``.

        ``tension_n``: set-point along the rope, which is on its ramp and free of noise.
        """
        self._ticks += 1
        if self._ticks < self._dwell:
            if now.opening is not None:
                now.opening.open()  # the proof of the dwell time is of an open filter
            return None
        distances = [self._distance(entry, tension_n, stroke_mm) for entry in self._entries]
        nearest = min(range(len(distances)), key=distances.__getitem__)
        if nearest == self.number or not distances[nearest] < NEARER * distances[self.number]:
            return None
        self.number, self._ticks = nearest, 0
        taken = self._in_force[nearest]
        taken.filter.take_over(now)
        return taken

    def _distance(self, entry: TableEntry, tension_n: float, stroke_mm: float) -> float:
        distance = abs(tension_n - entry.tension_n) * self._per_n
        if entry.stroke_mm is not None:
            distance += abs(stroke_mm - entry.stroke_mm) * self._per_mm
        return distance


def _span(values: Sequence[float], least: float) -> float:
    return max(max(values, default=0.0) - min(values, default=0.0), least)
