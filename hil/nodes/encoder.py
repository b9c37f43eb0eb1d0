"""The motor's encoder: the drive's own measurement of the stroke."""

from __future__ import annotations

from hil.plant import Plant


class Encoder:
    """Position and speed as the drive reports them; call ``advance`` once per period of its speed measurement.

    It sits on the motor, so that ripple of the screw and play of the nut are hidden from it. Speed is the difference of
    two positions over the period between them: a mean, half a period old at each ``advance``. A perfect encoder
    (``step_mm`` 0) has the exact position and speed.

    Args:
        plant: the motor's plant.
        step_mm: resolution, as stroke.
    """

    def __init__(self, plant: Plant, step_mm: float) -> None:
        self._plant = plant
        self._step_mm = step_mm
        self._at_ns = plant.t_ns
        self._at_mm = self.position_mm
        self._speed_mm_s = 0.0

    @property
    def position_mm(self) -> float:
        """Stroke by the motor's position."""
        state = self._plant.state[0]
        position = self._plant.truth.stroke_mm - float(state["stroke"] - state["motor"])
        return round(position / self._step_mm) * self._step_mm if self._step_mm else position

    @property
    def speed_mm_s(self) -> float:
        """Stroke speed by the motor's position."""
        return self._speed_mm_s if self._step_mm else self._plant.truth.speed_mm_s

    def advance(self) -> None:
        """Take the position for the next speed."""
        elapsed_ns = self._plant.t_ns - self._at_ns
        if self._step_mm and elapsed_ns > 0:
            position = self.position_mm
            self._speed_mm_s = (position - self._at_mm) / (elapsed_ns * 1e-9)
            self._at_ns = self._plant.t_ns
            self._at_mm = position
