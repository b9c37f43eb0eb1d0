"""The parts of a rig that a fault or a diagnosis can name."""

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
