"""Two-axis inclinometer, CiA 410: the rope's angles at the sensor's own rate, filtered and quantised."""

from __future__ import annotations

from hil.nodes.dictionary import Abort, number, refuse
from hil.nodes.inclination_measurement import InclinationMeasurement
from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.plant import Plant
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import SimulationSettings
from rigctl.devices import objects
from rigctl.devices.objects import EmcyCode

SERIAL = 410001
RESOLUTIONS_MDEG = frozenset({10, 100, 1000})
_SENSOR_ERROR = 0x81  # error register: device specific, generic


class Inclinometer(Node):
    """Slope long (0x6010) is the tangential angle, slope lateral (0x6020) the normal one."""

    def __init__(
        self, network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant
    ) -> None:
        sensor = settings.inclinometer
        clock_ppm = simulation.inclinometer.clock_ppm
        super().__init__(network, sensor.node, settings.file(sensor.eds), plant, SERIAL, clock_ppm)
        self._measurement = InclinationMeasurement(settings, simulation, plant)
        self._resolution_mdeg = objects.SLOPE_RESOLUTION_MDEG
        self.readers[objects.SLOPE_LONG, 0] = lambda: self._slope(0)
        self.readers[objects.SLOPE_LATERAL, 0] = lambda: self._slope(1)
        self.writers[objects.SLOPE_RESOLUTION, 0] = self._set_resolution

    def on_node_reset(self) -> None:
        """Take the default resolution."""
        self._resolution_mdeg = number(self.device, objects.SLOPE_RESOLUTION)

    def advance(self, t_ns: int) -> None:
        """Filter, and measure when it is due."""
        if not self._measurement.advance(t_ns):
            return
        if self._measurement.angles_deg is None:
            self.raise_error(EmcyCode.SENSOR_INVALID, _SENSOR_ERROR)
        else:
            self.clear_error(EmcyCode.SENSOR_INVALID)

    def _slope(self, axis: int) -> int:
        angles_deg = self._measurement.angles_deg
        if angles_deg is None:
            return objects.SLOPE_INVALID
        return round(angles_deg[axis] * 1000.0 / self._resolution_mdeg)

    def _set_resolution(self, value: int) -> None:
        if value not in RESOLUTIONS_MDEG:
            raise refuse(Abort.VALUE_RANGE)
        self._resolution_mdeg = value
