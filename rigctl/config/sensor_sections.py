"""The sensors' sections of a rig file: tension cell and inclinometer, CANopen or plain frames by a DBC file."""

from __future__ import annotations

import math

from pydantic import Field

from rigctl.config.plain import PlainMessage
from rigctl.config.settings_base import CanopenDevice, NodeId, Settings


class DbcSettings(Settings):
    """Plain frames described by a DBC file; with such a section, ``node`` and ``eds`` of the device do not apply."""

    file: str = Field(min_length=1, description="DBC file, relative to the rig file")
    message: str = Field(min_length=1, description="the message's name")
    valid: str | None = Field(default=None, min_length=1, description="signal, 0 while it cannot measure; null = none")


class TensionDbcSettings(DbcSettings):
    """The tension cell's message."""

    tension: str = Field(min_length=1, description="signal, unit N")


class InclinationDbcSettings(DbcSettings):
    """The inclinometer's message."""

    tangential: str = Field(min_length=1, description="signal, unit deg or rad")
    normal: str = Field(min_length=1, description="signal, unit deg or rad")


class TensionCellSettings(CanopenDevice):
    """Tension amplifier, CiA 404 or any with plain frames."""

    node: NodeId = 2
    eds: str = Field(default="eds/tension_amplifier.eds", description="EDS file, relative to the rig file")
    range_n: float = Field(gt=0, le=100_000, description="rated range of the cell")
    noise_n: float = Field(gt=0, le=100, description="noise, rms, per sample")
    filter_hz: float | None = Field(
        default=None, gt=0, le=10_000, description="low-pass of the amplifier, first order, null = none or unknown"
    )
    dbc: TensionDbcSettings | None = Field(default=None, description="plain frames, null = CANopen")

    @property
    def late_s(self) -> float:
        """What the low-pass makes a slow tension late by."""
        return 0.0 if self.filter_hz is None else 1.0 / (2.0 * math.pi * self.filter_hz)


class InclinometerSettings(CanopenDevice):
    """Two-axis inclinometer, CiA 410 or any with plain frames.

    Slope long is the tangential angle, slope lateral the normal one.
    """

    node: NodeId = 3
    eds: str = Field(default="eds/inclinometer.eds", description="EDS file, relative to the rig file")
    rate_hz: int = Field(ge=1, le=1000, description="sample rate; a divisor of the loop's")
    range_deg: float = Field(default=30.0, gt=0, le=90, description="measuring range")
    dbc: InclinationDbcSettings | None = Field(default=None, description="plain frames, null = CANopen")


class PlainMessages(Settings):
    """Messages of the DBC files, as read when the rig file was loaded."""

    tension_cell: PlainMessage | None = None
    inclinometer: PlainMessage | None = None
