"""The drive's speed controller against the load: how far a load turns the motor back until the motor carries it."""

from __future__ import annotations

import math
from typing import Protocol

KG = 1e-3
"""t; with mm, N and s, a force over a mass is an acceleration."""
_ROUNDING_MM, _ROUNDING_MM_S = 1e-9, 1e-7


class SpeedControl(Protocol):
    """The motor's force, and the way by which it differs from the commanded one; N, mm and s throughout."""

    offset_n: float
    """Force that the drive adds by its torque offset (0x60B2)."""

    def against_brake(self, load_n: float) -> float:
        """The motor's force while the brake holds this load."""

    def switch_off(self) -> None:
        """The motor has no current: its integrator starts at zero next time."""

    def build_up(self, seconds: float) -> None:
        """The motor has had current for so much longer."""

    def wind_up(self, way_mm: float) -> None:
        """The brake holds a motor that is commanded to go this way."""

    def take_over(self, load_n: float, drag_n: float) -> None:
        """The brake lets the load go; ``drag_n`` of friction may still hold part of it."""

    def carry(self, seconds: float) -> tuple[float, float]:
        """Way that the load and the motor go beyond the commanded one, and the force in excess of the load."""


class SpeedLoop:
    """PI control of the speed: ``m dv/dt = F - T``, ``F = offset - Kp v - Ki x``, with ``x`` off the commanded way.

    ``Kp = m w`` at the bandwidth ``w``, integral time ``4 / w``: critically damped. With no torque to begin with, a
    load ``T`` ends up ``T / Ki = 4 T / (m w2)`` lower, since a speed controller does not take the way back. Friction,
    which holds part of the load, is left out. The load counts as it is when the brake lets it go: later changes of it
    are part of the lag of `plant.cylinder_lag_s`.

    Args:
        moved_kg: mass of rotor and screw as seen by the rope.
        bandwidth_hz: of the speed controller.
        most_n: force of the motor's peak current; the integrator ends there.
        torque_s: time in which the torque of the offset builds up, evenly, once the motor has current.
    """

    def __init__(self, moved_kg: float, bandwidth_hz: float, most_n: float, torque_s: float = 0.0) -> None:
        self._pole = math.pi * bandwidth_hz  # w / 2, twice
        self._mass = moved_kg * KG
        self._stiffness = self._mass * self._pole**2
        self._most_n, self._torque_s = most_n, torque_s
        self.offset_n = 0.0
        self.switch_off()

    def against_brake(self, load_n: float) -> float:  # noqa: ARG002 - the brake has it
        """Offset and integrator, up to the peak current."""
        return min(max(self._given_n - self._stiffness * self._off_mm, -self._most_n), self._most_n)

    def switch_off(self) -> None:
        """No current."""
        self._off_mm = self._off_mm_s = self._load_n = self._on_s = 0.0

    def build_up(self, seconds: float) -> None:
        """The torque of the offset grows."""
        self._on_s += seconds

    @property
    def _given_n(self) -> float:
        """Of the offset, so far."""
        return self.offset_n * min(1.0, self._on_s / self._torque_s) if self._torque_s else self.offset_n

    def wind_up(self, way_mm: float) -> None:
        """Integrate the speed that the brake denies, up to the peak current."""
        low, high = ((self._given_n + sign * self._most_n) / self._stiffness for sign in (-1.0, 1.0))
        self._off_mm = min(max(self._off_mm - way_mm, low), high)
        self._off_mm_s = 0.0

    def take_over(self, load_n: float, drag_n: float) -> None:
        """Latch the load that the motor has to carry from now on."""
        held_n = min(max(load_n - self.against_brake(load_n), -drag_n), drag_n)
        self._load_n = load_n - held_n

    def carry(self, seconds: float) -> tuple[float, float]:
        """Advance the deviation exactly, for a load and an offset that do not change meanwhile."""
        rest = (self._given_n - self._load_n) / self._stiffness
        away, speed, before = self._off_mm - rest, self._off_mm_s, self._off_mm
        if abs(away) < _ROUNDING_MM and abs(speed) < _ROUNDING_MM_S:
            self._off_mm, self._off_mm_s = rest, 0.0
            return rest - before, 0.0
        pole, decay = self._pole, math.exp(-self._pole * seconds)
        slope = speed + pole * away
        self._off_mm = rest + (away + slope * seconds) * decay
        self._off_mm_s = (speed - pole * slope * seconds) * decay
        excess_n = -self._mass * pole * (2.0 * self._off_mm_s + pole * (self._off_mm - rest))
        return self._off_mm - before, excess_n


class IdealSpeedControl:
    """A motor that has the load's torque at once, so that it never yields; its offset changes nothing."""

    offset_n = 0.0

    def against_brake(self, load_n: float) -> float:
        """The load, as if the brake did not hold it."""
        return load_n

    def switch_off(self) -> None:
        """Nothing to forget."""

    def build_up(self, seconds: float) -> None:
        """Its torque is there."""

    def wind_up(self, way_mm: float) -> None:
        """No integrator."""

    def take_over(self, load_n: float, drag_n: float) -> None:
        """Nothing is missing."""

    def carry(self, seconds: float) -> tuple[float, float]:  # noqa: ARG002
        """Stay on the commanded way."""
        return 0.0, 0.0
