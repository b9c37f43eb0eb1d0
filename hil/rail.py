"""The guide rail: a mass on a circle, dragged by the rope and held by friction that grows with the rope's load."""

from __future__ import annotations

import math

MM_PER_M = 1000.0
_AT_REST_MM_S = 1e-9


class Rail:
    """Tangential motion of rail and pulley at the upper lifting point.

    ``m dw/dt = F - mu(w) Fz sign(w) - d w`` with the Stribeck curve ``mu(w) = mu_d + (mu_s - mu_d) exp(-(w/w_s)^2)``;
    true stick: it rests until ``|F| > mu_s Fz``, which is a rope angle of atan(mu_s).

    Args:
        mass_kg: effective mass at the lifting point.
        static, dynamic: friction coefficients (Table 1).
        stribeck_mm_s: speed w_s of the transition between them.
        viscous_n_s_m: damping d at the lifting point.
    """

    __slots__ = ("_damping", "_drop", "_dynamic", "_mass", "_static", "_stribeck", "position_mm", "speed_mm_s")

    def __init__(
        self, mass_kg: float, static: float, dynamic: float, stribeck_mm_s: float, viscous_n_s_m: float
    ) -> None:
        self._mass = mass_kg
        self._static = static
        self._dynamic = dynamic
        self._drop = static - dynamic
        self._stribeck = stribeck_mm_s
        self._damping = viscous_n_s_m / mass_kg
        self.position_mm = 0.0
        self.speed_mm_s = 0.0

    def step(self, h_s: float, force_n: float, load_n: float) -> None:
        """One semi-implicit step of ``h_s`` under the rope's tangential force and vertical load."""
        speed = self.speed_mm_s
        held = abs(force_n) <= self._static * load_n
        if speed == 0.0:
            if held:
                return
            friction = math.copysign(self._static * load_n, force_n)
        else:
            ratio = speed / self._stribeck
            mu = self._dynamic + self._drop * math.exp(-ratio * ratio)
            friction = math.copysign(mu * load_n, speed)
        moved = (speed + h_s * MM_PER_M * (force_n - friction) / self._mass) / (1.0 + h_s * self._damping)
        if held and (moved * speed < 0.0 or abs(moved) < _AT_REST_MM_S):
            moved = 0.0  # came to rest within this step, and friction can hold it
        self.speed_mm_s = moved
        self.position_mm += h_s * moved
