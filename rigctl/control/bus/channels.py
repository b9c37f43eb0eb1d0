"""The frames of the rig's devices: a channel decodes one kind, and holds its newest sample with time and quality.

A frame that a rig does not have has no channel; what reads its sample reads one that has never come (``No...``).
"""

from __future__ import annotations

import math
from collections.abc import Callable

from rigctl.config.io_section import IoSettings
from rigctl.config.rail_sections import RailEncoderSettings
from rigctl.config.second_force_section import SecondForceSettings
from rigctl.config.settings import RigSettings
from rigctl.control.bus.cell_correction import CellCorrection, CellHistory
from rigctl.control.bus.second_force import SecondForce
from rigctl.devices import codecs
from rigctl.devices.objects import PdoLayout
from rigctl.devices.process_data import DriveUnits
from rigctl.ipc.correction import Correction
from rigctl.model.samples import Quality

NEVER_NS = -(1 << 61)
OVERRANGE = 1.2  # a cell may read this much of its rated range
_SATURATED, _INVALID = Quality.SATURATED.value, Quality.INVALID.value
_NEVER = Quality.NEVER.value

Data = bytes | bytearray
Take = Callable[[Data, int], None]
"""Takes the data of a frame received at a time in ns; a ValueError: the frame is refused."""
DecodeTension = Callable[[Data], tuple[float, int]]
DecodeAngles = Callable[[Data], tuple[float, float, int]]
"""From `rigctl.devices.codecs` or `rigctl.devices.dbc`; the last value is the quality."""


class CellChannel:
    """Tension along the rope, N.

    ``reading_n``: uncorrected. ``corrected_n``: by zero, scale and creep. ``tension_n``: the same, fused with the
    second force path where there is one. All of the newest good sample, NaN before; ``quality``, ``t_ns``: of the
    newest sample.
    """

    def __init__(self, settings: RigSettings, decode: DecodeTension, correction: CellCorrection) -> None:
        self._decode, self._correction = decode, correction
        self._largest_n = settings.tension_cell.range_n * OVERRANGE
        self.reading_n = self.corrected_n = self.tension_n = math.nan
        self.quality, self.t_ns = _NEVER, NEVER_NS

    def take(self, data: Data, now_ns: int) -> None:
        """Take a tension; a reading beyond the cell's range is saturated even if the device reports it as good.

        Raises:
            ValueError: wrong length; or no number, which is taken as an invalid sample all the same.
        """
        reading_n, quality = self._decode(data)
        if not quality and abs(reading_n) > self._largest_n:
            quality = _SATURATED
        if not quality:
            self.reading_n = reading_n
            self.corrected_n = self.tension_n = self._correction.tension_n(reading_n, now_ns)
        self.quality, self.t_ns = quality, now_ns
        if math.isnan(reading_n):
            raise ValueError("no number")

    def fuse(self, stroke_mm: float, speed_mm_s: float, now_ns: int) -> None:
        """Fuse with the second force path, once all frames of the tick are there; here there is none."""

    def correct(self, correction: Correction, *, held_s: float = math.nan, history: CellHistory | None = None) -> None:
        """Put another correction in force, for the newest sample too; see `CellCorrection.put`."""
        self._correction.put(correction, held_s=held_s, history=history)
        self.corrected_n = self.tension_n = self._correction.newest_n(self.reading_n)


class FusedCellChannel(CellChannel):
    """The cell of a rig with a second force path."""

    def __init__(
        self, settings: RigSettings, decode: DecodeTension, correction: CellCorrection, second: SecondForce
    ) -> None:
        super().__init__(settings, decode, correction)
        self._second = second

    def take(self, data: Data, now_ns: int) -> None:
        """See `CellChannel.take`."""
        super().take(data, now_ns)
        if not self.quality:
            self.tension_n = self.corrected_n + self._second.offset_n

    def fuse(self, stroke_mm: float, speed_mm_s: float, now_ns: int) -> None:
        """Compare the second force path with the cell and fuse both, once all frames of the tick are there."""
        second = self._second
        second.look(self.corrected_n, stroke_mm, speed_mm_s, now_ns)
        self.tension_n = self.corrected_n + second.offset_n + second.quick_n

    def correct(self, correction: Correction, *, held_s: float = math.nan, history: CellHistory | None = None) -> None:
        """See `CellChannel.correct`; the second path's zero and scale are part of it."""
        super().correct(correction, held_s=held_s, history=history)
        self._second.put(correction)
        self.tension_n = self.corrected_n + self._second.offset_n


class SecondForceChannel:
    """Sample of the second force path, N or mm."""

    def __init__(self, section: SecondForceSettings, layout: PdoLayout, second: SecondForce) -> None:
        self._second, in_n, per_mm = second, section.kind == "cell", section.counts_per_mm
        self._decode = codecs.tension_decoder(layout) if in_n else codecs.linear_decoder(layout, per_mm)

    def take(self, data: Data, now_ns: int) -> None:
        """Take a sample."""
        value, quality = self._decode(data)
        self._second.take(value, quality, now_ns)


class NoCellTemperature:
    """A rig whose cell sends no temperature."""

    t_ns = NEVER_NS


class CellTemperatureChannel(NoCellTemperature):
    """Temperature of the tension cell, deg C, which moves its zero."""

    def __init__(self, layout: PdoLayout, correction: CellCorrection) -> None:
        self._decode, self._correction = codecs.temperature_decoder(layout), correction

    def take(self, data: Data, now_ns: int) -> None:
        """Take a temperature."""
        self._correction.feel(self._decode(data), now_ns)
        self.t_ns = now_ns


class SlopeChannel:
    """Tangential and normal angle of the rope, rad, of the newest good sample; quality and time of the newest."""

    def __init__(self, settings: RigSettings, decode: DecodeAngles) -> None:
        self._decode = decode
        self._largest_rad = math.radians(settings.inclinometer.range_deg)
        self.tangential_rad = self.normal_rad = 0.0
        self.quality, self.t_ns = _NEVER, NEVER_NS

    def take(self, data: Data, now_ns: int) -> None:
        """Take an inclination; one beyond the sensor's range is invalid even if the device reports it as good.

        Raises:
            ValueError: wrong length; or no number, which is taken as an invalid sample all the same.
        """
        tangential_rad, normal_rad, quality = self._decode(data)
        if not quality and (abs(tangential_rad) > self._largest_rad or abs(normal_rad) > self._largest_rad):
            quality = _INVALID
        if not quality:
            self.tangential_rad, self.normal_rad = tangential_rad, normal_rad
        self.quality, self.t_ns = quality, now_ns
        if math.isnan(tangential_rad):
            raise ValueError("no number")


class DriveChannel:
    """Statusword, stroke in mm and speed in mm/s of the drive; ``quantum_mm``: resolution of the stroke."""

    def __init__(self, layout: PdoLayout, units: DriveUnits) -> None:
        self._decode = codecs.drive_decoder(layout, units)
        self.quantum_mm = units.position_mm
        self.statusword, self.stroke_mm, self.speed_mm_s = 0, math.nan, 0.0
        self.t_ns = NEVER_NS

    def take(self, data: Data, now_ns: int) -> None:
        """Take a sample."""
        self.statusword, self.stroke_mm, self.speed_mm_s = self._decode(data)
        self.t_ns = now_ns


class SplitDriveChannel(DriveChannel):
    """A drive that sends statusword and stroke in one frame, and speed in another."""

    def __init__(
        self, layout: PdoLayout, speed_layout: PdoLayout, units: DriveUnits, *, speed_comes_last: bool
    ) -> None:
        """``speed_comes_last``: of the two frames of a SYNC."""
        super().__init__(layout, units)
        self._decode_speed = codecs.drive_speed_decoder(speed_layout, units)
        self._speed_comes_last = speed_comes_last
        # Values and times that wait for their partner; the times are unequal where one of them does not wait.
        self._stroke_mm, self._stroke_t_ns, self._speed_mm_s, self._speed_t_ns = math.nan, NEVER_NS, 0.0, NEVER_NS + 1

    def take(self, data: Data, now_ns: int) -> None:
        """Take statusword and stroke."""
        self.statusword, self._stroke_mm, _ = self._decode(data)
        self._stroke_t_ns = now_ns
        if not self._speed_comes_last:
            self._join(now_ns)

    def take_speed(self, data: Data, now_ns: int) -> None:
        """Take a speed."""
        self._speed_mm_s = self._decode_speed(data)
        self._speed_t_ns = now_ns
        if self._speed_comes_last:
            self._join(now_ns)

    def _join(self, now_ns: int) -> None:
        """Make one sample of stroke and speed from two frames, once the second has come in the same tick.

        A frame without its partner is dropped: stroke and speed of two SYNCs are no sample.
        """
        if self._stroke_t_ns == self._speed_t_ns:
            self.stroke_mm, self.speed_mm_s = self._stroke_mm, self._speed_mm_s
            self.t_ns = now_ns
        self._stroke_t_ns, self._speed_t_ns = NEVER_NS, NEVER_NS + 1


class NoDriveStatus:
    """A rig whose drive sends no status.

    ``current_a``, ``temperature_c``: of the motor. ``e_stop``: the emergency stop reads as pressed, by the newer of
    the drive's input and its emergency message.
    """

    current_a = temperature_c = math.nan
    e_stop = False
    t_ns = NEVER_NS

    def report_external(self) -> None:
        """The drive reports an external error."""


class DriveStatusChannel(NoDriveStatus):
    """Current, temperature and digital inputs of the drive."""

    def __init__(self, settings: RigSettings, layout: PdoLayout, correction: CellCorrection) -> None:
        e_stop, compensation = settings.cylinder.e_stop_input, settings.compensation
        self._decode, self._correction = codecs.drive_status_decoder(layout), correction
        self._warms_cell = compensation is not None and compensation.temperature == "drive"
        self._e_stop_bit = 1 << e_stop if e_stop is not None else 0
        self._rated_current_a = settings.cylinder.rated_current_a or math.nan

    def take(self, data: Data, now_ns: int) -> None:
        """Take a status."""
        current, self.temperature_c, inputs = self._decode(data)
        self.current_a = current * self._rated_current_a
        if self._e_stop_bit:
            self.e_stop = not inputs & self._e_stop_bit
        self.t_ns = now_ns
        if self._warms_cell:
            self._correction.feel(self.temperature_c, now_ns)

    def report_external(self) -> None:
        """An external error is the emergency stop, before its input, which comes with the next status."""
        if self._e_stop_bit:
            self.e_stop = True


class NoInputs:
    """A rig without an I/O node.

    ``e_stop``: the emergency stop reads as pressed. ``drive_off``: the drive's STO feedback, where the node has it.
    """

    e_stop = drive_off = False
    t_ns = NEVER_NS


class InputsChannel(NoInputs):
    """Digital inputs of the I/O node."""

    def __init__(self, section: IoSettings, layout: PdoLayout) -> None:
        self._decode, self._mask, self._off_mask = codecs.inputs_decoder(layout), section.mask, section.off_mask
        self._opened_ns = NEVER_NS

    def take(self, data: Data, now_ns: int) -> None:
        """Take the inputs. An open contact in any frame of a tick counts: a bouncing contact was pressed."""
        inputs = self._decode(data)
        if not inputs & self._mask:
            self._opened_ns = now_ns
        self.drive_off = inputs & self._off_mask != 0
        self.e_stop = self._opened_ns == now_ns
        self.t_ns = now_ns


class NoRail:
    """A rig without a rail encoder. ``rad``: newest good angle; ``quality``, ``t_ns``: of the newest."""

    rad = 0.0
    quality = _NEVER
    t_ns = NEVER_NS


class RailChannel(NoRail):
    """Angle of the rail encoder."""

    def __init__(self, section: RailEncoderSettings, layout: PdoLayout) -> None:
        self._decode = codecs.encoder_decoder(layout, section.counts_per_turn)
        self._in_error = self._restarted = False

    def take(self, data: Data, now_ns: int) -> None:
        """Take an angle; it is invalid while the encoder reports an error, and after an unverified restart."""
        angle_rad = self._decode(data)
        self.quality = _INVALID if self._in_error or self._restarted else 0
        if not self.quality:
            self.rad = angle_rad
        self.t_ns = now_ns

    def report(self, *, in_error: bool) -> None:
        """The encoder reports an error, or the end of it."""
        self._in_error = in_error

    def restart(self) -> None:
        """The encoder has restarted, with unverified settings."""
        self._restarted = True
