"""Sensors with plain frames: no node id, no SYNC, no start-up; they send by their own clock from power-on."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable

from hil.nodes.clock import DeviceClock
from hil.nodes.inclination_measurement import InclinationMeasurement
from hil.nodes.tension_measurement import TensionMeasurement
from hil.plant import Plant
from hil.wire import FRAME
from rigctl.config.plain import PlainMessage
from rigctl.config.settings import RigSettings
from rigctl.config.simulation_section import SimulationSettings


class PlainSensor(abc.ABC):
    """A sensor that sends its message at its cycle time on its own ``clock``; ``advance`` runs on the rig's grid.

    ``connected`` False is a pulled plug; with ``able`` False the sensor reports that it cannot measure, if its message
    has a signal for that.

    Args:
        send: puts a 16-byte frame on the bus.
        message: from the DBC file.
        settings: for the loop's rate, at which a message without cycle time is sent.
        plant: the plant that is measured.
        clock_ppm: gain of its clock on the rig's.
    """

    def __init__(
        self,
        send: Callable[[bytes], None],
        message: PlainMessage,
        settings: RigSettings,
        plant: Plant,
        clock_ppm: float,
    ) -> None:
        self.clock = DeviceClock(plant.t_ns, clock_ppm)
        self.connected = True
        self.able = True
        self._send = send
        self._message = message
        self._cycle_ns = round(1e9 / message.rate_hz(settings.loop.rate_hz))
        self._due_ns = plant.t_ns + self._cycle_ns

    @abc.abstractmethod
    def values(self) -> dict[str, float]:
        """Values of the next frame by meaning (N, rad, and ``valid``)."""

    def advance(self, t_ns: int) -> None:
        """Measure and send as often as was due since the last step."""
        while self._due_ns <= t_ns:
            self._due_ns += self._cycle_ns
            values = self.values()
            if not self.able:
                values["valid"] = 0.0
            if self.connected:
                message = self._message
                self._send(FRAME.pack(message.can_id, message.size, message.payload(values)))


class PlainTensionCell(PlainSensor):
    """The tension cell; beyond its rated range it stays there and is not valid."""

    def __init__(
        self,
        send: Callable[[bytes], None],
        message: PlainMessage,
        settings: RigSettings,
        simulation: SimulationSettings,
        plant: Plant,
    ) -> None:
        super().__init__(send, message, settings, plant, simulation.cell.clock_ppm)
        self._measurement = TensionMeasurement(settings, simulation, plant)

    def hang(self, weight_n: float) -> None:
        """Hang a known weight on the cell beside the rope; 0 takes it off."""
        self._measurement.hang(weight_n)

    def advance(self, t_ns: int) -> None:
        """Follow the tension, then send as every sensor does."""
        self._measurement.advance()
        super().advance(t_ns)

    def values(self) -> dict[str, float]:
        """A new sample."""
        status, tension_n = self._measurement.sample()
        return {"tension": tension_n, "valid": float(not status)}


class PlainInclinometer(PlainSensor):
    """The inclinometer: measures at ``inclinometer.rate_hz``, sends at the message's cycle time."""

    def __init__(
        self,
        send: Callable[[bytes], None],
        message: PlainMessage,
        settings: RigSettings,
        simulation: SimulationSettings,
        plant: Plant,
    ) -> None:
        super().__init__(send, message, settings, plant, simulation.inclinometer.clock_ppm)
        self._measurement = InclinationMeasurement(settings, simulation, plant)

    def advance(self, t_ns: int) -> None:
        """Filter, then send as every sensor does."""
        self._measurement.advance(t_ns)
        super().advance(t_ns)

    def values(self) -> dict[str, float]:
        """The newest angles."""
        angles_deg = self._measurement.angles_deg
        if angles_deg is None:
            return {"valid": 0.0}
        tangential, normal = map(math.radians, angles_deg)
        return {"tangential": tangential, "normal": normal, "valid": 1.0}
