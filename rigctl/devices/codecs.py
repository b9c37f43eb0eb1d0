"""Process data of the devices: payload bytes <-> engineering units. No I/O; one precompiled struct each.

Each function here compiles the layout of a device (`rigctl.devices.process_data`). A decoder returns the values and
their quality (``Quality`` bits, 0 good); a payload of the wrong length is a ``ValueError``. The EDS files
and `canopen`'s own PDO decoder are the oracle in the tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import itemgetter
from typing import Protocol

from rigctl.devices import objects as od
from rigctl.devices.objects import PdoLayout
from rigctl.devices.process_data import DriveUnits
from rigctl.model.device_states import STATUSWORD
from rigctl.model.samples import Quality

Data = bytes | bytearray

_INVALID = Quality.INVALID.value
_SATURATED = Quality.SATURATED.value
_OVERLOAD = (od.AiStatus.POSITIVE_OVERLOAD | od.AiStatus.NEGATIVE_OVERLOAD).value
_NOT_VALID = od.AiStatus.NOT_VALID.value

_RAD_PER_SLOPE_UNIT = math.radians(od.SLOPE_RESOLUTION_MDEG * 1e-3)
_RATED_TORQUE = 1.0 / od.PER_TORQUE_UNIT
_COMMAND_LIMIT = 2**31 - 1  # 0x60FF is an INTEGER32


def tension_decoder(layout: PdoLayout) -> Callable[[Data], tuple[float, int]]:
    """Tension along the rope in N, and quality (CiA 404: 0x9130:01 with 0x6150:01)."""
    read = layout.reader((od.AI_PROCESS_VALUE, 1), (od.AI_STATUS, 1))

    def decode(data: Data) -> tuple[float, int]:
        raw, status = read(data)
        if not status:
            return raw * od.N_PER_CELL_UNIT, 0
        quality = (_INVALID if status & _NOT_VALID else 0) | (_SATURATED if status & _OVERLOAD else 0)
        return raw * od.N_PER_CELL_UNIT, quality

    return decode


def temperature_decoder(layout: PdoLayout) -> Callable[[Data], float]:
    """Temperature of the tension cell in deg C (CiA 404: 0x9130:02)."""
    read = layout.reader((od.AI_PROCESS_VALUE, 2))
    return lambda data: read(data)[0] * od.C_PER_CELL_UNIT


def inclination_decoder(layout: PdoLayout) -> Callable[[Data], tuple[float, float, int]]:
    """Tangential and normal rope angle in rad, and quality (CiA 410: 0x6010, 0x6020)."""
    read = layout.reader((od.SLOPE_LONG, 0), (od.SLOPE_LATERAL, 0))

    def decode(data: Data) -> tuple[float, float, int]:
        long, lateral = read(data)
        quality = _INVALID if od.SLOPE_INVALID in (long, lateral) else 0
        return long * _RAD_PER_SLOPE_UNIT, lateral * _RAD_PER_SLOPE_UNIT, quality

    return decode


def encoder_decoder(layout: PdoLayout, counts_per_turn: int) -> Callable[[Data], float]:
    """Angle of the rail's shaft in rad, -pi up to pi (CiA 406: 0x6004, of any number of turns)."""
    read = layout.reader((od.ENCODER_POSITION, 0))

    def decode(data: Data) -> float:
        counts = read(data)[0] % counts_per_turn
        if 2 * counts >= counts_per_turn:
            counts -= counts_per_turn
        return float(counts * math.tau / counts_per_turn)

    return decode


def linear_decoder(layout: PdoLayout, counts_per_mm: float) -> Callable[[Data], tuple[float, int]]:
    """Position of a linear encoder in mm (CiA 406: 0x6004), and quality 0: its errors come as emergencies."""
    read = layout.reader((od.ENCODER_POSITION, 0))
    return lambda data: (read(data)[0] / counts_per_mm, 0)


def drive_decoder(layout: PdoLayout, units: DriveUnits) -> Callable[[Data], tuple[int, float, float]]:
    """Statusword, stroke in mm and speed in mm/s (CiA 402: 0x6041, 0x6064, 0x2044); NaN without a speed."""
    split = (od.VELOCITY_ACTUAL_16, 0) not in layout.objects
    speed = () if split else ((od.VELOCITY_ACTUAL_16, 0),)
    read, unit_mm = layout.reader((STATUSWORD, 0), (od.POSITION_ACTUAL, 0), *speed), units.position_mm

    def decode(data: Data) -> tuple[int, float, float]:
        statusword, position, velocity = read(data)
        return statusword, position * unit_mm, velocity * od.MM_S_PER_VELOCITY_16_UNIT

    def decode_place(data: Data) -> tuple[int, float, float]:
        statusword, position = read(data)
        return statusword, position * unit_mm, math.nan

    return decode_place if split else decode


def drive_speed_decoder(layout: PdoLayout, units: DriveUnits) -> Callable[[Data], float]:
    """Speed in mm/s, of a drive that sends it in a frame of its own (CiA 402: 0x606C, or 0x2044)."""
    wide = (od.VELOCITY_ACTUAL, 0)
    narrow = wide not in layout.objects
    read = layout.reader((od.VELOCITY_ACTUAL_16, 0) if narrow else wide)
    unit_mm_s = od.MM_S_PER_VELOCITY_16_UNIT if narrow else units.speed_mm_s
    return lambda data: read(data)[0] * unit_mm_s


def drive_status_decoder(layout: PdoLayout) -> Callable[[Data], tuple[float, float, int]]:
    """Motor current over rated current, drive temperature in deg C (NaN: none), digital inputs (0x6078, 0x60FD)."""
    known = ((od.CURRENT_ACTUAL, 0), (od.DIGITAL_INPUTS, 0))
    heat = [each for each in layout.objects if each not in known]
    read = layout.reader(known[0], *heat, known[1])

    def decode(data: Data) -> tuple[float, float, int]:
        current, *temperature, inputs = read(data)
        celsius = temperature[0] * od.C_PER_TEMPERATURE_UNIT if temperature else math.nan
        return current * od.PER_CURRENT_UNIT, celsius, inputs

    return decode


def inputs_decoder(layout: PdoLayout) -> Callable[[Data], int]:
    """Eight digital inputs, one bit each (CiA 401: 0x6000)."""
    read = layout.reader(*layout.objects)
    return lambda data: read(data)[0]


class CommandEncoder(Protocol):
    """From controlword, speed (mm/s) and preload (N) to the command PDO's payload."""

    def __call__(self, controlword: int, speed_mm_s: float, preload_n: float = 0.0) -> bytes:
        """The payload."""


def command_encoder(layout: PdoLayout, drive: DriveUnits, rated_force_n: float | None = None) -> CommandEncoder:
    """Payload of the command PDO (CiA 402: 0x6040, 0x60FF, 0x60B2; 0x6060 where a fixed mapping has it).

    A speed that is not finite or does not fit is sent as zero, because no such number may reach the actuator. A preload
    ends at the rated torque.
    """
    pack, unit_mm_s = layout.codec.pack, drive.speed_mm_s
    known = ((od.CONTROLWORD, 0), (od.TARGET_VELOCITY, 0), (od.MODE_OF_OPERATION, 0), (od.TORQUE_OFFSET, 0))
    unit_n = math.inf if rated_force_n is None else rated_force_n * od.PER_TORQUE_UNIT
    in_order = itemgetter(*[known.index(each) for each in layout.objects])

    def encode(controlword: int, speed_mm_s: float, preload_n: float = 0.0) -> bytes:
        raw = round(units) if math.isfinite(units := speed_mm_s / unit_mm_s) else 0
        speed = raw if -_COMMAND_LIMIT <= raw <= _COMMAND_LIMIT else 0
        torque = round(min(max(preload_n / unit_n, -_RATED_TORQUE), _RATED_TORQUE))
        return pack(*in_order((controlword, speed, od.CYCLIC_SYNCHRONOUS_VELOCITY, torque)))

    return encode
