"""A load that sinks on the closed brake: its speed by the encoder, checked by the tension, and how far it may sink."""

from __future__ import annotations

import math
from collections import deque

from rigctl.config.settings import RigSettings
from rigctl.control.findings import SinkingSeen
from rigctl.control.load.rope_memory import RopeMemory
from rigctl.control.snapshot import Snapshot

STEP_NS = 100_000_000
STEPS = 50
"""Means over 100 ms, for 5 s: a brake that slips by 0.02 mm/s has then moved the stroke by 0.1 mm."""
LATEST = 10  # of them: a motion that shows in the last second has its speed from there
FEWEST = 3
STILL_MM = 0.02  # of encoder noise and a toggling count, as in rigctl.control.power.power_seen
JUMP_MM = 0.5  # in one tick: a position that jumped, see rigctl.control.load.homed, and no motion
AGREES_MM, AGREES_SHARE = 0.3, 0.3
"""Difference that a payload at rest and an inexact stiffness may make between stroke and stretch."""


class Sinking:
    """Call ``look`` every tick. ``seen``: the stroke's figures are 0 unless the brake alone has the load."""

    def __init__(self, settings: RigSettings, rope: RopeMemory) -> None:
        plant = settings.plant
        self._rope = rope
        self._stiffness = plant.slow_stiffness_n_mm
        self._slack_n = settings.tension.slack_n
        self._steps: deque[tuple[int, float, float]] = deque(maxlen=STEPS + 1)
        self._sum_mm = self._sum_n = 0.0
        self._count, self._next_ns = 0, 0
        self._last_mm = math.nan
        self.seen = SinkingSeen()

    def forget(self) -> None:
        """Begin anew: what was before is acknowledged."""
        self._steps.clear()
        self._count = 0

    def look(self, now_ns: int, snapshot: Snapshot) -> None:
        """One tick."""
        tension_n, seen = snapshot.tension_n, self.seen
        if tension_n < self._slack_n and self._rope.slack_in_doubt(snapshot):
            tension_n = self._rope.by_stroke_n(snapshot.stroke_mm)
        seen.left_mm = max(0.0, tension_n - self._slack_n) / self._stiffness  # 0 for an unknown tension
        jumped = abs(snapshot.stroke_mm - self._last_mm) > JUMP_MM  # False for NaN
        self._last_mm = snapshot.stroke_mm
        unknown = jumped or not math.isfinite(snapshot.stroke_mm + snapshot.tension_n)
        alone = snapshot.power.stopped_and_closed and not unknown
        if not alone and (self._steps or self._count):
            self.forget()
        if not self._steps:
            seen.speed_mm_s = seen.apart_mm = 0.0
        if not alone:
            return
        if not self._count:
            self._sum_mm = self._sum_n = 0.0
            self._next_ns = now_ns + STEP_NS
        self._sum_mm += snapshot.stroke_mm
        self._sum_n += snapshot.tension_n
        self._count += 1
        if now_ns < self._next_ns:
            return
        self._steps.append((now_ns, self._sum_mm / self._count, self._sum_n / self._count))
        self._count = 0
        if len(self._steps) >= FEWEST:
            self._judge()

    def _judge(self) -> None:
        (_, then_mm, then_n), (_, now_mm, now_n) = self._steps[0], self._steps[-1]
        seen = self.seen
        moved_mm = now_mm - then_mm
        stretch_mm = (now_n - then_n) / self._stiffness if now_n > self._slack_n else moved_mm
        seen.apart_mm = max(0.0, abs(moved_mm - stretch_mm) - AGREES_SHARE * abs(moved_mm) - AGREES_MM)
        seen.speed_mm_s = self._speed_mm_s(min(LATEST, len(self._steps) - 1)) or self._speed_mm_s(len(self._steps) - 1)

    def _speed_mm_s(self, steps: int) -> float:
        """Over so many steps, 0 for a stroke at rest."""
        (then_ns, then_mm, _), (now_ns, now_mm, _) = self._steps[-1 - steps], self._steps[-1]
        moved_mm = now_mm - then_mm
        return moved_mm / ((now_ns - then_ns) * 1e-9) if abs(moved_mm) > STILL_MM else 0.0
