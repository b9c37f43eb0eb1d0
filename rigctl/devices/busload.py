"""Worst-case load of the CAN bus with the frames of a rig file."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import ValidationError

from rigctl.config.changed_settings import changed
from rigctl.config.plain import PlainMessage
from rigctl.config.settings import RigSettings
from rigctl.devices import objects as od
from rigctl.devices import sdo
from rigctl.devices.process_data import (
    CELL_TEMPERATURE,
    COMMAND,
    DRIVE_ENABLE,
    DRIVE_SPEED,
    DRIVE_STATUS,
    SECOND_FORCE,
    ProcessData,
    wanted,
)

LIMIT = 0.8
_RATES_HZ = (4000, 2000, 1000, 500, 250, 200, 100)
_BIT_RATES = (125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Bit rates of CANopen (CiA 301), for a bus as short as each allows."""


@dataclass(frozen=True)
class Traffic:
    """One kind of frame: data bytes and frames per second."""

    name: str
    size: int
    rate_hz: float

    @property
    def bit_s(self) -> float:
        """Bits per second, with the most stuffing possible in every frame."""
        return od.frame_bits(self.size) * self.rate_hz


def traffic(settings: RigSettings, process_data: ProcessData | None = None) -> list[Traffic]:
    """Cyclic frames of the rig, both ways. ``process_data``: as read back; None: as the rig file has it."""
    rate = float(settings.loop.rate_hz)
    size = {name: layout.size for name, layout in (process_data or wanted(settings)).frames.items()}
    plain = settings.plain_messages
    cell, slope = plain.get("tension_cell"), plain.get("inclinometer")
    warm = settings.cell_temperature_divisor
    rail, status, io = settings.rail_encoder, settings.cylinder.status_rate_hz, settings.io
    second, beats_hz = settings.second_force, 1000.0 / settings.can.heartbeat_ms
    return [
        Traffic("SYNC", 0, rate),
        Traffic("command", size[COMMAND], rate),
        _plain("tension", cell, settings) if cell else Traffic("tension", size["tension_cell"], rate),
        Traffic("drive status", size["cylinder"], rate),
        *([Traffic("drive speed", size[DRIVE_SPEED], rate)] if DRIVE_SPEED in size else []),
        _plain("inclination", slope, settings)
        if slope
        else Traffic("inclination", size["inclinometer"], float(settings.inclinometer.rate_hz)),
        *([Traffic("cell temperature", size[CELL_TEMPERATURE], rate / warm)] if warm else []),
        *([Traffic("drive inputs", size[DRIVE_STATUS], float(status))] if status else []),
        *([Traffic("rail angle", size["rail_encoder"], float(rail.rate_hz))] if rail else []),
        *([Traffic("second force path", size[SECOND_FORCE], float(second.rate_hz))] if second else []),
        *([Traffic("I/O inputs", size["io"], 1000.0 / io.inhibit_ms)] if io else []),
        *([Traffic("I/O outputs", size[DRIVE_ENABLE], beats_hz)] if DRIVE_ENABLE in size else []),
        Traffic("settings read back, request", sdo.SIZE, rate / sdo.every_ticks(settings)),
        Traffic("settings read back, answer", sdo.SIZE, rate / sdo.every_ticks(settings)),
        Traffic("heartbeat, controller", 1, beats_hz),
        Traffic("heartbeats, devices", 1, len(settings.canopen_nodes) * 1000.0 / od.DEVICE_HEARTBEAT_MS),
    ]


def _plain(name: str, message: PlainMessage, settings: RigSettings) -> Traffic:
    """A frame of a DBC file: at its cycle time, or at the loop's rate where the DBC file has none."""
    return Traffic(f"{name} ({message.name})", message.size, message.rate_hz(settings.loop.rate_hz))


def bus_load(settings: RigSettings, process_data: ProcessData | None = None) -> float | None:
    """Fraction of the bit rate in use at worst; None where the bus has no bit timing. Arguments: see `traffic`."""
    bitrate = settings.can.bitrate_bit_s
    return sum(t.bit_s for t in traffic(settings, process_data)) / bitrate if bitrate else None


def advice(settings: RigSettings) -> str:
    """What brings the load within the limit: the fastest loop and the slowest bit rate that do; "" if neither does."""
    rates = [("loop.rate_hz", rate) for rate in _RATES_HZ if rate < settings.loop.rate_hz]
    bit_rates = [("can.bitrate_bit_s", rate) for rate in _BIT_RATES if rate > (settings.can.bitrate_bit_s or 0)]
    found = []
    for choices in (rates, bit_rates):
        for key, value in choices:
            load = _load_with(settings, key, value)
            if load is not None and load <= LIMIT:
                found.append(f"{key} {value} makes it {load:.1%}")
                break
    return ", ".join(found)


def _load_with(settings: RigSettings, key: str, value: int) -> float | None:
    """The load with another value; None where the other settings do not allow it."""
    try:
        return bus_load(RigSettings.model_validate(changed(settings, {key: value}).model_dump()))
    except ValidationError:
        return None
