"""The bus read to empty: each frame to the channel that takes it, and which of those due are missing."""

from __future__ import annotations

import can

from rigctl.config.settings import RigSettings
from rigctl.control.bus.cell_correction import CellCorrection
from rigctl.control.bus.channels import (
    NEVER_NS,
    CellChannel,
    CellTemperatureChannel,
    DriveChannel,
    DriveStatusChannel,
    FusedCellChannel,
    InputsChannel,
    NoCellTemperature,
    NoDriveStatus,
    NoInputs,
    NoRail,
    RailChannel,
    SecondForceChannel,
    SlopeChannel,
    SplitDriveChannel,
    Take,
)
from rigctl.control.bus.network_state import NetworkState, OptionalDevice
from rigctl.control.bus.readback import Readback
from rigctl.control.bus.second_force import NoSecondForce, SecondForce
from rigctl.devices import codecs, dbc
from rigctl.devices.frame_kind import OWN_KIND, kind_of
from rigctl.devices.process_data import CELL_TEMPERATURE, DRIVE_SPEED, DRIVE_STATUS, SECOND_FORCE, ProcessData, wanted
from rigctl.ipc.record import FrameFlag
from rigctl.ipc.ring import RingWriter

MAX_FRAMES_PER_TICK = 256
_UNCOUNTED = -1


def _flagged(message: can.Message) -> int:
    """Identifier of an extended, remote or error frame, with its flags."""
    can_id = message.arbitration_id & 0x1FFFFFFF
    can_id |= FrameFlag.EXTENDED.value if message.is_extended_id else 0
    can_id |= FrameFlag.REMOTE.value if message.is_remote_frame else 0
    return can_id | (FrameFlag.ERROR.value if message.is_error_frame else 0)


class Inbox:
    """Drains the bus to empty without blocking and decodes by CAN id; foreign ids are only counted.

    ``cell``, ``slope``, ``drive``, ``drive_status``, ``cell_temperature``, ``rail``, ``inputs``, ``second``: the newest
    samples, see `rigctl.control.bus.channels`. ``cell_fresh``, ``slope_fresh``, ``drive_fresh``, ``rail_fresh``: a good
    one has come in this tick. ``network``: state of nodes and bus. ``bus_t_ns``: when the last frame came.
    """

    def __init__(
        self,
        bus: can.BusABC,
        settings: RigSettings,
        frames: RingWriter,
        readback: Readback,
        process_data: ProcessData | None = None,
    ) -> None:
        """``frames``: ring for every frame received. ``readback``: takes the SDO answers.

        ``process_data``: as the devices have it; None: as the rig file has it.
        """
        self._bus, self._frames = bus, frames
        self._channels: dict[int, tuple[Take, int]] = {}  # what takes a frame, and its place in the counters
        self._divisors: list[int] = []  # SYNCs per frame
        self.cell_correction = CellCorrection(settings)
        data, optional = process_data or wanted(settings), dict[int, OptionalDevice]()
        self._add_cell(settings, data, optional)
        self._add_slope(settings, data)
        self._add_drive(settings, data)
        self._add_fitted(settings, data, optional)
        self.network = NetworkState(settings, readback, self.drive_status, optional)
        for can_id, take in self.network.channels(settings).items():
            self._add(can_id, take)
        self.cell_fresh = self.drive_fresh = self.slope_fresh = self.rail_fresh = False
        self.bus_t_ns = NEVER_NS
        self.received = self.refused = self.receive_failures = 0
        self.failure_text = ""  # of the last failed receive
        # Frames of each channel that answers SYNCs since its first one; SYNCs sent at that first frame.
        places = len(self._divisors)
        self._counts, self._bases, self._syncs = [0] * places, [-1] * places, 0

    def _add(self, can_id: int, take: Take, divisor: int = 0) -> None:
        """Add a channel; ``divisor``: SYNCs per frame, 0 of a frame that answers none."""
        self._channels[can_id] = take, len(self._divisors) if divisor else _UNCOUNTED
        if divisor:
            self._divisors.append(divisor)

    def _add_cell(self, settings: RigSettings, data: ProcessData, optional: dict[int, OptionalDevice]) -> None:
        """The cell, and the second force path that is fused with it."""
        layouts, ids = data.frames, data.can_ids(settings)
        message, section = settings.plain_messages.get("tension_cell"), settings.second_force
        in_n = codecs.tension_decoder(layouts["tension_cell"]) if message is None else dbc.tension_decoder(message)
        self.second = NoSecondForce()
        self.cell = CellChannel(settings, in_n, self.cell_correction)
        if section is not None:
            second = SecondForce(section, settings.tension_cell.noise_n, settings.loop.period_ns * 1e-9)
            self.second = optional[section.node] = second
            self.cell = FusedCellChannel(settings, in_n, self.cell_correction, second)
            sample = SecondForceChannel(section, layouts[SECOND_FORCE], second)
            self._add(ids[SECOND_FORCE], sample.take, settings.loop.rate_hz // section.rate_hz)
        if message is None:
            self._add(ids["tension_cell"], self.cell.take, 1)
        else:
            self._add(message.can_id, self.cell.take)
        self.cell_temperature = NoCellTemperature()
        if CELL_TEMPERATURE in layouts:
            temperature = CellTemperatureChannel(layouts[CELL_TEMPERATURE], self.cell_correction)
            self.cell_temperature = temperature
            self._add(ids[CELL_TEMPERATURE], temperature.take, settings.cell_temperature_divisor)

    def _add_slope(self, settings: RigSettings, data: ProcessData) -> None:
        message = settings.plain_messages.get("inclinometer")
        if message is None:
            self.slope = SlopeChannel(settings, codecs.inclination_decoder(data.frames["inclinometer"]))
            self._add(data.can_ids(settings)["inclinometer"], self.slope.take, settings.inclinometer_divisor)
        else:
            self.slope = SlopeChannel(settings, dbc.inclination_decoder(message))
            self._add(message.can_id, self.slope.take)

    def _add_drive(self, settings: RigSettings, data: ProcessData) -> None:
        layouts, ids = data.frames, data.can_ids(settings)
        self.drive = DriveChannel(layouts["cylinder"], data.units)
        if DRIVE_SPEED in layouts:
            last = ids[DRIVE_SPEED] > ids["cylinder"]  # the lower identifier is sent first
            split = SplitDriveChannel(layouts["cylinder"], layouts[DRIVE_SPEED], data.units, speed_comes_last=last)
            self.drive = split
            self._add(ids[DRIVE_SPEED], split.take_speed, 1)
        self._add(ids["cylinder"], self.drive.take, 1)
        self.drive_status = NoDriveStatus()
        if DRIVE_STATUS in layouts:
            status = DriveStatusChannel(settings, layouts[DRIVE_STATUS], self.cell_correction)
            self.drive_status = status
            self._add(ids[DRIVE_STATUS], status.take, settings.status_divisor)

    def _add_fitted(self, settings: RigSettings, data: ProcessData, optional: dict[int, OptionalDevice]) -> None:
        """Rail encoder and I/O node."""
        layouts, ids, encoder = data.frames, data.can_ids(settings), settings.rail_encoder
        self.rail, self.inputs = NoRail(), NoInputs()
        if encoder is not None:
            rail = RailChannel(encoder, layouts["rail_encoder"])
            self.rail = optional[encoder.node] = rail
            self._add(ids["rail_encoder"], rail.take, settings.loop.rate_hz // encoder.rate_hz)
        if settings.io is not None:
            inputs = InputsChannel(settings.io, layouts["io"])
            self.inputs = inputs
            self._add(ids["io"], inputs.take)

    def drain(self, now_ns: int, syncs_sent: int) -> None:
        """Read until the bus is empty; samples are stamped ``now_ns``."""
        network, self._syncs = self.network, syncs_sent
        if not network.heartbeats_t_ns:
            network.begin(now_ns)
        receive, channels, frames = self._bus.recv, self._channels, self._frames
        counts, bases = self._counts, self._bases
        for _ in range(MAX_FRAMES_PER_TICK):
            try:
                message = receive(0)
            except can.CanError as error:
                self.receive_failures += 1
                self.failure_text = str(error)
                break
            if message is None:
                break
            can_id, data = message.arbitration_id, message.data
            ours = kind_of(message) == OWN_KIND
            frames.write(now_ns, can_id if ours else _flagged(message), 0, message.dlc, data)
            if message.is_error_frame:
                network.take_error_frame(message)
                continue
            self.received += 1
            self.bus_t_ns = now_ns
            if not ours or can_id not in channels:
                continue
            take, place = channels[can_id]
            try:
                take(data, now_ns)
            except ValueError:
                self.refused += 1
                continue
            if place != _UNCOUNTED:
                if bases[place] < 0:
                    bases[place] = syncs_sent
                counts[place] += 1
        cell, slope, rail = self.cell, self.slope, self.rail
        self.cell_fresh = cell.t_ns == now_ns and not cell.quality
        self.slope_fresh = slope.t_ns == now_ns and not slope.quality
        self.rail_fresh = rail.t_ns == now_ns and not rail.quality
        self.drive_fresh = self.drive.t_ns == now_ns

    def frames_missing(self) -> int:
        """Answers due to the SYNCs sent before this tick that have not come; late ones count until they come.

        Plain frames answer no SYNC, so none is ever due.
        """
        missing, syncs = 0, self._syncs
        for base, count, divisor in zip(self._bases, self._counts, self._divisors, strict=True):
            if base >= 0 and (due := (syncs - base) // divisor + 1) > count:
                missing += due - count
        return missing
