"""The electric cylinder's motion: command delay, first-order lag, acceleration limit, end stops and brake."""

from __future__ import annotations

import math
from collections import deque


class Cylinder:
    """``ds/dt = v``, ``tau dv/dt = u(t - Td) - v``, the lag discretised exactly.

    Args:
        step_ns: integration step.
        lag_s: tau.
        delay_s: Td; a command counts from the step whose middle is at or after its arrival plus Td.
        acceleration_mm_s2: bound of ``|dv/dt|``.
        ends_mm: lowest and highest stroke, mechanical.
    """

    __slots__ = (
        "_command",
        "_decay",
        "_delay_ns",
        "_dv_max",
        "_h",
        "_half_ns",
        "_high",
        "_lag",
        "_low",
        "_on_the_way",
        "braked",
        "speed_mm_s",
        "stroke_mm",
    )

    def __init__(
        self, step_ns: int, lag_s: float, delay_s: float, acceleration_mm_s2: float, ends_mm: tuple[float, float]
    ) -> None:
        self._h = step_ns * 1e-9
        self._half_ns = step_ns // 2
        self._lag = lag_s
        self._decay = math.exp(-self._h / lag_s)
        self._delay_ns = round(delay_s * 1e9)
        self._dv_max = acceleration_mm_s2 * self._h
        self._low, self._high = ends_mm
        self._command = 0.0
        self._on_the_way: deque[tuple[int, float]] = deque()
        self.braked = True
        self.stroke_mm = 0.0
        self.speed_mm_s = 0.0

    @property
    def at_end(self) -> bool:
        """Whether the stroke rests against a mechanical stop."""
        return not self._low < self.stroke_mm < self._high

    def command(self, velocity_mm_s: float, t_ns: int) -> None:
        """A velocity command that arrives at ``t_ns``."""
        latest = self._on_the_way[-1][1] if self._on_the_way else self._command
        if velocity_mm_s != latest:
            self._on_the_way.append((t_ns + self._delay_ns, velocity_mm_s))

    def step(self, t_ns: int) -> None:
        """One step that begins at ``t_ns``."""
        waiting = self._on_the_way
        while waiting and waiting[0][0] <= t_ns + self._half_ns:
            self._command = waiting.popleft()[1]
        if self.braked:
            self.speed_mm_s = 0.0
            return
        u, v, h = self._command, self.speed_mm_s, self._h
        reached = u + (v - u) * self._decay
        if abs(reached - v) <= self._dv_max:
            stroke = self.stroke_mm + u * h + (v - reached) * self._lag
        else:
            reached = v + math.copysign(self._dv_max, reached - v)
            stroke = self.stroke_mm + 0.5 * (v + reached) * h
        if stroke <= self._low or stroke >= self._high:
            stroke = min(max(stroke, self._low), self._high)
            reached = 0.0
        self.stroke_mm = stroke
        self.speed_mm_s = reached
