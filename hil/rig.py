"""The simulated rig: plant and devices behind one port of the bus. It has no clock, socket or thread."""

from __future__ import annotations

import math
from collections.abc import Callable

from hil.nodes.clock import GRID_NS
from hil.nodes.cylinder_drive import CylinderDrive
from hil.nodes.inclinometer import Inclinometer
from hil.nodes.io_node import IoNode
from hil.nodes.network import RigNetwork
from hil.nodes.node import Node
from hil.nodes.plain_sensors import PlainInclinometer, PlainTensionCell
from hil.nodes.rail_encoder import RailEncoder
from hil.nodes.second_force import second_force_node
from hil.nodes.simulator import Simulator
from hil.nodes.tension_amplifier import TensionAmplifier
from hil.plant import Plant
from hil.plant.layout import MECHANISM
from hil.plant.moves import out_and_back
from hil.truth import Truth, TruthLog
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import SimulationSettings


class SimulatedRig:
    """Lockstep and real time both call ``advance``, then ``receive`` for every frame, then ``supervise``.

    Args:
        settings: a rig file with a ``simulation`` section.
        start_ns: time at which the rig is switched on.
        send: puts a 16-byte frame on the bus; called from within all three.
        longest_silence_ns: most that one gap between ``supervise`` calls counts as silence of the controller; set it
            where this process itself may be paused, so that its own pause is not blamed on the controller.
        truth_log: receives the truth once per ``GRID_NS``.

    Raises:
        ValueError: no ``simulation`` section.
        OSError: an EDS file cannot be read.
    """

    def __init__(
        self,
        settings: RigSettings,
        start_ns: int,
        send: Callable[[bytes], None],
        *,
        longest_silence_ns: int | None = None,
        truth_log: TruthLog | None = None,
    ) -> None:
        self.plant = Plant(settings, start_ns)
        simulation = settings.simulation
        assert simulation is not None  # Plant raises without it
        self._demo = settings.demo
        self._grid_ns = start_ns
        self._supervised_ns = start_ns
        self._longest_silence_ns = longest_silence_ns
        self._truth_log = truth_log
        self._network = network = RigNetwork(send)
        self.cell, self.inclinometer = self._sensors(settings, simulation)
        self.drive = CylinderDrive(network, settings, simulation, self.plant)
        self.io = IoNode(network, settings, self.plant, self.drive) if settings.io else None
        io = (self.io,) if self.io else ()
        self._devices = (self.cell, self.drive, self.inclinometer, *io)
        eds = settings.file(settings.cylinder.eds).with_name("simulator.eds")
        self.simulator = Simulator(network, eds, self.plant, self.start_motion, self.drive, self.io)
        self.rail_encoder = RailEncoder(network, settings, self.plant) if settings.rail_encoder else None
        self.second_force = second_force_node(network, settings, simulation, self.plant)
        encoders: tuple[Node, ...] = (self.rail_encoder,) if self.rail_encoder else ()
        encoders += (self.second_force,) if self.second_force else ()
        self.nodes = (*(device for device in self._devices if isinstance(device, Node)), *encoders, self.simulator)
        self.receive = network.receive
        for node in self.nodes:
            if node is not self.simulator:
                node.behave(simulation.devices)
            node.reset_node()

    @property
    def truth(self) -> Truth:
        """The plant's true state now."""
        return self.plant.truth

    def advance(self, t_ns: int) -> None:
        """Advance the plant and the devices' own clocks to ``t_ns``."""
        plant = self.plant
        while self._grid_ns + GRID_NS <= t_ns:
            self._grid_ns += GRID_NS
            plant.advance(self._grid_ns)
            for device in self._devices:
                device.advance(device.clock.local_ns(self._grid_ns))
            if self._truth_log is not None:
                self._truth_log.append(plant.truth)
        plant.advance(t_ns)

    def supervise(self, t_ns: int) -> None:
        """Send the heartbeats that are due and check the controller's silence, after all frames have been received."""
        elapsed_ns = t_ns - self._supervised_ns
        self._supervised_ns = t_ns
        if self._longest_silence_ns is not None:
            elapsed_ns = min(elapsed_ns, self._longest_silence_ns)
        for node in self.nodes:
            node.supervise(node.clock.local_ns(t_ns), elapsed_ns)

    def hang(self, weight_n: float) -> None:
        """Hang a known weight on the rope, felt by the cell and the second force path; 0 takes it off."""
        self.cell.hang(weight_n)
        if self.second_force is not None:
            self.second_force.hang(weight_n)

    def start_motion(self) -> bool:
        """Start the move of the ``demo`` section; False while one is under way or without that section."""
        if self._demo is None or self.plant.moving:
            return False
        angles = (self._demo.angle_deg, self._demo.speed_deg_s, self._demo.acceleration_deg_s2)
        self.plant.start_motion({MECHANISM: out_and_back(*map(math.radians, angles))}, self.plant.t_ns)
        return True

    def _sensors(
        self, settings: RigSettings, simulation: SimulationSettings
    ) -> tuple[TensionAmplifier | PlainTensionCell, Inclinometer | PlainInclinometer]:
        """The two sensors, CANopen or with the plain frames of their DBC files."""
        network, plant, plain = self._network, self.plant, settings.plain_messages
        cell: TensionAmplifier | PlainTensionCell
        slope: Inclinometer | PlainInclinometer
        if "tension_cell" in plain:
            cell = PlainTensionCell(network.send_frame, plain["tension_cell"], settings, simulation, plant)
        else:
            cell = TensionAmplifier(network, settings, simulation, plant)
        if "inclinometer" in plain:
            message = plain["inclinometer"]
            slope = PlainInclinometer(network.send_frame, message, settings, simulation, plant)
        else:
            slope = Inclinometer(network, settings, simulation, plant)
        return cell, slope
