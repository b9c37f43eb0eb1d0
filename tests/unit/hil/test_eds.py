"""The EDS files agree with ``rigctl.devices.objects``, and canopen reads them without a warning."""

from __future__ import annotations

import configparser
import logging

import canopen
import pytest
from canopen.objectdictionary import datatypes

from hil.nodes.dictionary import STRUCT_CODES, entry, number
from rigctl.devices import objects
from rigctl.devices.objects import PdoLayout
from rigctl.model.device_states import STATUSWORD
from tests.builders.rig_bench import REPOSITORY

EDS = REPOSITORY / "config/eds"
CELL, SLOPE, DRIVE, ENCODER, IO, SIMULATOR = FILES = (
    "tension_amplifier", "inclinometer", "cylinder_drive", "rail_encoder", "io_node", "simulator",
)  # fmt: skip
VARIANTS = ("fixed_tension_amplifier", "fixed_inclinometer", "stock_drive")
BOOLEAN = datatypes.BOOLEAN
U8, U16, U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
I8, I16, I32 = datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32
ANY = object()

OBJECTS = [  # file, index, subindex, type, access, default
    *[
        row
        for file in FILES
        for row in (
            (file, objects.ERROR_REGISTER, 0, U8, "ro", 0),
            (file, objects.PRODUCER_HEARTBEAT, 0, U16, "rw", ANY),
            *((file, objects.IDENTITY, i, U32, "ro", ANY) for i in (1, 2, 3, 4)),
        )
    ],
    *[
        row
        for file in (CELL, SLOPE, DRIVE, ENCODER, IO)
        for row in (
            (file, objects.TPDO1_COMMUNICATION, 1, U32, "rw", objects.TPDO1_BASE + 5),
            (file, objects.TPDO1_COMMUNICATION, 2, U8, "rw", {SLOPE: 10, IO: objects.EVENT_DRIVEN}.get(file, 1)),
            *((file, objects.TPDO1_MAPPING, i, U32, "rw", ANY) for i in range(1, 9)),
        )
    ],
    (CELL, objects.DEVICE_TYPE, 0, U32, "ro", objects.DEVICE_TYPE_404),
    (CELL, objects.AI_PROCESS_VALUE, 1, I32, "ro", None),
    (CELL, objects.AI_PHYSICAL_UNIT, 1, U32, "ro", objects.SI_UNIT_NEWTON),
    (CELL, objects.AI_DECIMAL_DIGITS, 1, U8, "ro", objects.CELL_DECIMAL_DIGITS),
    (CELL, objects.AI_STATUS, 1, U8, "ro", None),
    (CELL, objects.AI_PROCESS_VALUE, 2, I32, "ro", None),
    (CELL, objects.AI_PHYSICAL_UNIT, 2, U32, "ro", objects.SI_UNIT_CELSIUS),
    (CELL, objects.AI_DECIMAL_DIGITS, 2, U8, "ro", objects.CELSIUS_DECIMAL_DIGITS),
    (CELL, objects.TPDO2_COMMUNICATION, 1, U32, "rw", objects.PDO_NOT_VALID + objects.TPDO2_BASE + 5),
    (SLOPE, objects.DEVICE_TYPE, 0, U32, "ro", objects.DEVICE_TYPE_410),
    (SLOPE, objects.SLOPE_RESOLUTION, 0, U16, "rw", objects.SLOPE_RESOLUTION_MDEG),
    (SLOPE, objects.SLOPE_LONG, 0, I16, "ro", None),
    (SLOPE, objects.SLOPE_LATERAL, 0, I16, "ro", None),
    (ENCODER, objects.DEVICE_TYPE, 0, U32, "ro", objects.DEVICE_TYPE_406),
    (ENCODER, objects.ENCODER_COUNTS_PER_TURN, 0, U32, "rw", 1 << 20),
    (ENCODER, objects.ENCODER_TOTAL_RANGE, 0, U32, "rw", 1 << 20),
    (ENCODER, objects.ENCODER_POSITION, 0, U32, "ro", None),
    (IO, objects.DEVICE_TYPE, 0, U32, "ro", objects.DEVICE_TYPE_401),
    (IO, objects.TPDO1_COMMUNICATION, 3, U16, "rw", 0),
    (IO, objects.TPDO1_COMMUNICATION, 5, U16, "rw", 0),
    (IO, objects.INPUTS_8, 0, U8, "ro", 2),
    *((IO, objects.INPUTS_8, block, U8, "ro", None) for block in (1, 2)),
    *((IO, objects.INPUT_POLARITY_8, block, U8, "rw", 0) for block in (1, 2)),
    (IO, objects.INPUT_EVENTS, 0, BOOLEAN, "rw", 1),
    *((IO, objects.INPUT_EVENT_MASK_8, block, U8, "rw", objects.EVERY_INPUT_8) for block in (1, 2)),
    (DRIVE, objects.DEVICE_TYPE, 0, U32, "ro", objects.DEVICE_TYPE_402),
    (DRIVE, objects.CONSUMER_HEARTBEAT, 1, U32, "rw", 0),
    (DRIVE, objects.RPDO1_COMMUNICATION, 1, U32, "rw", objects.RPDO1_BASE + 5),
    (DRIVE, objects.RPDO1_COMMUNICATION, 2, U8, "rw", 1),
    (DRIVE, objects.RPDO1_COMMUNICATION, 5, U16, "rw", 0),
    *((DRIVE, objects.RPDO1_MAPPING, i, U32, "rw", ANY) for i in range(1, 9)),
    (DRIVE, objects.VELOCITY_ACTUAL_16, 0, I16, "ro", None),
    (DRIVE, objects.ABORT_CONNECTION_OPTION, 0, I16, "rw", ANY),
    (DRIVE, objects.ERROR_CODE, 0, U16, "ro", None),
    (DRIVE, objects.CONTROLWORD, 0, U16, "rw", 0),
    (DRIVE, STATUSWORD, 0, U16, "ro", None),
    (DRIVE, objects.QUICK_STOP_OPTION, 0, I16, "rw", 2),
    (DRIVE, objects.SHUTDOWN_OPTION, 0, I16, "rw", 0),
    (DRIVE, objects.DISABLE_OPERATION_OPTION, 0, I16, "rw", 1),
    (DRIVE, objects.TPDO2_COMMUNICATION, 1, U32, "rw", (1 << 31) + objects.TPDO2_BASE + 5),
    (DRIVE, objects.TPDO2_COMMUNICATION, 2, U8, "rw", 100),
    *((DRIVE, objects.TPDO2_MAPPING, i, U32, "rw", ANY) for i in range(1, 9)),
    (DRIVE, objects.DRIVE_TEMPERATURE, 0, I16, "ro", None),
    (DRIVE, objects.MOTOR_RATED_CURRENT, 0, U32, "ro", 3000),
    (DRIVE, objects.CURRENT_ACTUAL, 0, I16, "ro", None),
    (DRIVE, objects.DIGITAL_INPUTS, 0, U32, "ro", None),
    (DRIVE, objects.FAULT_REACTION_OPTION, 0, I16, "rw", objects.FAULT_REACTION_QUICK_STOP),
    (DRIVE, objects.MODE_OF_OPERATION, 0, I8, "rw", 0),
    (DRIVE, objects.MODE_DISPLAY, 0, I8, "ro", None),
    (DRIVE, objects.POSITION_ACTUAL, 0, I32, "ro", None),
    (DRIVE, objects.VELOCITY_ACTUAL, 0, I32, "ro", None),
    (DRIVE, objects.QUICK_STOP_DECELERATION, 0, U32, "rw", ANY),
    (DRIVE, objects.SI_UNIT_POSITION, 0, U32, "ro", objects.SI_MICROMETRE),
    (DRIVE, objects.SI_UNIT_VELOCITY, 0, U32, "ro", objects.SI_MICROMETRE_PER_SECOND),
    (DRIVE, objects.INTERPOLATION_PERIOD, 1, U8, "rw", 1),
    (DRIVE, objects.INTERPOLATION_PERIOD, 2, I8, "rw", -3),
    (DRIVE, objects.TARGET_VELOCITY, 0, I32, "rw", 0),
    (SIMULATOR, objects.SIM_MOTION_START, 0, U8, "rw", 0),
    (SIMULATOR, objects.SIM_E_STOP, 0, U8, "rw", 0),
    (SIMULATOR, objects.SIM_IO_E_STOP, 0, U8, "rw", 0),
    (SIMULATOR, objects.SIM_TOOL_UM_S, 0, I32, "rw", 0),
    (SIMULATOR, objects.SIM_MOTION_STATE, 0, U8, "ro", None),
    (SIMULATOR, objects.SIM_TRUE_VERTICAL_MN, 0, I32, "ro", None),
    (SIMULATOR, objects.SIM_TRUE_STROKE_UM, 0, I32, "ro", None),
]


def node(file: str) -> canopen.LocalNode:
    return canopen.LocalNode(5, str(EDS / f"{file}.eds"))


@pytest.mark.parametrize("file", [*FILES, *VARIANTS])
def test_canopen_reads_it_in_silence(file: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "canopen"):
        assert node(file).object_dictionary
    assert caplog.records == []


@pytest.mark.parametrize(("file", "index", "subindex", "data_type", "access", "default"), OBJECTS)
def test_object(file: str, index: int, subindex: int, data_type: int, access: str, default: object) -> None:
    found = entry(node(file), index, subindex)
    assert (found.data_type, found.access_type) == (data_type, access)
    if default is not ANY:
        assert found.default == default


@pytest.mark.parametrize(
    ("file", "mapping", "layout"),
    [
        (CELL, objects.TPDO1_MAPPING, objects.CELL_TPDO),
        (SLOPE, objects.TPDO1_MAPPING, objects.SLOPE_TPDO),
        (DRIVE, objects.TPDO1_MAPPING, objects.DRIVE_TPDO),
        (DRIVE, objects.TPDO2_MAPPING, objects.DRIVE_TPDO2),
        (ENCODER, objects.TPDO1_MAPPING, objects.ENCODER_TPDO),
        (DRIVE, objects.RPDO1_MAPPING, objects.DRIVE_RPDO),
        (
            IO,
            objects.TPDO1_MAPPING,
            PdoLayout(objects.TPDO1_BASE, ((objects.INPUTS_8, 1, "B"), (objects.INPUTS_8, 2, "B"))),
        ),
    ],
)
def test_default_mapping_is_the_layout(file: str, mapping: int, layout: PdoLayout) -> None:
    device = node(file)
    count = number(device, mapping, 0)
    assert tuple(number(device, mapping, i + 1) for i in range(count)) == layout.mapping
    for index, subindex, code in layout.fields:
        found = entry(device, index, subindex)
        assert found.pdo_mappable
        assert STRUCT_CODES[found.data_type] == code


@pytest.mark.parametrize("file", [*FILES, *VARIANTS])
def test_every_object_is_listed_once_in_the_list_of_its_range(file: str) -> None:
    eds = configparser.RawConfigParser(inline_comment_prefixes=(";",))
    eds.read(EDS / f"{file}.eds")
    assert eds["FileInfo"]["FileName"] == f"{file}.eds"
    listed = []
    for section in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        indices = [int(eds[section][str(i + 1)], 16) for i in range(int(eds[section]["SupportedObjects"]))]
        assert all((0x2000 <= index < 0x6000) == (section == "ManufacturerObjects") for index in indices)
        listed += indices
    assert sorted(listed) == sorted(i for i in node(file).object_dictionary if i > 7)  # below: dummy objects
    for index in listed:
        section = f"{index:04X}"
        subs = [s for s in eds.sections() if s.startswith(section + "sub")]
        assert int(eds[section].get("SubNumber", "0")) == len(subs)
