"""A damped swing of the disturbance's speed, beside its random walk.

After a move the rail's mass swings against the rope, and the rope's stretch with it: its speed is then no walk, but the
first part a of a damped oscillation driven by white noise (`estimator.swing_hz`, `swing_damping`, `swing_walk_mm_s`),

    da/dt = -s a + w_d b + noise,   db/dt = -w_d a - s b + noise,   s = zeta w_0,   w_d = w_0 sqrt(1 - zeta^2)

A swing is known ahead. The drive's speed v follows a command u as ``tau dv/dt = u - v``, so that v = -a needs
u = -(a + tau da/dt): `FilteredSwing.ahead` gives the second part.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple, Protocol

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.control.law.kalman import Array

Pair = tuple[float, float]


class SwingPeriod(NamedTuple):
    """One period of the swing; states (a, b)."""

    keeps: float
    """``a(n + 1) = keeps a(n) + turns b(n)``, ``b(n + 1) = keeps b(n) - turns a(n)``."""
    turns: float
    to_tension: Pair
    """N of tension in a period, per mm/s of a and of b."""
    lead: Pair
    """``tau da/dt`` per a and per b."""
    walk_mm_s: float
    """Noise of either state, mm/s per square root of a second."""

    @classmethod
    def of(cls, settings: RigSettings) -> SwingPeriod | None:
        """The swing of the settings; None where they have none."""
        estimator, plant, dt = settings.estimator, settings.plant, 1.0 / settings.loop.rate_hz
        if estimator.swing_hz is None:
            return None
        natural = 2.0 * math.pi * estimator.swing_hz
        decay = estimator.swing_damping * natural
        turn = natural * math.sqrt(1.0 - estimator.swing_damping**2)
        exponent = complex(-decay, -turn)  # of a + ib
        step = cmath.exp(exponent * dt)
        moved = plant.stiffness_n_mm * (step - 1.0) / exponent
        return cls(
            step.real, -step.imag, (moved.real, -moved.imag),
            (-plant.cylinder_lag_s * decay, plant.cylinder_lag_s * turn), estimator.swing_walk_mm_s,
        )  # fmt: skip

    @property
    def f(self) -> Array:
        """Transition of (a, b), (2, 2)."""
        return np.array([[self.keeps, self.turns], [-self.turns, self.keeps]])


class DisturbanceSwing(Protocol):
    """The states of a filter beyond tension, drive speed and walk, and what they add to those."""

    def take(self, states: tuple[float, ...]) -> None:
        """Go on from the states of another swing."""

    def correct(self, by_tension: tuple[float, ...], by_speed: tuple[float, ...], y0: float, y1: float) -> None:
        """Correct by the innovations of tension and drive speed with these gains."""

    def carry(self) -> float:
        """Go one period on; returns what that period added to the tension, N."""

    @property
    def states(self) -> tuple[float, ...]:
        """As `take` reads them."""

    @property
    def speed_mm_s(self) -> float:
        """The part of the disturbance's speed that swings, now."""

    def ahead(self) -> tuple[float, float, float]:
        """At the instant at which the next command acts: added tension N, the speed mm/s, and its lead mm/s."""


class NoSwing:
    """The disturbance is a walk alone."""

    __slots__ = ()
    states: tuple[float, ...] = ()
    speed_mm_s = 0.0

    def take(self, states: tuple[float, ...]) -> None:
        """There are none."""

    def correct(self, by_tension: tuple[float, ...], by_speed: tuple[float, ...], y0: float, y1: float) -> None:
        """Nothing swings."""

    def carry(self) -> float:
        """Nothing is added."""
        return 0.0

    def ahead(self) -> tuple[float, float, float]:
        """Nothing swings."""
        return 0.0, 0.0, 0.0


class FilteredSwing:
    """The swing's states in a filter.

    Args:
        period: of the model.
        to_tension: N of tension until the next command acts, per a and per b.
        ticks: until then.
    """

    __slots__ = ("_a", "_ahead", "_b", "_keeps", "_lead", "_to_tension", "_to_tension_ahead", "_turns")

    def __init__(self, period: SwingPeriod, to_tension: Pair, ticks: int) -> None:
        self._keeps, self._turns, self._to_tension, self._lead = period[:4]
        keeps, turns = np.linalg.matrix_power(period.f, ticks)[0].tolist()
        self._ahead, self._to_tension_ahead = (keeps, turns), to_tension
        self._a = self._b = 0.0

    @property
    def states(self) -> Pair:
        """See `DisturbanceSwing`."""
        return self._a, self._b

    @property
    def speed_mm_s(self) -> float:
        """See `DisturbanceSwing`."""
        return self._a

    def take(self, states: tuple[float, ...]) -> None:
        """See `DisturbanceSwing`."""
        self._a, self._b = states

    def correct(self, by_tension: tuple[float, ...], by_speed: tuple[float, ...], y0: float, y1: float) -> None:
        """See `DisturbanceSwing`."""
        (ka, kb), (la, lb) = by_tension, by_speed
        self._a += ka * y0 + la * y1
        self._b += kb * y0 + lb * y1

    def carry(self) -> float:
        """See `DisturbanceSwing`."""
        a, b, keeps, turns = self._a, self._b, self._keeps, self._turns
        to_a, to_b = self._to_tension
        self._a, self._b = keeps * a + turns * b, keeps * b - turns * a
        return to_a * a + to_b * b

    def ahead(self) -> tuple[float, float, float]:
        """See `DisturbanceSwing`."""
        a, b = self._a, self._b
        (keeps, turns), (to_a, to_b), (lead_a, lead_b) = self._ahead, self._to_tension_ahead, self._lead
        then_a, then_b = keeps * a + turns * b, keeps * b - turns * a
        return to_a * a + to_b * b, then_a, lead_a * then_a + lead_b * then_b
