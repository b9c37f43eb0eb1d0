"""The objects of each CANopen device that a start reads or writes, with their types by the profile.

A device's EDS file is held against this table before a start (`rigctl.devices.eds_file`), and start-up reads and writes
no other object. tests/unit/devices/test_needed_objects.py holds both to each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rigctl.config.settings import RigSettings
from rigctl.devices import objects as od
from rigctl.devices import process_data
from rigctl.devices.process_data import CELL_TEMPERATURE, DRIVE_STATUS
from rigctl.model.device_states import STATUSWORD

MOST_ENTRIES = 64
"""Objects in a PDO, CiA 301; a larger count marks a multiplexed one, which we do not use."""
_EVERY = {
    od.DEVICE_TYPE: "I", od.ERROR_REGISTER: "B", od.SYNC_COB_ID: "I", od.PRODUCER_HEARTBEAT: "H", od.IDENTITY: "I",
    od.CONSUMER_HEARTBEAT: "I", od.ERROR_BEHAVIOUR: "B", od.ERROR_CODE: "H",
}  # fmt: skip
_INPUTS = {
    od.INPUT_POLARITY_8: "B", od.INPUT_EVENTS: "?", od.INPUT_EVENT_MASK_8: "B", od.OUTPUTS_8: "B",
    od.OUTPUT_POLARITY_8: "B", od.OUTPUT_ERROR_MODE_8: "B", od.OUTPUT_ERROR_VALUE_8: "B",
}  # fmt: skip
_DRIVE = {
    od.ABORT_CONNECTION_OPTION: "h", od.CONTROLWORD: "H", STATUSWORD: "H", od.QUICK_STOP_OPTION: "h",
    od.SHUTDOWN_OPTION: "h", od.DISABLE_OPERATION_OPTION: "h", od.FAULT_REACTION_OPTION: "h",
    od.MODE_OF_OPERATION: "b", od.MODE_DISPLAY: "b", od.VELOCITY_ACTUAL: "i", od.MOTOR_RATED_CURRENT: "I",
    od.POLARITY: "B", od.QUICK_STOP_DECELERATION: "I", od.ENCODER_RESOLUTION: "I", od.GEAR_RATIO: "I",
    od.FEED_CONSTANT: "I", od.SI_UNIT_POSITION: "I", od.SI_UNIT_VELOCITY: "I", od.VELOCITY_OFFSET: "i",
    od.TORQUE_OFFSET: "h", od.TARGET_VELOCITY: "i",
}  # fmt: skip
_FORCE = {od.AI_PHYSICAL_UNIT: "I", od.AI_DECIMAL_DIGITS: "B"}
_CODES = {
    "tension_cell": _FORCE,
    "second_force": {**_FORCE, od.ENCODER_STEP: "I"},
    "inclinometer": {od.SLOPE_RESOLUTION: "H"},
    "rail_encoder": {od.ENCODER_COUNTS_PER_TURN: "I", od.ENCODER_TOTAL_RANGE: "I"},
    "io": _INPUTS,
    "cylinder": _DRIVE,
}
"""Struct code of an object of each section's profile: the profiles use the same numbers for other things."""
_COMMUNICATION = {1: "I", 2: "B", 3: "H", 5: "H"}
_INHIBIT, _EVENT = 3, 5


@dataclass(frozen=True)
class Needed:
    """An object: its struct code, and whether a start cannot do without it."""

    code: str
    required: bool


class _DeviceObjects(dict[tuple[int, int], Needed]):
    def __init__(self, section: str) -> None:
        super().__init__()
        self._codes = _EVERY | _CODES[section]

    def require(self, index: int, *subs: int) -> None:
        """Sub-indices that the device must have; 0 without any."""
        for sub in subs or (0,):
            self[index, sub] = Needed(self._codes[index], required=True)

    def allow(self, index: int, *subs: int) -> None:
        """Sub-indices that are used where the device has them; 0 without any."""
        for sub in subs or (0,):
            self.setdefault((index, sub), Needed(self._codes[index], required=False))


def needed(settings: RigSettings, section: str) -> Mapping[tuple[int, int], Needed]:
    """The objects of the device in ``section`` that a start uses, by index and sub-index."""
    table = _DeviceObjects(section)
    table.require(od.DEVICE_TYPE)
    table.require(od.ERROR_REGISTER)
    table.require(od.IDENTITY, 1, 2, 3, 4)
    table.require(od.PRODUCER_HEARTBEAT)
    table.allow(od.ERROR_CODE)
    table[od.ERROR_FIELD, 0], table[od.ERROR_FIELD, 1] = Needed("B", required=False), Needed("I", required=False)
    if section != "io":
        table.require(od.SYNC_COB_ID)
    _add_pdos(table, settings, section)
    match section:
        case "tension_cell":
            channels = (1, 2) if CELL_TEMPERATURE in process_data.wanted(settings).frames else (1,)
            table.require(od.AI_PHYSICAL_UNIT, *channels)
            table.require(od.AI_DECIMAL_DIGITS, *channels)
        case "inclinometer":
            table.require(od.SLOPE_RESOLUTION)
        case "rail_encoder":
            table.require(od.ENCODER_COUNTS_PER_TURN)
            table.require(od.ENCODER_TOTAL_RANGE)
        case "second_force":
            _add_second(table, settings)
        case "io":
            _add_inputs(table, settings)
        case _:
            _add_drive(table, settings)
    return table


def _add_pdos(table: _DeviceObjects, settings: RigSettings, section: str) -> None:
    """The parameters of each PDO of the device, and the objects in it."""
    data = process_data.wanted(settings)
    for name, layout in data.frames.items():
        if data.owner(name, settings) != section:
            continue
        timed = (_INHIBIT, _EVENT) if name == "io" else ()
        for sub, code in _COMMUNICATION.items():
            if sub <= 2 or sub in timed:
                table[layout.communication, sub] = Needed(code, required=True)
        for sub in range(MOST_ENTRIES + 1):
            code = "I" if sub else "B"
            table[layout.mapping_object, sub] = Needed(code, required=sub <= len(layout.objects))
        for index, sub, code in layout.fields:
            table[index, sub] = Needed(code, required=True)


def _add_second(table: _DeviceObjects, settings: RigSettings) -> None:
    if settings.second_force is not None and settings.second_force.kind == "stretch":
        table.require(od.ENCODER_STEP, 1)
        return
    table.require(od.AI_PHYSICAL_UNIT, 1)
    table.require(od.AI_DECIMAL_DIGITS, 1)


def _add_inputs(table: _DeviceObjects, settings: RigSettings) -> None:
    io = settings.io
    assert io is not None  # the node exists only with this section
    table[od.INPUTS_8, 0] = Needed("B", required=True)
    table.allow(od.INPUT_POLARITY_8, io.block)
    table.allow(od.INPUT_EVENTS)
    table.allow(od.INPUT_EVENT_MASK_8, io.block)
    if not io.enable_block:
        return
    table.require(od.OUTPUTS_8, 0, io.enable_block)
    table.allow(od.OUTPUT_POLARITY_8, io.enable_block)
    table.require(od.OUTPUT_ERROR_MODE_8, io.enable_block)
    table.require(od.OUTPUT_ERROR_VALUE_8, io.enable_block)
    table.allow(od.ERROR_BEHAVIOUR, 1)
    table.require(od.CONSUMER_HEARTBEAT, 1)


def _add_drive(table: _DeviceObjects, settings: RigSettings) -> None:
    cylinder = settings.cylinder
    for index in (od.CONTROLWORD, STATUSWORD, od.MODE_OF_OPERATION):
        table.require(index)
    if cylinder.lead_mm is None and cylinder.increments_per_mm is None:
        table.require(od.SI_UNIT_POSITION)
        table.require(od.SI_UNIT_VELOCITY)
    if DRIVE_STATUS in process_data.wanted(settings).frames:
        table.require(od.MOTOR_RATED_CURRENT)
    if cylinder.lead_mm is not None:
        for index in (od.FEED_CONSTANT, od.ENCODER_RESOLUTION, od.GEAR_RATIO):
            table.allow(index, 1, 2)
    table.setdefault((od.RPDO1_COMMUNICATION, _EVENT), Needed(_COMMUNICATION[_EVENT], required=False))
    table.allow(od.CONSUMER_HEARTBEAT, 1)
    for index in (
        od.SI_UNIT_POSITION, od.TARGET_VELOCITY, od.VELOCITY_OFFSET, od.VELOCITY_ACTUAL, od.POLARITY, od.MODE_DISPLAY,
        od.ABORT_CONNECTION_OPTION, od.QUICK_STOP_OPTION, od.SHUTDOWN_OPTION, od.DISABLE_OPERATION_OPTION,
        od.FAULT_REACTION_OPTION, od.QUICK_STOP_DECELERATION, od.TORQUE_OFFSET,
    ):  # fmt: skip
        table.allow(index)
