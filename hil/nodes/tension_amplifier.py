"""Tension amplifier, CiA 404: the rope's tension at its upper end, with noise, resolution and overload."""

from __future__ import annotations

import random

from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.plant import Plant
from rigctl.config import RigSettings, SimulationSettings
from rigctl.devices import objects
from rigctl.devices.objects import AiStatus

SERIAL = 404001
_GOOD = AiStatus(0)


class TensionAmplifier(Node):
    """Samples the tension at every SYNC (0x9130:01 in mN, 0x6150:01 status)."""

    def __init__(
        self, network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant
    ) -> None:
        cell = settings.tension_cell
        super().__init__(network, cell.node, settings.file(cell.eds), plant, SERIAL)
        self._gauss = random.Random(f"{simulation.seed}:tension").gauss
        self._noise_n = cell.noise_n
        self._range_n = cell.range_n
        self._quantum_n = simulation.cell_quantum_n
        self._value = 0
        self._status = _GOOD
        self.readers[objects.AI_PROCESS_VALUE, 1] = lambda: self._value
        self.readers[objects.AI_STATUS, 1] = lambda: self._status

    def on_sample(self) -> None:
        """Measure: noise, then saturation at the rated range, then resolution."""
        tension = self.plant.truth.tension_n + self._gauss(0.0, self._noise_n)
        self._status, tension = saturate(tension, self._range_n)
        steps = round(tension / self._quantum_n)
        self._value = round(steps * self._quantum_n / objects.N_PER_CELL_UNIT)


def saturate(tension_n: float, range_n: float) -> tuple[AiStatus, float]:
    """Status and reading of an amplifier with a range of +-``range_n``."""
    if tension_n > range_n:
        return AiStatus.POSITIVE_OVERLOAD, range_n
    if tension_n < -range_n:
        return AiStatus.NEGATIVE_OVERLOAD, -range_n
    return _GOOD, tension_n
