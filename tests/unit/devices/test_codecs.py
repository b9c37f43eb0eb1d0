"""The compiled codecs against canopen's own PDO decoder with the EDS files, and what they refuse."""

from __future__ import annotations

import math
import pathlib
import struct
from typing import Any

import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.devices import codecs
from rigctl.devices import objects as od
from rigctl.devices.drive import Power, next_controlword
from rigctl.devices.objects import Controlword, DriveState
from rigctl.telemetry.record import Quality

EDS = pathlib.Path(__file__).parents[3] / "config/eds"


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


def oracle(pdo_map: Any, data: bytes) -> list[int]:
    pdo_map.data = bytearray(data)
    return [variable.raw for variable in pdo_map]


@given(st.binary(min_size=5, max_size=5))
def test_tension_is_what_canopen_reads(data: bytes) -> None:
    raw, status = oracle(CELL, data)
    tension_n, quality = codecs.decode_tension(data)
    assert tension_n == pytest.approx(raw * 1e-3)
    assert bool(quality & Quality.INVALID) == bool(status & 1)
    assert bool(quality & Quality.SATURATED) == bool(status & 6)


@given(st.binary(min_size=4, max_size=4))
def test_inclination_is_what_canopen_reads(data: bytes) -> None:
    long, lateral = oracle(SLOPE, data)
    tangential, normal, quality = codecs.decode_inclination(data)
    assert math.degrees(tangential) == pytest.approx(long * 0.01)
    assert math.degrees(normal) == pytest.approx(lateral * 0.01)
    assert bool(quality) == (-0x8000 in (long, lateral))


@given(st.binary(min_size=4, max_size=4), st.integers(256, 2**31))
def test_a_rail_angle_is_what_canopen_reads_within_one_turn(data: bytes, per_turn: int) -> None:
    (counts,) = oracle(ENCODER, data)
    angle_rad = codecs.decode_encoder(data, per_turn)
    assert -math.pi <= angle_rad < math.pi
    turns = counts / per_turn - angle_rad / math.tau
    assert turns == pytest.approx(round(turns), abs=1e-6 / 256)


def test_a_rail_angle_goes_through_zero_where_the_counts_begin_again() -> None:
    angles = [codecs.decode_encoder(struct.pack("<I", counts), 4096) for counts in (4094, 4095, 0, 1, 4096, 8191)]
    assert [angle * 4096 / math.tau for angle in angles] == pytest.approx([-2, -1, 0, 1, 0, -1])


@given(st.binary(min_size=8, max_size=8))
def test_drive_status_is_what_canopen_reads(data: bytes) -> None:
    statusword, position, velocity = oracle(STATUS, data)
    assert codecs.decode_drive(data) == (statusword, pytest.approx(position * 1e-3), pytest.approx(velocity * 1e-2))


@given(st.binary(min_size=8, max_size=8))
def test_current_temperature_and_inputs_are_what_canopen_reads(data: bytes) -> None:
    current, temperature, inputs = oracle(STATUS_2, data)
    found = codecs.decode_drive_status(data)
    assert found == (pytest.approx(current * 1e-3), pytest.approx(temperature * 0.1), inputs)


@given(st.binary(min_size=1, max_size=1))
def test_eight_inputs_are_what_canopen_reads(data: bytes) -> None:
    assert codecs.decode_inputs(data) == oracle(INPUTS, data + b"\0")[0]


@given(st.sampled_from(Controlword), st.floats(-2e6, 2e6))
def test_a_command_is_what_canopen_reads(controlword: Controlword, speed_mm_s: float) -> None:
    word, target = oracle(COMMAND, codecs.encode_command(controlword, speed_mm_s))
    assert word == controlword
    assert abs(target - 1e3 * speed_mm_s) <= 0.5 + 1e-6  # the nearest count; half a one is as near to both


@pytest.mark.parametrize("speed", [math.nan, math.inf, -math.inf, 1e300, 2**31 * 1e-3, -(2**31) * 1e-3 - 1])
def test_what_is_not_a_speed_leaves_as_zero(speed: float) -> None:
    assert struct.unpack("<Hi", codecs.encode_command(Controlword.ENABLE_OPERATION, speed)) == (0x0F, 0)


@pytest.mark.parametrize(
    ("decode", "size"),
    [
        (codecs.decode_tension, 5),
        (codecs.decode_inclination, 4),
        (codecs.decode_drive, 8),
        (codecs.decode_drive_status, 8),
        (lambda data: codecs.decode_encoder(data, 4096), 4),
        (codecs.decode_inputs, 1),
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
    words = [next_controlword(state, Power.ON, 0) for state in [*up, DriveState.OPERATION_ENABLED]]
    assert words == [Controlword.SHUTDOWN, Controlword.SWITCH_ON, *[Controlword.ENABLE_OPERATION] * 2]
    for state in DriveState:
        stops = Controlword.QUICK_STOP if state is DriveState.QUICK_STOP_ACTIVE else Controlword.SHUTDOWN
        assert next_controlword(state, Power.OFF, 0) is stops  # never off at once: something may be moving
        assert next_controlword(state, Power.CUT, 0) is Controlword.DISABLE_VOLTAGE
        assert next_controlword(state, Power.ON, 0) is not Controlword.FAULT_RESET


def test_a_fault_reset_is_a_rising_edge() -> None:
    first = next_controlword(DriveState.FAULT, Power.RESET, Controlword.DISABLE_VOLTAGE)
    assert first is Controlword.FAULT_RESET
    assert next_controlword(DriveState.FAULT, Power.RESET, first) is Controlword.DISABLE_VOLTAGE
