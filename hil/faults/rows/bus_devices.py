"""The devices on the bus, and the faults that any of them can have."""

from __future__ import annotations

from dataclasses import dataclass, field

from hil.faults import in_device, on_bus
from hil.faults.expected import HOLD, NO_HEARTBEAT_MS, RIDE, Around, InjectedFault
from hil.faults.stand import FindNode, Injector
from rigctl.config.io_section import IoSettings
from rigctl.devices.objects import EmcyCode


@dataclass(frozen=True)
class BusDevice:
    """A device, and its rows of the catalogue."""

    id: str
    name: str
    find: FindNode
    missed_ms: float
    """From its last sample to the reaction."""
    data: str = "samples"
    around: Around = field(default_factory=Around)

    def silent(self, what: str = "") -> InjectedFault:
        """Its samples are lost."""
        what = what or f"{self.name}'s {self.data} stop"
        return self._lost("silent", what, on_bus.silent(self.find), self.missed_ms)

    def length_wrong(self, what: str) -> InjectedFault:
        """Its samples are too short."""
        injector = on_bus.cut(self.find, 1.0)
        return self._lost("length_wrong", what, injector, self.missed_ms, counter="frames_refused")

    def reboots(self, name: str = "") -> InjectedFault:
        """It restarts, and waits to be configured."""
        return self._lost("reboots", f"{name or self.name} starts anew", in_device.reboots(self.find), 20)

    def nmt_stopped(self, name: str = "") -> InjectedFault:
        """Its samples stop with its state."""
        injector = on_bus.nmt(on_bus.NMT_STOP, self.find)
        return self._lost("nmt_stopped", f"another master stops {name or self.name}", injector, self.missed_ms)

    def nmt_preop(self) -> InjectedFault:
        """Its samples stop, its heartbeat goes on."""
        injector = on_bus.nmt(on_bus.NMT_PRE_OPERATIONAL, self.find)
        return self._lost("nmt_preop", f"another master takes {self.name} to pre-operational", injector, self.missed_ms)

    def no_heartbeat(self) -> InjectedFault:
        """Its samples go on."""
        what = f"{self.name} sends no heartbeat any more, its {self.data} go on"
        return self._lost("no_heartbeat", what, in_device.no_heartbeat(self.find), NO_HEARTBEAT_MS)

    def emergency(
        self, what: str, id_: str = "emergency", code: int = EmcyCode.SENSOR_INVALID, register: int = 1
    ) -> InjectedFault:
        """It reports an error and goes on."""
        return self._lost(id_, what, on_bus.emergency(self.find, code, register), 10)

    def emergency_vendor(self, and_then: str) -> InjectedFault:
        """It reports an error that no standard names."""
        what = f"an emergency message of its maker's own (0xFF10, register 0x81), {and_then}"
        return self.emergency(what, "emergency_vendor", 0xFF10, 0x81)

    def emergency_none(self) -> InjectedFault:
        """It reports that it has no error."""
        what = "an emergency message that says no error (0x00FF, register 0)"
        return InjectedFault(f"{self.id}_emergency_none", what, on_bus.emergency(self.find, 0x00FF, 0), RIDE)

    def _lost(self, id_: str, what: str, injector: Injector, within_ms: float, *, counter: str = "") -> InjectedFault:
        """A row of a device without which the rig does not go on."""
        return InjectedFault(
            f"{self.id}_{id_}", what, injector, HOLD, within_ms=within_ms, counter=counter, around=self.around
        )


AMPLIFIER = BusDevice("cell", "the cell", on_bus.cell, 20)
INCLINOMETER = BusDevice("slope", "the inclinometer", on_bus.slope, 120)
CYLINDER_DRIVE = BusDevice("drive", "the drive", on_bus.drive, 20)
_FITTED = Around(change=(("io", IoSettings(e_stop_input=0)),))
IO_NODE = BusDevice("io", "the I/O node", on_bus.io, 120.0, "inputs", _FITTED)
