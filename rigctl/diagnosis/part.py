"""Which parts hang with the load, leave it loose, or are a device of the rig file."""

from __future__ import annotations

from rigctl.model.events import EACH_SECOND
from rigctl.model.faults import Fault, Trait
from rigctl.model.parts import Part
from rigctl.model.signals import WATCHED

AT_THE_LOAD = frozenset({Part.CELL, Part.AMPLIFIER, Part.SECOND_FORCE, Part.INCLINOMETER})
"""Parts that hang with the load: whoever is sent to one of them stands at the load."""
LOAD_IS_LOOSE = frozenset({Part.ROPE, Part.PAYLOAD, Part.BRAKE})
"""Parts whose fault leaves the load down, moving, or about to."""
OF_DEVICE = {
    "tension_cell": Part.AMPLIFIER,
    "inclinometer": Part.INCLINOMETER,
    "cylinder": Part.DRIVE,
    "io": Part.IO_NODE,
    "second_force": Part.SECOND_FORCE,
}
"""By the device's section in the rig file."""
FROM_BUS = frozenset({
    *(fault.name for fault in Fault if Trait.DEVICE_SILENT in fault.traits), Fault.DRIVE_UNASKED.name,
    Fault.LIMIT_UNSEEN.name, *EACH_SECOND, "SETTING_LOST",
    *(f"{Fault.LIMIT.name} {signal} above" for signal in WATCHED if signal.endswith("_age_ms") or "frames" in signal),
})  # fmt: skip
"""Alarms of a bus that carries nothing, by their cause: a device that is not heard shows neither that it has gone off
nor that it keeps its settings. None of them has a cause of its own while the bus is the culprit."""
