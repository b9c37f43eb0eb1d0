"""Two-axis inclinometer, CiA 410: the rope's angles at a rate of its own, filtered and quantised."""

from __future__ import annotations

import math
import random

from hil.nodes.dictionary import Abort, number, refuse
from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.plant import Plant
from rigctl.config import RigSettings, SimulationSettings
from rigctl.devices import objects
from rigctl.devices.objects import EmcyCode

SERIAL = 410001
RESOLUTIONS_MDEG = frozenset({10, 100, 1000})
_SENSOR_ERROR = 0x81  # error register: device specific, generic


class Inclinometer(Node):
    """Slope long (0x6010) is the tangential angle, slope lateral (0x6020) the normal one.

    ``advance`` must be called once per ``filter_step_ns``.
    """

    def __init__(
        self,
        network: RigNetwork,
        settings: RigSettings,
        simulation: SimulationSettings,
        plant: Plant,
        filter_step_ns: int,
    ) -> None:
        sensor = settings.inclinometer
        super().__init__(network, sensor.node, settings.file(sensor.eds), plant, SERIAL)
        self._gauss = random.Random(f"{simulation.seed}:inclination").gauss
        self._noise_deg = simulation.inclinometer_noise_deg
        self._quantum_deg = simulation.inclinometer_quantum_deg
        self._range_deg = sensor.range_deg
        self._blend = 1.0 - math.exp(-2.0 * math.pi * simulation.inclinometer_filter_hz * filter_step_ns * 1e-9)
        self._rate_hz = sensor.rate_hz
        self._start_ns = plant.t_ns
        self._samples = 0
        self._filtered_rad = (0.0, 0.0)
        self._measured_deg: tuple[float, float] | None = (0.0, 0.0)
        self._resolution_mdeg = objects.SLOPE_RESOLUTION_MDEG
        self.readers[objects.SLOPE_LONG, 0] = lambda: self._slope(0)
        self.readers[objects.SLOPE_LATERAL, 0] = lambda: self._slope(1)
        self.writers[objects.SLOPE_RESOLUTION, 0] = self._set_resolution

    def on_node_reset(self) -> None:
        """Take the default resolution."""
        self._resolution_mdeg = number(self.device, objects.SLOPE_RESOLUTION)

    def advance(self, t_ns: int) -> None:
        """Filter one step; on the sensor's own clock, measure."""
        truth = self.plant.truth
        long, lateral = self._filtered_rad
        long += self._blend * (truth.tangential_rad - long)
        lateral += self._blend * (truth.normal_rad - lateral)
        self._filtered_rad = long, lateral
        if (t_ns - self._start_ns) * self._rate_hz >= self._samples * 1_000_000_000:
            self._samples = (t_ns - self._start_ns) * self._rate_hz // 1_000_000_000 + 1
            self._measure(math.degrees(long), math.degrees(lateral))

    def _measure(self, *angles_deg: float) -> None:
        noisy = [angle + self._gauss(0.0, self._noise_deg) for angle in angles_deg]
        if max(map(abs, noisy)) > self._range_deg:
            self._measured_deg = None
            self.raise_error(EmcyCode.SENSOR_INVALID, _SENSOR_ERROR)
            return
        long, lateral = (round(angle / self._quantum_deg) * self._quantum_deg for angle in noisy)
        self._measured_deg = long, lateral
        self.clear_error(EmcyCode.SENSOR_INVALID)

    def _slope(self, axis: int) -> int:
        if self._measured_deg is None:
            return objects.SLOPE_INVALID
        return round(self._measured_deg[axis] * 1000.0 / self._resolution_mdeg)

    def _set_resolution(self, value: int) -> None:
        if value not in RESOLUTIONS_MDEG:
            raise refuse(Abort.VALUE_RANGE)
        self._resolution_mdeg = value
