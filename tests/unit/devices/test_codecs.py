"""The compiled codecs against canopen's own PDO decoder with the EDS files, and their refusals."""

from __future__ import annotations

import math
import struct
from typing import Any

import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.devices import codecs, sdo
from rigctl.devices import objects as od
from rigctl.devices.drive import Power, next_controlword
from rigctl.devices.objects import Controlword, PdoLayout
from rigctl.devices.process_data import DriveUnits
from rigctl.model.device_states import STATUSWORD, DriveState
from rigctl.model.samples import Quality
from tests.builders.paths import ROOT

EDS = ROOT / "config/eds"


def pdo(eds: str, direction: str, number: int = 1) -> Any:
    node = canopen.RemoteNode(1, str(EDS / eds))
    network = canopen.Network()
    network.add_node(node)
    maps = getattr(node, direction)
    maps[number].read(from_od=True)
    return maps[number]


CELL, SLOPE = pdo("tension_amplifier.eds", "tpdo"), pdo("inclinometer.eds", "tpdo")
ENCODER = pdo("rail_encoder.eds", "tpdo")
INPUTS = pdo("io_node.eds", "tpdo")
STATUS_2 = pdo("cylinder_drive.eds", "tpdo", 2)
STATUS, COMMAND = pdo("cylinder_drive.eds", "tpdo"), pdo("cylinder_drive.eds", "rpdo")


UNITS = DriveUnits()
decode_tension = codecs.tension_decoder(od.CELL_TPDO)
decode_inclination = codecs.inclination_decoder(od.SLOPE_TPDO)
decode_drive = codecs.drive_decoder(od.DRIVE_TPDO, UNITS)
decode_drive_status = codecs.drive_status_decoder(od.DRIVE_TPDO2)
decode_inputs = codecs.inputs_decoder(od.inputs_tpdo(1))
encode_command = codecs.command_encoder(od.DRIVE_RPDO, UNITS)


def oracle(pdo_map: Any, data: bytes) -> list[int]:
    pdo_map.data = bytearray(data)
    return [variable.raw for variable in pdo_map]


@given(st.binary(min_size=5, max_size=5))
def test_tension_is_what_canopen_reads(data: bytes) -> None:
    raw, status = oracle(CELL, data)
    tension_n, quality = decode_tension(data)
    assert tension_n == pytest.approx(raw * 1e-3)
    assert bool(quality & Quality.INVALID) == bool(status & 1)
    assert bool(quality & Quality.SATURATED) == bool(status & 6)


@given(st.binary(min_size=4, max_size=4))
def test_inclination_is_what_canopen_reads(data: bytes) -> None:
    long, lateral = oracle(SLOPE, data)
    tangential, normal, quality = decode_inclination(data)
    assert math.degrees(tangential) == pytest.approx(long * 0.01)
    assert math.degrees(normal) == pytest.approx(lateral * 0.01)
    assert bool(quality) == (-0x8000 in (long, lateral))


@given(st.binary(min_size=4, max_size=4), st.integers(256, 2**31))
def test_a_rail_angle_is_what_canopen_reads_within_one_turn(data: bytes, per_turn: int) -> None:
    (counts,) = oracle(ENCODER, data)
    angle_rad = codecs.encoder_decoder(od.ENCODER_TPDO, per_turn)(data)
    assert -math.pi <= angle_rad < math.pi
    turns = counts / per_turn - angle_rad / math.tau
    assert turns == pytest.approx(round(turns), abs=1e-6 / 256)


def test_a_rail_angle_goes_through_zero_where_the_counts_begin_again() -> None:
    decode = codecs.encoder_decoder(od.ENCODER_TPDO, 4096)
    angles = [decode(struct.pack("<I", counts)) for counts in (4094, 4095, 0, 1, 4096, 8191)]
    assert [angle * 4096 / math.tau for angle in angles] == pytest.approx([-2, -1, 0, 1, 0, -1])


@given(st.binary(min_size=8, max_size=8))
def test_drive_status_is_what_canopen_reads(data: bytes) -> None:
    statusword, position, velocity = oracle(STATUS, data)
    assert decode_drive(data) == (statusword, pytest.approx(position * 1e-3), pytest.approx(velocity * 1e-2))


@given(st.binary(min_size=8, max_size=8))
def test_current_temperature_and_inputs_are_what_canopen_reads(data: bytes) -> None:
    current, temperature, inputs = oracle(STATUS_2, data)
    found = decode_drive_status(data)
    assert found == (pytest.approx(current * 1e-3), pytest.approx(temperature * 0.1), inputs)


@given(st.binary(min_size=1, max_size=1))
def test_eight_inputs_are_what_canopen_reads(data: bytes) -> None:
    assert decode_inputs(data) == oracle(INPUTS, data + b"\0")[0]


@given(st.sampled_from(Controlword), st.floats(-2e6, 2e6))
def test_a_command_is_what_canopen_reads(controlword: Controlword, speed_mm_s: float) -> None:
    word, target = oracle(COMMAND, encode_command(controlword, speed_mm_s))
    assert word == controlword
    assert abs(target - 1e3 * speed_mm_s) <= 0.5 + 1e-6  # the nearest count; a half is as near to both


@pytest.mark.parametrize("speed", [math.nan, math.inf, -math.inf, 1e300, 2**31 * 1e-3, -(2**31) * 1e-3 - 1])
def test_what_is_not_a_speed_leaves_as_zero(speed: float) -> None:
    assert struct.unpack("<Hi", encode_command(Controlword.ENABLE_OPERATION, speed)) == (0x0F, 0)


@pytest.mark.parametrize(
    ("decode", "size"),
    [
        (decode_tension, 5),
        (decode_inclination, 4),
        (decode_drive, 8),
        (decode_drive_status, 8),
        (codecs.encoder_decoder(od.ENCODER_TPDO, 4096), 4),
        (decode_inputs, 1),
    ],
)
def test_a_wrong_length_is_refused(decode: Any, size: int) -> None:
    for wrong in set(range(9)) - {size}:
        with pytest.raises(ValueError, match="length"):
            decode(bytes(wrong))


def test_the_layouts_are_the_eds_files_mappings() -> None:
    for layout, pdo_map in (
        (od.CELL_TPDO, CELL), (od.SLOPE_TPDO, SLOPE), (od.DRIVE_TPDO, STATUS), (od.DRIVE_RPDO, COMMAND),
        (od.ENCODER_TPDO, ENCODER), (od.DRIVE_TPDO2, STATUS_2),
    ):  # fmt: skip
        assert layout.mapping == tuple(v.index << 16 | v.subindex << 8 | v.length for v in pdo_map)


@pytest.mark.parametrize("statusword", range(0x80))
def test_every_statusword_has_one_state(statusword: int) -> None:
    state = od.drive_state(statusword)
    wide = {0x00, 0x40, 0x0F, 0x08}
    if statusword & 0x4F in wide:
        assert state == statusword & 0x4F
    elif statusword & 0x6F in set(DriveState):
        assert state == statusword & 0x6F
    else:
        assert state is DriveState.NOT_READY


def test_power_on_walks_the_drive_up_and_off_never_enables() -> None:
    up = [DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON]
    words = [next_controlword(state, Power.ON) for state in [*up, DriveState.OPERATION_ENABLED]]
    assert words == [Controlword.SHUTDOWN, Controlword.SWITCH_ON, *[Controlword.ENABLE_OPERATION] * 2]
    for state in DriveState:
        stops = Controlword.QUICK_STOP if state is DriveState.QUICK_STOP_ACTIVE else Controlword.SHUTDOWN
        assert next_controlword(state, Power.OFF) is stops  # power is never cut at once: the drive may be moving
        assert next_controlword(state, Power.CUT) is Controlword.DISABLE_VOLTAGE
        assert next_controlword(state, Power.ON) is not Controlword.FAULT_RESET


def test_a_fault_reset_is_a_rising_edge() -> None:
    words = [next_controlword(DriveState.FAULT, power) for power in (Power.RESET_LOW, Power.RESET)]
    assert words == [Controlword.DISABLE_VOLTAGE, Controlword.FAULT_RESET]
    assert [word >> 7 & 1 for word in words] == [0, 1]


VALUES = {
    (STATUSWORD, 0): ("H", 0x1637),
    (od.POSITION_ACTUAL, 0): ("i", -1234),
    (od.VELOCITY_ACTUAL_16, 0): ("h", 567),
    (od.MODE_DISPLAY, 0): ("b", 9),
    (od.ERROR_REGISTER, 0): ("B", 3),
}


@given(st.permutations(sorted(VALUES)), st.integers(3, 5))
def test_a_fixed_mapping_is_read_in_its_own_order_and_what_else_is_in_it_skipped(
    order: list[tuple[int, int]], count: int
) -> None:
    mapped = [each for each in order if each in od.DRIVE_TPDO.objects or count > 3]
    mapped = mapped if struct.calcsize("<" + "".join(VALUES[each][0] for each in mapped)) <= 8 else mapped[:0]
    mapped = mapped or [each for each in order if each in od.DRIVE_TPDO.objects]
    entries = [i << 16 | s << 8 | 8 * struct.calcsize(VALUES[i, s][0]) for i, s in mapped]
    layout = od.DRIVE_TPDO.as_mapped(entries)
    assert layout.mapping == tuple(entries)
    data = b"".join(struct.pack("<" + VALUES[each][0], VALUES[each][1]) for each in mapped)
    found = codecs.drive_decoder(layout, UNITS)(data)
    assert found == (0x1637, pytest.approx(-1.234), pytest.approx(5.67))


@pytest.mark.parametrize(
    ("layout", "entries", "why"),
    [
        (od.DRIVE_TPDO, [0x60410010, 0x60640020], "no object 0x2044:00"),
        (od.DRIVE_TPDO, [], "no object 0x2044:00"),
        (od.CELL_TPDO, [0x91300110, 0x61500108], "object 0x9130:01 with 16 bits, expected 32"),
        (od.CELL_TPDO, [0x91300120, 0x20000001, 0x61500108], "object 0x2000:00 with 1 bits, expected whole bytes"),
        (od.SLOPE_TPDO, [0x60100010, 0x60200010, 0x20000030], "10 bytes, expected at most 8"),
        (od.DRIVE_RPDO, [0x60400010, 0x60FF0020, 0x60710010], "object 0x6071:00, which we do not write"),
    ],
)
def test_a_mapping_that_does_not_do_is_refused_by_what_is_wrong(
    layout: PdoLayout, entries: list[int], why: str
) -> None:
    with pytest.raises(ValueError, match="^" + why + "$"):
        layout.as_mapped(entries)


@pytest.mark.parametrize("entries", [[0x60FF0020, 0x60600008, 0x60400010], [0x60400010, 0x00050008, 0x60FF0020]])
def test_a_command_goes_out_in_the_order_of_a_fixed_mapping(entries: list[int]) -> None:
    layout = od.DRIVE_RPDO.as_mapped(entries)
    data = codecs.command_encoder(layout, UNITS)(Controlword.ENABLE_OPERATION, -1.5)
    values = dict(zip(layout.objects, layout.codec.unpack(data), strict=True))
    assert (values[od.CONTROLWORD, 0], values[od.TARGET_VELOCITY, 0]) == (0x0F, -1500)
    assert values.get((od.MODE_OF_OPERATION, 0), 9) == od.CYCLIC_SYNCHRONOUS_VELOCITY
    assert layout.mapping == tuple(entries)


def test_a_drive_in_increments_is_read_and_commanded_in_them() -> None:
    units = DriveUnits(1 / 209_715.2, 1 / 12.0, 1.0)
    place = PdoLayout(od.TPDO1_BASE, ((STATUSWORD, 0, "H"), (od.POSITION_ACTUAL, 0, "i")))
    statusword, stroke_mm, speed = codecs.drive_decoder(place, units)(struct.pack("<Hi", 0x27, 2_097_152))
    assert (statusword, stroke_mm) == (0x27, pytest.approx(10.0)) and math.isnan(speed)
    velocity = PdoLayout(od.tpdo_base(3), ((od.VELOCITY_ACTUAL, 0, "i"),))
    assert codecs.drive_speed_decoder(velocity, units)(struct.pack("<i", -24)) == pytest.approx(-2.0)
    encode = codecs.command_encoder(od.DRIVE_RPDO, units)
    assert struct.unpack("<Hi", encode(0x0F, 2.5)) == (0x0F, 30)
    assert struct.unpack("<Hi", encode(0x0F, 1e308)) == (0x0F, 0)


@pytest.mark.parametrize(
    ("preload_n", "per_mille"), [(0.0, 0), (300.0, 200), (-300.0, -200), (1600.0, 1000), (-1600.0, -1000)]
)
def test_a_preload_goes_out_per_mille_of_the_rated_torque_and_ends_there(preload_n: float, per_mille: int) -> None:
    encode = codecs.command_encoder(od.DRIVE_RPDO_PRELOAD, UNITS, 1500.0)
    assert struct.unpack("<Hih", encode(0x0F, 2.5, preload_n)) == (0x0F, 2500, per_mille)


@pytest.mark.parametrize(
    ("base", "places"),
    [(0x180, (0x1800, 0x1A00)), (0x480, (0x1803, 0x1A03)), (0x200, (0x1400, 0x1600)), (0x300, (0x1401, 0x1601))],
)
def test_a_pdo_knows_its_parameters(base: int, places: tuple[int, int]) -> None:
    layout = PdoLayout(base, ((STATUSWORD, 0, "H"),))
    assert (layout.communication, layout.mapping_object) == places
    assert layout.transmitted == (places[0] >= 0x1800)


def test_an_upload_is_a_value_only_if_its_answer_holds_it() -> None:
    def answer(command: int, value: int = 0) -> sdo.UploadAnswer:
        return sdo.upload_answer(struct.pack("<BHBI", command, STATUSWORD, 0, value), 2)

    assert answer(0x4B, 0xFFFF_0237).value == 0x0237  # two bytes, by the command's own count
    assert answer(0x42, 0xFFFF_0237).value == 0x0237  # by the object's size
    segmented = answer(0x41, 300)
    assert not segmented.expedited
    assert answer(0x80, 0x0602_0000).abort == 0x0602_0000
