"""The second force path: a second cell in the rope, or the linear encoder below its spring."""

from __future__ import annotations

import random

from hil.nodes.dictionary import number
from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.plant import Plant
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import SimulationSettings
from rigctl.devices import objects
from rigctl.devices.objects import AiStatus

CELL_SERIAL, ENCODER_SERIAL = 404002, 406002
ORIGIN_MM = 1000.0  # what the encoder shows at stroke 0: it counts from its end
ROOM_C = 20.0  # its temperature channel
_NS_PER_H = 3_600_000_000_000


class SecondForceNode(Node):
    """Its force: the rope's, and a weight hung beside it, with errors of zero, gain and drift.

    ``fault_n``: added to the force, for a fault that begins while it runs.
    """

    fault_n = 0.0

    def __init__(
        self, network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant, serial: int
    ) -> None:
        section = settings.second_force
        assert section is not None  # there is no node without it
        super().__init__(network, section.node, settings.file(section.eds), plant, serial)
        self._section, self._wrong = section, simulation.second_force
        self._start_ns, self._hung_n = plant.t_ns, 0.0

    def hang(self, weight_n: float) -> None:
        """Hang a known weight on the rope; 0 takes it off."""
        self._hung_n = weight_n

    @property
    def felt_n(self) -> float:
        """The force with this path's errors."""
        errors, plant = self._wrong, self.plant
        drift_n = errors.drift_n_h * (plant.t_ns - self._start_ns) / _NS_PER_H
        load_n = plant.truth.tension_n + self._hung_n
        return (1.0 + errors.gain_pct / 100.0) * load_n + errors.bias_n + drift_n + self.fault_n


class SecondCell(SecondForceNode):
    """Samples the force at every SYNC (0x9130:01 in mN, 0x6150:01 status)."""

    def __init__(
        self, network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant
    ) -> None:
        super().__init__(network, settings, simulation, plant, CELL_SERIAL)
        self._gauss = random.Random(f"{simulation.seed}:second force").gauss
        self._value = 0
        self.readers[objects.AI_PROCESS_VALUE, 1] = lambda: self._value
        self.readers[objects.AI_STATUS, 1] = lambda: AiStatus(0)
        self.readers[objects.AI_PROCESS_VALUE, 2] = lambda: round(ROOM_C / objects.C_PER_CELL_UNIT)
        self.readers[objects.AI_STATUS, 2] = lambda: AiStatus(0)

    def on_sample(self) -> None:
        """Measure."""
        felt_n = self.felt_n + self._gauss(0.0, self._wrong.noise_n)
        self._value = round(felt_n / objects.N_PER_CELL_UNIT)


class StretchEncoder(SecondForceNode):
    """Samples the spring's lower end at every SYNC (0x6004, in steps of 0x6005:01): the stroke less the stretch."""

    def __init__(
        self, network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant
    ) -> None:
        super().__init__(network, settings, simulation, plant, ENCODER_SERIAL)
        self._n_mm = _spring_n_mm(self._section)
        self._gauss = random.Random(f"{simulation.seed}:stretch").gauss
        self._step_nm = self._position = 0
        self.readers[objects.ENCODER_POSITION, 0] = lambda: self._position
        self.writers[objects.ENCODER_STEP, 1] = self._set_step

    def on_node_reset(self) -> None:
        """Take the default step."""
        self._step_nm = number(self.device, objects.ENCODER_STEP, 1)

    def on_sample(self) -> None:
        """Count the place of the lower end."""
        place_mm = ORIGIN_MM + self.plant.truth.stroke_mm - self.felt_n / self._n_mm
        place_mm += self._gauss(0.0, self._section.noise_um * 1e-3)
        self._position = int(place_mm * objects.NM_PER_MM // self._step_nm)

    def _set_step(self, value: int) -> None:
        self._step_nm = value


def _spring_n_mm(section: SecondForceSettings) -> float:
    assert section.spring_n_mm is not None  # the settings require it for a stretch
    return section.spring_n_mm


def second_force_node(
    network: RigNetwork, settings: RigSettings, simulation: SimulationSettings, plant: Plant
) -> SecondCell | StretchEncoder | None:
    """The node of the rig file; None without its section."""
    if settings.second_force is None:
        return None
    kind = SecondCell if settings.second_force.kind == "cell" else StretchEncoder
    return kind(network, settings, simulation, plant)
