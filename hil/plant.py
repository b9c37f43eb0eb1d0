"""The first plant: series spring and rope, cylinder, and the rail's tangential stick-slip.

The mechanism's angle is prescribed (it carries its own height); rail and pulley lag behind on the same circle. Geometry
and equations: ``domain.md``, "What governs it". Units: N, mm, kg, s, so a force over a mass is in m/s2.
"""

from __future__ import annotations

import math

from hil.cylinder import Cylinder
from hil.motion import Motion
from hil.rail import MM_PER_M, Rail
from hil.truth import Truth
from rigctl.config import RigSettings

STOP_MARGIN_MM = 5.0
"""The mechanical stops stand this far outside the commanded stroke."""

MECHANISM_DAMPING_RATIO = 0.02
_STEPS_PER_RADIAN = 4


class Plant:
    """The rig's mechanics, integrated in fixed steps on an absolute grid.

    The state moves on the grid only, so the result depends on when inputs change and not on how ``advance`` is
    chopped up; ``truth`` at a time between grid points is extrapolated from the last one.

    Args:
        settings: needs the ``simulation`` section.
        start_ns: time of the first grid point.

    Raises:
        ValueError: no ``simulation`` section, or a step too long for the mechanism's stiffness.
    """

    def __init__(self, settings: RigSettings, start_ns: int) -> None:
        simulation, plant = settings.simulation, settings.plant
        if simulation is None:
            raise ValueError("simulation: found nothing, allowed a section (it says what rig to simulate)")
        self.t_ns = start_ns
        self._grid_ns = start_ns
        self._step_ns = simulation.step_us * 1000
        self._h = self._step_ns * 1e-9
        self._length = plant.rope_length_mm
        self._radius = plant.radius_mm
        self._stiffness = plant.stiffness_n_mm
        self._damping = simulation.damping_n_s_mm
        self._slack = simulation.slack_mm
        self._mechanism = _mechanism(plant.mechanism_n_mm, plant.payload_kg, self._h)
        self._height = 0.0
        self._climb = 0.0
        self._cylinder = Cylinder(
            self._step_ns,
            plant.cylinder_lag_s,
            plant.command_delay_s,
            simulation.drive_acceleration_mm_s2,
            (settings.cylinder.stroke_min_mm - STOP_MARGIN_MM, settings.cylinder.stroke_max_mm + STOP_MARGIN_MM),
        )
        self._rail = Rail(
            simulation.rail_mass_kg,
            simulation.friction_static,
            simulation.friction_dynamic,
            simulation.stribeck_mm_s,
            simulation.viscous_n_s_m,
        )
        self._motion: Motion | None = None
        self._motion_start_ns = start_ns
        self._truth: Truth | None = None

    @property
    def at_stroke_end(self) -> bool:
        """Whether the cylinder rests against a mechanical stop."""
        return self._cylinder.at_end

    @property
    def moving(self) -> bool:
        """Whether the mechanism's move is under way."""
        return self._motion is not None and self.t_ns < self._motion_start_ns + self._motion.duration_s * 1e9

    @property
    def truth(self) -> Truth:
        """The true state at ``t_ns``."""
        if self._truth is None:
            self._truth = self._look()
        return self._truth

    def set_drive(self, velocity_mm_s: float, braked: bool) -> None:
        """The drive's output from ``t_ns`` on: commanded speed (positive = shorter rope), whether the brake holds."""
        self._cylinder.command(velocity_mm_s, self.t_ns)
        if braked != self._cylinder.braked:
            self._cylinder.braked = braked
            self._truth = None

    def start_motion(self, motion: Motion, t_ns: int) -> None:
        """Prescribe the mechanism's move from ``t_ns`` on (the mechanism is at angle 0)."""
        self._motion = motion
        self._motion_start_ns = t_ns
        self._truth = None

    def advance(self, t_ns: int) -> None:
        """Integrate up to ``t_ns``; an earlier time changes nothing."""
        if t_ns <= self.t_ns:
            return
        step_ns = self._step_ns
        grid_ns = self._grid_ns
        while grid_ns + step_ns <= t_ns:
            self._cylinder.step(grid_ns)
            grid_ns += step_ns
            self._move(grid_ns)
        self._grid_ns = grid_ns
        self.t_ns = t_ns
        self._truth = None

    def _move(self, t_ns: int) -> None:
        """Rail and mechanism over the step that ends at ``t_ns``, under the rope's pull there."""
        angle, speed = self._mechanism_at(t_ns)
        rail, cylinder = self._rail, self._cylinder
        lag = angle - rail.position_mm / self._radius
        lag_speed = speed - rail.speed_mm_s / self._radius
        tension, length = self._rope(lag, lag_speed, cylinder.stroke_mm, cylinder.speed_mm_s, self._height)
        vertical = tension * (self._length - self._height) / length
        rail.step(self._h, tension * self._radius * math.sin(lag) / length, vertical)
        if self._mechanism is not None:
            stiffness, damping, mass = self._mechanism
            force = vertical - stiffness * self._height - damping * self._climb
            self._climb += self._h * MM_PER_M * force / mass
            self._height += self._h * self._climb

    def _rope(
        self, lag: float, lag_speed: float, stroke: float, stroke_speed: float, height: float
    ) -> tuple[float, float]:
        """Tension (N) and distance (mm) between the lifting points, ``l^2 = (L + h)^2 + d_t^2 + d_n^2``.

        ``d_t = R sin(lag)`` and ``d_n = R (1 - cos(lag))``; their squares add up to ``2 R^2 (1 - cos(lag))``.
        """
        vertical = self._length - height
        offset = self._radius * math.sin(0.5 * lag)
        length = math.sqrt(vertical * vertical + 4.0 * offset * offset)
        extension = length - self._length - self._slack + stroke
        if extension <= 0.0:
            return 0.0, length
        stretch_speed = self._radius * self._radius * math.sin(lag) * lag_speed - vertical * self._climb
        rate = stretch_speed / length + stroke_speed
        return max(0.0, self._stiffness * extension + self._damping * rate), length

    def _mechanism_at(self, t_ns: int) -> tuple[float, float]:
        if self._motion is None:
            return 0.0, 0.0
        return self._motion.at((t_ns - self._motion_start_ns) * 1e-9)

    def _look(self) -> Truth:
        rest_s = (self.t_ns - self._grid_ns) * 1e-9
        angle, speed = self._mechanism_at(self.t_ns)
        rail, cylinder = self._rail, self._cylinder
        rail_angle = (rail.position_mm + rail.speed_mm_s * rest_s) / self._radius
        drive_speed = 0.0 if cylinder.braked else cylinder.speed_mm_s
        stroke = cylinder.stroke_mm + drive_speed * rest_s
        height = self._height + self._climb * rest_s
        lag = angle - rail_angle
        tension, length = self._rope(lag, speed - rail.speed_mm_s / self._radius, stroke, drive_speed, height)
        vertical = self._length - height
        return Truth(
            self.t_ns,
            tension,
            tension * vertical / length,
            math.atan2(self._radius * math.sin(lag), vertical),
            math.atan2(2.0 * self._radius * math.sin(0.5 * lag) ** 2, vertical),
            stroke,
            drive_speed,
            angle,
            rail_angle,
            self.moving,
        )


def _mechanism(stiffness_n_mm: float | None, mass_kg: float, h_s: float) -> tuple[float, float, float] | None:
    """Stiffness (N/mm), damping (N s/mm) and mass (kg) of the mechanism's vertical spring; None = rigid."""
    if stiffness_n_mm is None:
        return None
    frequency_rad_s = math.sqrt(stiffness_n_mm * MM_PER_M / mass_kg)
    if frequency_rad_s * h_s * _STEPS_PER_RADIAN > 1.0:
        longest_us = 1e6 / (frequency_rad_s * _STEPS_PER_RADIAN)
        raise ValueError(
            f"simulation.step_us: found {h_s * 1e6:.0f}, allowed at most {longest_us:.0f} "
            f"with plant.mechanism_n_mm {stiffness_n_mm:g}"
        )
    return stiffness_n_mm, 2.0 * MECHANISM_DAMPING_RATIO * mass_kg * frequency_rad_s / MM_PER_M, mass_kg
