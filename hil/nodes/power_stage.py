"""The drive's sequence of motor and brake: either or both carry the load; after a cut the brake catches it."""

from __future__ import annotations

import math
from enum import Enum, auto

from hil.nodes.brake import Brake

STANDSTILL_MM_S = 0.05
"""The brake closes below this speed."""


class StagePhase(Enum):
    """What carries the load."""

    BRAKED = auto()  # brake closed, motor off
    OPENING = auto()  # motor on, the drive waits for the brake to open
    DRIVING = auto()  # motor follows the command
    STOPPING = auto()  # motor ramps down to standstill
    CLOSING = auto()  # motor holds, the drive waits for the brake to close
    FALLING = auto()  # motor off, its windings shorted; brake closes


_BRAKE_ENERGISED = frozenset({StagePhase.OPENING, StagePhase.DRIVING, StagePhase.STOPPING})


class PowerStage:
    """Phases in time; velocities in mm/s.

    Args:
        delay_ns: time for which the drive waits for the brake to open or to close.
        brake: the brake itself; by default, one that takes just as long.
    """

    __slots__ = ("_deceleration", "_delay_ns", "_since_ns", "_start_velocity", "brake", "carries_on", "phase",
                 "velocity_mm_s")  # fmt: skip

    def __init__(self, delay_ns: int, brake: Brake | None = None) -> None:
        self._delay_ns = delay_ns
        self.brake = brake or Brake(delay_ns, delay_ns)
        self._since_ns = 0
        self._start_velocity = 0.0
        self._deceleration = math.inf
        self.phase = StagePhase.BRAKED
        self.velocity_mm_s = 0.0
        self.carries_on = False
        """Defect: at standstill the motor goes on carrying, and the brake stays open."""

    @property
    def braked(self) -> bool:
        """Whether the brake is closed."""
        return self.brake.closed

    @property
    def powered(self) -> bool:
        """Whether the motor has current."""
        return self.phase not in (StagePhase.BRAKED, StagePhase.FALLING)

    def start(self, t_ns: int) -> None:
        """Switch the motor on; it drives once the brake is open."""
        if self.phase in (StagePhase.BRAKED, StagePhase.CLOSING, StagePhase.FALLING):
            self._change(StagePhase.OPENING, t_ns)
        elif self.phase is StagePhase.STOPPING:
            self._change(StagePhase.DRIVING, t_ns)

    def follow(self, velocity_mm_s: float) -> None:
        """Velocity command; counts while driving."""
        if self.phase is StagePhase.DRIVING:
            self.velocity_mm_s = velocity_mm_s

    def stop(self, t_ns: int, deceleration_mm_s2: float) -> None:
        """Ramp down, then close the brake, then take power off; again while stopping changes nothing."""
        if self.phase is StagePhase.DRIVING:
            self._start_velocity = self.velocity_mm_s
            self._deceleration = deceleration_mm_s2
            self._change(StagePhase.STOPPING, t_ns)
        elif self.phase is StagePhase.OPENING:
            self._change(StagePhase.CLOSING, t_ns)

    def cut(self, t_ns: int) -> None:
        """Take power off at once, even in motion; the brake closes meanwhile."""
        if self.phase in (StagePhase.DRIVING, StagePhase.STOPPING, StagePhase.OPENING):
            self.velocity_mm_s = 0.0
            self._change(StagePhase.FALLING, t_ns)
        elif self.phase is StagePhase.CLOSING:
            self.phase = StagePhase.FALLING  # the wait for the brake goes on

    def advance(self, t_ns: int, speed_mm_s: float) -> None:
        """Advance to ``t_ns``; ``speed_mm_s`` is the cylinder's actual speed."""
        self.brake.advance(t_ns)
        passed_ns = t_ns - self._since_ns
        if self.phase is StagePhase.STOPPING:
            left = abs(self._start_velocity) - self._deceleration * passed_ns * 1e-9 if passed_ns > 0 else math.inf
            left = min(max(left, 0.0), abs(self._start_velocity))
            self.velocity_mm_s = math.copysign(left, self._start_velocity)
            if left == 0.0 and abs(speed_mm_s) < STANDSTILL_MM_S and not self.carries_on:
                self.velocity_mm_s = 0.0
                self._change(StagePhase.CLOSING, t_ns)
        elif self.phase is StagePhase.OPENING and passed_ns >= self._delay_ns:
            self._change(StagePhase.DRIVING, t_ns)
        elif self.phase in (StagePhase.CLOSING, StagePhase.FALLING) and passed_ns >= self._delay_ns:
            self._change(StagePhase.BRAKED, t_ns)

    def _change(self, phase: StagePhase, t_ns: int) -> None:
        self.phase = phase
        self._since_ns = t_ns
        self.brake.energise(phase in _BRAKE_ENERGISED, t_ns)
