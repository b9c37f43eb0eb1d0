"""The process data in use: the objects of each PDO, in order, and the drive's units.

`wanted` gives the rig file's. Start-up's report, ``control.json`` and so every recording have the devices', as read
back; the control process compiles its codecs from these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import msgspec

from rigctl.config.built_type import built
from rigctl.config.settings import RigSettings
from rigctl.devices import objects as od
from rigctl.devices.objects import PdoLayout
from rigctl.model.device_states import STATUSWORD

COMMAND = "command"
DRIVE_SPEED, DRIVE_STATUS = "cylinder_speed", "cylinder_status"
CELL_TEMPERATURE = "tension_cell_temperature"
SECOND_FORCE = "second_force"
DRIVE_ENABLE = "io_output"
_OWNERS = {CELL_TEMPERATURE: "tension_cell", DRIVE_ENABLE: "io"}  # others without a section of their name: the drive


@dataclass(frozen=True)
class DriveUnits:
    """Size of one unit of position (mm; 0x6064), speed (mm/s; 0x606C, 0x60FF) and ramp (mm/s2; 0x6085)."""

    position_mm: float = od.MM_PER_POSITION_UNIT
    speed_mm_s: float = od.MM_S_PER_VELOCITY_UNIT
    ramp_mm_s2: float = od.MM_S_PER_VELOCITY_UNIT


@built
@dataclass(frozen=True)
class ProcessData:
    """PDOs by name: the rig file's section, `DRIVE_SPEED` and `DRIVE_STATUS` of the drive's others, `COMMAND`.

    `CELL_TEMPERATURE`: the second channel of the tension amplifier. `DRIVE_ENABLE`: the I/O node's outputs.
    """

    frames: Mapping[str, PdoLayout]
    units: DriveUnits = field(default_factory=DriveUnits)

    def can_ids(self, settings: RigSettings) -> dict[str, int]:
        """CAN identifier of each."""
        nodes = settings.canopen_nodes
        return {name: layout.cob_base + nodes[self.owner(name, settings)] for name, layout in self.frames.items()}

    @staticmethod
    def owner(name: str, settings: RigSettings) -> str:
        """Section of the device that sends or takes a PDO."""
        section = _OWNERS.get(name, name)
        return section if section in settings.canopen_nodes else "cylinder"

    def as_json(self) -> dict[str, Any]:
        """For control.json."""
        return {"frames": {name: asdict(layout) for name, layout in self.frames.items()}, "units": asdict(self.units)}

    @staticmethod
    def of_json(document: object) -> ProcessData:
        """Process data from `as_json`.

        Raises:
            msgspec.ValidationError: the document has another shape.
        """
        return msgspec.convert(document, ProcessData)


def wanted(settings: RigSettings) -> ProcessData:
    """Process data by the rig file; the drive's unit is the micrometre unless the file gives another."""
    cylinder, nodes = settings.cylinder, settings.canopen_nodes
    sections = {"tension_cell": od.CELL_TPDO, "inclinometer": od.SLOPE_TPDO, "rail_encoder": od.ENCODER_TPDO}
    frames = {name: layout for name, layout in sections.items() if name in nodes}
    if settings.cell_temperature_divisor:
        frames[CELL_TEMPERATURE] = od.CELL_TPDO2
    if settings.second_force is not None:
        frames[SECOND_FORCE] = od.CELL_TPDO if settings.second_force.kind == "cell" else od.ENCODER_TPDO
    if settings.io is not None:
        frames["io"] = od.inputs_tpdo(settings.io.block)
        if settings.io.enable_block:
            frames[DRIVE_ENABLE] = od.outputs_rpdo(settings.io.enable_block)
    speed = ((cylinder.velocity_object, 0, "i" if cylinder.velocity_object == od.VELOCITY_ACTUAL else "h"),)
    split = cylinder.velocity_pdo != cylinder.position_pdo
    place = ((STATUSWORD, 0, "H"), (od.POSITION_ACTUAL, 0, "i"))
    frames["cylinder"] = PdoLayout(od.tpdo_base(cylinder.position_pdo), place if split else place + speed)
    if split:
        frames[DRIVE_SPEED] = PdoLayout(od.tpdo_base(cylinder.velocity_pdo), speed)
    if settings.status_divisor:
        heat = ((cylinder.temperature_object, 0, "h"),) if cylinder.temperature_object is not None else ()
        status = ((od.CURRENT_ACTUAL, 0, "h"), *heat, (od.DIGITAL_INPUTS, 0, "I"))
        frames[DRIVE_STATUS] = PdoLayout(od.tpdo_base(cylinder.status_pdo), status)
    frames[COMMAND] = od.DRIVE_RPDO if cylinder.rated_force_n is None else od.DRIVE_RPDO_PRELOAD
    return ProcessData(frames, in_increments(settings, cylinder.increments_per_mm))


def in_increments(settings: RigSettings, per_mm: float | None) -> DriveUnits:
    """Units of a drive with ``per_mm`` increments of position per mm; micrometres where that is None."""
    if per_mm is None:
        return DriveUnits()
    cylinder = settings.cylinder
    speed = cylinder.speed_units_per_mm_s or per_mm
    return DriveUnits(1.0 / per_mm, 1.0 / speed, 1.0 / (cylinder.ramp_units_per_mm_s2 or speed))
