"""The cylinder's motor as its drive measures it: current from the load it carries, and the temperature that follows."""

from __future__ import annotations

import math

from rigctl.config.simulation_section import DriveSettings
from rigctl.devices import objects

_INT16_MAX = 0x7FFF


class Motor:
    """Current and temperature; call ``advance`` once per period of the drive's own loop.

    Args:
        drive: force constant, friction, and the slow thermal model.
        rated_ma: 0x6075; the current is reported in thousandths of it.
    """

    def __init__(self, drive: DriveSettings, rated_ma: int) -> None:
        self._drive = drive
        self._rated_a = rated_ma * objects.A_PER_RATED_CURRENT_UNIT
        self._t_ns: int | None = None
        self.current_a = 0.0
        self.temperature_c = drive.ambient_c

    def advance(self, t_ns: int, force_n: float, speed_mm_s: float) -> None:
        """Carry ``force_n`` at ``speed_mm_s`` up to ``t_ns``; friction adds current going up, saves it going down."""
        drive = self._drive
        friction_n = math.copysign(drive.friction_n, speed_mm_s) if speed_mm_s else 0.0
        self.current_a = (force_n + friction_n) / drive.force_n_a
        if self._t_ns is not None:
            final_c = drive.ambient_c + drive.heating_c_a2 * self.current_a**2
            share = (t_ns - self._t_ns) * 1e-9 / drive.thermal_s
            self.temperature_c += (final_c - self.temperature_c) * min(share, 1.0)
        self._t_ns = t_ns

    @property
    def current_units(self) -> int:
        """Object 0x6078."""
        units = round(self.current_a / (self._rated_a * objects.PER_CURRENT_UNIT))
        return min(max(units, -_INT16_MAX), _INT16_MAX)

    @property
    def temperature_units(self) -> int:
        """Object 0x2045."""
        return round(self.temperature_c / objects.C_PER_TEMPERATURE_UNIT)
