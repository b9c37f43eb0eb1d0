"""A simulated rig on a hub whose time passes only while a start-up waits for its devices."""

from __future__ import annotations

from collections.abc import Callable

from hil.bus import InProcessBus
from hil.hub import Hub
from hil.rig import SimulatedRig
from rigctl.config.settings import RigSettings
from rigctl.devices import startup

START_NS = 1_000_000_000
STEP_NS = 1_000_000


class RigOnHub:
    """A rig that is switched on."""

    def __init__(self, settings: RigSettings) -> None:
        self.settings = settings
        self.t_ns = START_NS
        self.said: list[str] = []
        self.hub = Hub(lambda: self.t_ns)
        self.port = self.hub.attach(self.take)
        self.rig = SimulatedRig(settings, START_NS, self.port.send)

    def take(self, frame: bytes) -> None:
        """A frame reaches the rig."""
        self.rig.receive(frame)

    def bus(self) -> InProcessBus:
        """A program's connection, whose waits let time pass."""
        return InProcessBus(self.hub, pass_time=self._pass_time)

    def bring_up(self) -> startup.StartupReport:
        """Start the devices as the control process does; ``said`` has the lines about waits."""
        self.said.clear()
        bus = self.bus()
        try:
            return startup.bring_up(bus, self.settings, lambda: self.t_ns, self.said.append)
        finally:
            bus.shutdown()

    def _pass_time(self, arrived: Callable[[], bool], seconds: float) -> None:
        end_ns = self.t_ns + round(seconds * 1e9)
        while self.t_ns < end_ns and not arrived():
            self.t_ns = min(self.t_ns + STEP_NS, end_ns)
            self.rig.advance(self.t_ns)
            self.rig.supervise(self.t_ns)
