"""What the sensors make of the truth, whatever protocol they speak: noise, range, filter, resolution."""

from __future__ import annotations

import math
import random

from hil.plant import Plant
from rigctl.config import RigSettings, SimulationSettings
from rigctl.devices.objects import AiStatus

_GOOD = AiStatus(0)


class TensionMeasurement:
    """The rope's tension at its upper end, sampled when asked."""

    def __init__(self, settings: RigSettings, simulation: SimulationSettings, plant: Plant) -> None:
        self._plant = plant
        self._gauss = random.Random(f"{simulation.seed}:tension").gauss
        self._noise_n = settings.tension_cell.noise_n
        self._range_n = settings.tension_cell.range_n
        self._quantum_n = simulation.cell_quantum_n

    def sample(self) -> tuple[AiStatus, float]:
        """Status and reading in N: noise, then saturation at the rated range, then resolution."""
        tension = self._plant.truth.tension_n + self._gauss(0.0, self._noise_n)
        status, tension = saturate(tension, self._range_n)
        return status, round(tension / self._quantum_n) * self._quantum_n


def saturate(tension_n: float, range_n: float) -> tuple[AiStatus, float]:
    """Status and reading of an amplifier with a range of +-``range_n``."""
    if tension_n > range_n:
        return AiStatus.POSITIVE_OVERLOAD, range_n
    if tension_n < -range_n:
        return AiStatus.NEGATIVE_OVERLOAD, -range_n
    return _GOOD, tension_n


class InclinationMeasurement:
    """The rope's angles, low-pass filtered, at a rate of their own; ``advance`` goes once per ``filter_step_ns``."""

    def __init__(
        self, settings: RigSettings, simulation: SimulationSettings, plant: Plant, filter_step_ns: int
    ) -> None:
        sensor = settings.inclinometer
        self._plant = plant
        self._gauss = random.Random(f"{simulation.seed}:inclination").gauss
        self._noise_deg = simulation.inclinometer_noise_deg
        self._quantum_deg = simulation.inclinometer_quantum_deg
        self._range_deg = sensor.range_deg
        self._blend = 1.0 - math.exp(-2.0 * math.pi * simulation.inclinometer_filter_hz * filter_step_ns * 1e-9)
        self._rate_hz = sensor.rate_hz
        self._start_ns = plant.t_ns
        self._samples = 0
        self._filtered_rad = (0.0, 0.0)
        self.angles_deg: tuple[float, float] | None = (0.0, 0.0)
        """Tangential and normal angle as last measured; None beyond the range."""

    def advance(self, t_ns: int) -> bool:
        """Filter one step; on the sensor's own clock, measure. Whether it has measured."""
        truth = self._plant.truth
        long, lateral = self._filtered_rad
        long += self._blend * (truth.tangential_rad - long)
        lateral += self._blend * (truth.normal_rad - lateral)
        self._filtered_rad = long, lateral
        if (t_ns - self._start_ns) * self._rate_hz < self._samples * 1_000_000_000:
            return False
        self._samples = (t_ns - self._start_ns) * self._rate_hz // 1_000_000_000 + 1
        self._measure(math.degrees(long), math.degrees(lateral))
        return True

    def _measure(self, *angles_deg: float) -> None:
        noisy = [angle + self._gauss(0.0, self._noise_deg) for angle in angles_deg]
        if max(map(abs, noisy)) > self._range_deg:
            self.angles_deg = None
            return
        long, lateral = (round(angle / self._quantum_deg) * self._quantum_deg for angle in noisy)
        self.angles_deg = long, lateral
