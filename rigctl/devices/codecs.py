"""Process data of the devices: payload bytes <-> engineering units. No I/O; one precompiled struct each.

A decoder returns the values and why they are not good (``Quality`` bits, 0 good); a payload of the wrong length is a
``ValueError``. The EDS files and `canopen`'s own PDO decoder are the oracle in the tests.
"""

from __future__ import annotations

import math

from rigctl.devices import objects as od
from rigctl.telemetry.record import Quality

_INVALID = Quality.INVALID.value
_SATURATED = Quality.SATURATED.value
_OVERLOAD = (od.AiStatus.POSITIVE_OVERLOAD | od.AiStatus.NEGATIVE_OVERLOAD).value
_NOT_VALID = od.AiStatus.NOT_VALID.value

_CELL = od.CELL_TPDO.codec
_SLOPE = od.SLOPE_TPDO.codec
_ENCODER = od.ENCODER_TPDO.codec
_DRIVE = od.DRIVE_TPDO.codec
_DRIVE_2 = od.DRIVE_TPDO2.codec
_COMMAND = od.DRIVE_RPDO.codec
_RAD_PER_SLOPE_UNIT = math.radians(od.SLOPE_RESOLUTION_MDEG * 1e-3)
_COMMAND_LIMIT_UM_S = 2**31 - 1


def decode_tension(data: bytes | bytearray) -> tuple[float, int]:
    """Tension along the rope in N, and quality (CiA 404: 0x9130:01 with 0x6150:01)."""
    if len(data) != 5:
        raise ValueError("length")
    raw, status = _CELL.unpack(data)
    if not status:
        return raw * od.N_PER_CELL_UNIT, 0
    quality = (_INVALID if status & _NOT_VALID else 0) | (_SATURATED if status & _OVERLOAD else 0)
    return raw * od.N_PER_CELL_UNIT, quality


def decode_inclination(data: bytes | bytearray) -> tuple[float, float, int]:
    """Tangential and normal rope angle in rad, and quality (CiA 410: 0x6010, 0x6020)."""
    if len(data) != 4:
        raise ValueError("length")
    long, lateral = _SLOPE.unpack(data)
    quality = _INVALID if od.SLOPE_INVALID in (long, lateral) else 0
    return long * _RAD_PER_SLOPE_UNIT, lateral * _RAD_PER_SLOPE_UNIT, quality


def decode_encoder(data: bytes | bytearray, counts_per_turn: int) -> float:
    """Angle of the rail's shaft in rad, -pi up to pi (CiA 406: 0x6004, of any number of turns)."""
    if len(data) != 4:
        raise ValueError("length")
    counts = _ENCODER.unpack(data)[0] % counts_per_turn
    if 2 * counts >= counts_per_turn:
        counts -= counts_per_turn
    return float(counts * math.tau / counts_per_turn)


def decode_drive(data: bytes | bytearray) -> tuple[int, float, float]:
    """Statusword, stroke in mm and speed in mm/s (CiA 402: 0x6041, 0x6064, and 0x2044)."""
    if len(data) != 8:
        raise ValueError("length")
    statusword, position, velocity = _DRIVE.unpack(data)
    return statusword, position * od.MM_PER_POSITION_UNIT, velocity * od.MM_S_PER_VELOCITY_16_UNIT


def decode_drive_status(data: bytes | bytearray) -> tuple[float, float, int]:
    """Motor current by the rated one, drive temperature in deg C, digital inputs (0x6078, 0x2045, 0x60FD)."""
    if len(data) != 8:
        raise ValueError("length")
    current, temperature, inputs = _DRIVE_2.unpack(data)
    return current * od.PER_CURRENT_UNIT, temperature * od.C_PER_TEMPERATURE_UNIT, inputs


def decode_inputs(data: bytes | bytearray) -> int:
    """Eight digital inputs, one bit each (CiA 401: 0x6000)."""
    if len(data) != 1:
        raise ValueError("length")
    return data[0]


def encode_command(controlword: int, speed_mm_s: float) -> bytes:
    """Payload of the command PDO (CiA 402: 0x6040, 0x60FF).

    A speed that is not finite, or does not fit, leaves as zero: nothing else may reach an actuator.
    """
    if not math.isfinite(speed_mm_s):
        return _COMMAND.pack(controlword, 0)
    raw = round(speed_mm_s / od.MM_S_PER_VELOCITY_UNIT)
    return _COMMAND.pack(controlword, raw if -_COMMAND_LIMIT_UM_S <= raw <= _COMMAND_LIMIT_UM_S else 0)
