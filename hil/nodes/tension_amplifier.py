"""Tension amplifier, CiA 404: the rope's tension at its upper end, with the errors of cell and amplifier."""

from __future__ import annotations

from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.nodes.tension_measurement import TensionMeasurement
from hil.plant import Plant
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import SimulationSettings
from rigctl.devices import objects
from rigctl.devices.objects import AiStatus

SERIAL = 404001
_GOOD = AiStatus(0)


class TensionAmplifier(Node):
    """Samples the tension at every SYNC (0x9130:01 in mN, 0x6150:01 status); 0x9130:02 is the cell's temperature."""

    def __init__(
        self, network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant
    ) -> None:
        cell = settings.tension_cell
        super().__init__(network, cell.node, settings.file(cell.eds), plant, SERIAL, simulation.cell.clock_ppm)
        self._measurement = TensionMeasurement(settings, simulation, plant)
        self._value = 0
        self._status = _GOOD
        self.readers[objects.AI_PROCESS_VALUE, 1] = lambda: self._value
        self.readers[objects.AI_STATUS, 1] = lambda: self._status
        measurement = self._measurement
        self.readers[objects.AI_PROCESS_VALUE, 2] = lambda: round(measurement.temperature_c / objects.C_PER_CELL_UNIT)
        self.readers[objects.AI_STATUS, 2] = lambda: _GOOD

    def hang(self, weight_n: float) -> None:
        """Hang a known weight on the cell beside the rope; 0 takes it off."""
        self._measurement.hang(weight_n)

    def advance(self, _: int) -> None:
        """Follow the tension; SYNC samples it, not the amplifier's clock."""
        self._measurement.advance()

    def on_sample(self) -> None:
        """Measure, and express it in the object's unit."""
        self._status, tension_n = self._measurement.sample()
        self._value = round(tension_n / objects.N_PER_CELL_UNIT)
