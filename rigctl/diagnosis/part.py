"""The parts of a rig that a diagnosis can name."""

from __future__ import annotations

from enum import StrEnum


class Part(StrEnum):
    """A part; the value is what the operator reads."""

    CELL = "tension cell"
    AMPLIFIER = "tension cell's amplifier"
    SECOND_FORCE = "second force path"
    INCLINOMETER = "inclinometer"
    DRIVE = "drive"
    ENCODER = "drive's encoder"
    BRAKE = "brake"
    ROPE = "rope or spring"
    PAYLOAD = "payload"
    IO_NODE = "I/O node"
    RAIL_ENCODER = "rail encoder"
    BUS = "bus or its power supply"
    MASTER = "another master or tool"
    COMPUTER = "this computer"
    PROCESS = "a process of this program"
    E_STOP = "emergency stop"


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
