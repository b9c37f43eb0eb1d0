"""The newest sample of every signal, with age and quality, and the other messages received from the bus."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import can

from rigctl.config.plain import PlainMessage
from rigctl.config.settings import RigSettings
from rigctl.control.cell_correction import CellCorrection, CellHistory
from rigctl.control.readback import Readback
from rigctl.control.second_force import SecondForce
from rigctl.devices import can_errors, codecs, dbc, emergency, sdo
from rigctl.devices import objects as od
from rigctl.devices.frame_kind import OWN_KIND, kind_of
from rigctl.devices.objects import PdoLayout
from rigctl.devices.process_data import CELL_TEMPERATURE, DRIVE_SPEED, DRIVE_STATUS, SECOND_FORCE, ProcessData, wanted
from rigctl.ipc.correction import Correction
from rigctl.ipc.record import FrameFlag, Quality
from rigctl.ipc.ring import RingWriter

MAX_FRAMES_PER_TICK = 256
MAX_NOTICES = 32
NEVER_NS = -(1 << 61)
ANSWERED_NS = 1_000_000_000  # an SDO server answers within this time
OVERRANGE = 1.2  # a cell may read this much of its rated range
_SATURATED, _INVALID = Quality.SATURATED.value, Quality.INVALID.value
_NEVER = Quality.NEVER.value
_EMCY_SIZE = 8
_UNCOUNTED = -1


Handler = Callable[[bytes | bytearray, int], None]


@dataclass
class Notices:
    """What the bus gave to report, beside the samples.

    ``emergencies``: node, code | register << 16, the manufacturer's bytes in hexadecimal. ``node_states``: node and its
    new NMT state. ``bus_errors``: error class and its details. ``foreign_sdo``: node, index << 8 | sub, in words.
    """

    emergencies: list[tuple[int, int, bytes]] = field(default_factory=list)
    node_states: list[tuple[int, int]] = field(default_factory=list)
    bus_errors: list[tuple[int, int]] = field(default_factory=list)
    foreign_sdo: list[tuple[int, int, str]] = field(default_factory=list)


def _flagged(message: can.Message) -> int:
    """Identifier of an extended, remote or error frame, with its flags."""
    can_id = message.arbitration_id & 0x1FFFFFFF
    can_id |= FrameFlag.EXTENDED.value if message.is_extended_id else 0
    can_id |= FrameFlag.REMOTE.value if message.is_remote_frame else 0
    return can_id | (FrameFlag.ERROR.value if message.is_error_frame else 0)


def rival_ids(settings: RigSettings) -> list[int]:
    """Identifiers that only a controller of this rig sends: NMT, SYNC, its heartbeat, the drive's command."""
    heartbeat = od.HEARTBEAT_BASE + settings.can.controller_node
    return [od.NMT_COB, od.SYNC_COB, heartbeat, od.DRIVE_RPDO.cob_base + settings.cylinder.node]


def _divisors(settings: RigSettings) -> dict[str, int]:
    """SYNCs per frame, by the name of each frame that answers them."""
    rate, rail, second = settings.loop.rate_hz, settings.rail_encoder, settings.second_force
    return {
        "tension_cell": 1,
        "inclinometer": settings.inclinometer_divisor,
        "cylinder": 1,
        DRIVE_SPEED: 1,
        DRIVE_STATUS: settings.status_divisor or 1,
        CELL_TEMPERATURE: settings.cell_temperature_divisor or 1,
        "rail_encoder": rate // rail.rate_hz if rail is not None else 1,
        SECOND_FORCE: rate // second.rate_hz if second is not None else 1,
    }


class Inbox:
    """Drains the bus to empty without blocking and decodes by CAN id; foreign ids are only counted."""

    def __init__(
        self,
        bus: can.BusABC,
        settings: RigSettings,
        frames: RingWriter | None = None,
        process_data: ProcessData | None = None,
        readback: Readback | None = None,
    ) -> None:
        """``frames``: ring for every frame received, None for no ring. ``readback``: takes the SDO answers.

        ``process_data``: as the devices have it; None: as the rig file has it.
        """
        self._bus, self._frames, self._readback = bus, frames, readback
        self._process_data = process_data or wanted(settings)
        rail = settings.rail_encoder
        divisors = _divisors(settings)
        self._channels, self._divisors = {name: at for at, name in enumerate(divisors)}, tuple(divisors.values())
        section = settings.second_force
        self.second = (
            SecondForce(section, settings.tension_cell.noise_n, settings.loop.period_ns * 1e-9)
            if section is not None
            else None
        )
        compensation = settings.compensation
        self._drive_warms_cell = compensation is not None and compensation.temperature == "drive"
        self._handlers = self._handlers_of(settings)
        e_stop = settings.cylinder.e_stop_input
        self._e_stop_bit = 1 << e_stop if e_stop is not None else 0
        self._rated_current_a = settings.cylinder.rated_current_a or math.nan
        self._drive_node, self._rail_node = settings.cylinder.node, rail.node if rail is not None else 0
        self.cell = CellCorrection(settings)
        self.reading_n = math.nan  # uncorrected
        self.cell_n = math.nan  # corrected
        self.tension_n = math.nan  # the same, fused with the second force path where there is one
        self.cell_quality = _NEVER
        self.cell_t_ns = NEVER_NS
        self.tangential_rad = self.normal_rad = 0.0
        self.slope_quality = _NEVER
        self.slope_t_ns = NEVER_NS
        self.rail_rad = 0.0
        self.rail_quality = _NEVER
        self.rail_t_ns = NEVER_NS
        self._rail_in_error = self._rail_restarted = False
        self.statusword = 0
        self.stroke_mm = math.nan
        self.speed_mm_s = 0.0
        self.drive_t_ns = NEVER_NS
        # For a drive that sends stroke and speed in two frames: values and times, unequal at the start.
        self._stroke_mm, self._stroke_t_ns, self._speed_mm_s, self._speed_t_ns = math.nan, NEVER_NS, 0.0, NEVER_NS + 1
        self.drive_current_a = self.drive_temperature_c = math.nan
        self.drive_status_t_ns = self.warmth_t_ns = NEVER_NS
        # From the newer of the drive's input and its emergency message; from the I/O node's input.
        # The last is the drive's STO feedback, where the I/O node has it.
        self.e_stop = self.io_e_stop = self.io_drive_off = False
        self.bus_t_ns = self.rival_t_ns = self.io_t_ns = self._io_opened_ns = NEVER_NS
        self._foreign_request_ns = NEVER_NS
        self.cell_fresh = self.drive_fresh = self.slope_fresh = self.rail_fresh = False
        self.received = self.refused = self.error_frames = self.receive_failures = 0
        self.failure_text = self.rival_words = ""  # of the last failed receive; what a rival did last
        self._in_error: dict[int, int] = {}  # emergencies of cell, inclinometer and I/O node, the newest last
        self.sensor_emergency = self.drive_emergency = 0  # node << 16 | code of an active emergency, 0 for none
        self._notices = Notices()
        self.restarted = False  # a device booted since start-up, so its verified settings are lost
        self._tension_max_n, self._slope_max_rad = (
            settings.tension_cell.range_n * OVERRANGE, math.radians(settings.inclinometer.range_deg),
        )  # fmt: skip
        self.states: dict[int, int] = {}  # newest NMT state of each node
        self.heartbeats_t_ns: dict[int, int] = {}  # at first of the first tick: start-up has just reached all
        self._nodes = tuple(settings.canopen_nodes.values())
        # Frames of each channel since its first one; SYNCs sent at that first frame.
        self._counts, self._bases, self._syncs = [0] * len(divisors), [-1] * len(divisors), 0

    def _handlers_of(self, settings: RigSettings) -> dict[int, tuple[Handler, int]]:
        """Handlers by identifier, each with its place in the channels; `_UNCOUNTED` of a frame that answers no SYNC."""
        nodes, plain = settings.canopen_nodes, settings.plain_messages
        data = self._process_data
        compiled: dict[str, Callable[[RigSettings, PdoLayout], Handler]] = {
            "tension_cell": self._cell_handler,
            "inclinometer": self._slope_handler,
            "cylinder": self._drive_handler,
            DRIVE_SPEED: self._drive_speed_handler,
            DRIVE_STATUS: self._drive_status_handler,
            CELL_TEMPERATURE: self._temperature_handler,
            "rail_encoder": self._rail_handler,
            "io": self._inputs_handler,
            SECOND_FORCE: self._second_handler,
        }
        ids = data.can_ids(settings)
        self._speed_comes_last = ids.get(DRIVE_SPEED, 0) > ids["cylinder"]  # the lower identifier is sent first
        handlers = {
            ids[name]: (make(settings, data.frames[name]), self._channels.get(name, _UNCOUNTED))
            for name, make in compiled.items()
            if name in ids
        }
        for device, handler in (
            ("tension_cell", self._plain_cell_handler),
            ("inclinometer", self._plain_slope_handler),
        ):
            if device in plain:
                handlers[plain[device].can_id] = handler(plain[device]), _UNCOUNTED
        for node in nodes.values():
            handlers[od.EMCY_BASE + node] = self._emergency_handler(node), _UNCOUNTED
            handlers[od.HEARTBEAT_BASE + node] = self._heartbeat_handler(node), _UNCOUNTED
            handlers[od.SDO_RX_BASE + node] = self._sdo_request_handler(node), _UNCOUNTED
            handlers[od.SDO_TX_BASE + node] = self._sdo_answer_handler(node), _UNCOUNTED
        for can_id in rival_ids(settings):
            handlers[can_id] = self._on_rival, _UNCOUNTED
        return handlers

    def notices(self) -> Notices | None:
        """What is to be reported since the last call, None if nothing."""
        found = self._notices
        if not (found.emergencies or found.node_states or found.bus_errors or found.foreign_sdo):
            return None
        self._notices = Notices()
        return found

    @property
    def quantum_mm(self) -> float:
        """Of the drive's position."""
        return self._process_data.units.position_mm

    def drain(self, now_ns: int, syncs_sent: int) -> None:
        """Read until the bus is empty; samples are stamped ``now_ns``."""
        self.cell_fresh = self.drive_fresh = self.slope_fresh = self.rail_fresh = False
        self._syncs = syncs_sent
        if not self.heartbeats_t_ns:
            self.heartbeats_t_ns.update(dict.fromkeys(self._nodes, now_ns))
        receive, handlers, frames = self._bus.recv, self._handlers, self._frames
        counts, bases = self._counts, self._bases
        for _ in range(MAX_FRAMES_PER_TICK):
            try:
                message = receive(0)
            except can.CanError as error:
                self.receive_failures += 1
                self.failure_text = str(error)
                return
            if message is None:
                return
            can_id, data = message.arbitration_id, message.data
            ours = kind_of(message) == OWN_KIND
            if frames is not None:
                frames.write(now_ns, can_id if ours else _flagged(message), 0, message.dlc, data)
            if message.is_error_frame:
                self._on_error_frame(message)
                continue
            self.received += 1
            self.bus_t_ns = now_ns
            found = handlers.get(can_id) if ours else None
            if found is None:
                continue
            handler, channel = found
            try:
                handler(data, now_ns)
            except ValueError:
                self.refused += 1
                continue
            if channel != _UNCOUNTED:
                if bases[channel] < 0:
                    bases[channel] = syncs_sent
                counts[channel] += 1

    def frames_missing(self) -> int:
        """Answers due to the SYNCs sent before this tick that have not come; late ones count until they come.

        Plain frames answer no SYNC, so none is ever due.
        """
        missing, syncs = 0, self._syncs
        for base, count, divisor in zip(self._bases, self._counts, self._divisors, strict=True):
            if base >= 0 and (due := (syncs - base) // divisor + 1) > count:
                missing += due - count
        return missing

    def _cell_handler(self, _settings: RigSettings, layout: PdoLayout) -> Handler:
        decode = codecs.tension_decoder(layout)

        def on_cell(data: bytes | bytearray, now_ns: int) -> None:
            tension_n, quality = decode(data)
            self._take_cell(tension_n, quality, now_ns)

        return on_cell

    @property
    def correction(self) -> Correction:
        """The cell's correction in force."""
        return self.cell.correction

    def correct(self, correction: Correction, *, held_s: float = math.nan, history: CellHistory | None = None) -> None:
        """Put another correction of the cell in force, for the newest sample too; see `CellCorrection.put`."""
        self.cell.put(correction, held_s=held_s, history=history)
        self.cell_n = self.cell.newest_n(self.reading_n)
        if self.second is not None:
            self.second.put(correction)
        self.tension_n = self.cell_n if self.second is None else self.cell_n + self.second.offset_n

    def fuse(self, now_ns: int) -> None:
        """Compare the second force path with the cell and fuse both, once all frames of the tick are there."""
        if self.second is not None:
            self.second.look(self.cell_n, self.stroke_mm, self.speed_mm_s, now_ns)
            self.tension_n = self.cell_n + self.second.offset_n + self.second.quick_n

    def _take_cell(self, reading_n: float, quality: int, now_ns: int) -> None:
        """Take a tension; a reading beyond the cell's range is saturated even if the device reports it as good."""
        if not quality and abs(reading_n) > self._tension_max_n:
            quality = _SATURATED
        if not quality:
            self.reading_n = reading_n
            self.cell_n = self.cell.tension_n(reading_n, now_ns)
            self.tension_n = self.cell_n if self.second is None else self.cell_n + self.second.offset_n
        self.cell_quality = quality
        self.cell_t_ns = now_ns
        self.cell_fresh = quality == 0

    def _take_slope(self, tangential_rad: float, normal_rad: float, quality: int, now_ns: int) -> None:
        """Take an inclination; one beyond the sensor's range is invalid even if the device reports it as good."""
        if not quality and (abs(tangential_rad) > self._slope_max_rad or abs(normal_rad) > self._slope_max_rad):
            quality = _INVALID
        if not quality:
            self.tangential_rad, self.normal_rad = tangential_rad, normal_rad
        self.slope_quality = quality
        self.slope_t_ns = now_ns
        self.slope_fresh = quality == 0

    def _slope_handler(self, _settings: RigSettings, layout: PdoLayout) -> Handler:
        decode = codecs.inclination_decoder(layout)

        def on_slope(data: bytes | bytearray, now_ns: int) -> None:
            tangential, normal, quality = decode(data)
            self._take_slope(tangential, normal, quality, now_ns)

        return on_slope

    def _drive_handler(self, _settings: RigSettings, layout: PdoLayout) -> Handler:
        decode = codecs.drive_decoder(layout, self._process_data.units)

        def on_drive(data: bytes | bytearray, now_ns: int) -> None:
            self.statusword, self.stroke_mm, self.speed_mm_s = decode(data)
            self.drive_t_ns = now_ns
            self.drive_fresh = True

        def on_place(data: bytes | bytearray, now_ns: int) -> None:
            self.statusword, self._stroke_mm, _ = decode(data)
            self._stroke_t_ns = now_ns
            if not self._speed_comes_last:
                self._take_drive(now_ns)

        return on_place if DRIVE_SPEED in self._process_data.frames else on_drive

    def _drive_speed_handler(self, _settings: RigSettings, layout: PdoLayout) -> Handler:
        decode = codecs.drive_speed_decoder(layout, self._process_data.units)

        def on_speed(data: bytes | bytearray, now_ns: int) -> None:
            self._speed_mm_s = decode(data)
            self._speed_t_ns = now_ns
            if self._speed_comes_last:
                self._take_drive(now_ns)

        return on_speed

    def _take_drive(self, now_ns: int) -> None:
        """Make one sample of stroke and speed from two frames, once the second has come in the same tick.

        A frame without its partner is dropped: stroke and speed of two SYNCs are no sample.
        """
        if self._stroke_t_ns == self._speed_t_ns:
            self.stroke_mm, self.speed_mm_s = self._stroke_mm, self._speed_mm_s
            self.drive_t_ns = now_ns
            self.drive_fresh = True
        self._stroke_t_ns, self._speed_t_ns = NEVER_NS, NEVER_NS + 1

    def _drive_status_handler(self, _settings: RigSettings, layout: PdoLayout) -> Handler:
        decode = codecs.drive_status_decoder(layout)

        def on_drive_status(data: bytes | bytearray, now_ns: int) -> None:
            current, self.drive_temperature_c, inputs = decode(data)
            self.drive_current_a = current * self._rated_current_a
            if self._e_stop_bit:
                self.e_stop = not inputs & self._e_stop_bit
            self.drive_status_t_ns = now_ns
            if self._drive_warms_cell:
                self.cell.feel(self.drive_temperature_c, now_ns)

        return on_drive_status

    def _temperature_handler(self, _settings: RigSettings, layout: PdoLayout) -> Handler:
        decode = codecs.temperature_decoder(layout)

        def on_temperature(data: bytes | bytearray, now_ns: int) -> None:
            self.cell.feel(decode(data), now_ns)
            self.warmth_t_ns = now_ns

        return on_temperature

    def _inputs_handler(self, settings: RigSettings, layout: PdoLayout) -> Handler:
        assert settings.io is not None  # there is no frame without it
        decode, mask, off_mask = codecs.inputs_decoder(layout), settings.io.mask, settings.io.off_mask

        def on_inputs(data: bytes | bytearray, now_ns: int) -> None:
            """An open contact in any frame of a tick counts: a bouncing contact was pressed."""
            inputs = decode(data)
            if not inputs & mask:
                self._io_opened_ns = now_ns
            self.io_drive_off = inputs & off_mask != 0
            self.io_e_stop = self._io_opened_ns == now_ns
            self.io_t_ns = now_ns

        return on_inputs

    def _rail_handler(self, settings: RigSettings, layout: PdoLayout) -> Handler:
        assert settings.rail_encoder is not None  # there is no frame without it
        decode = codecs.encoder_decoder(layout, settings.rail_encoder.counts_per_turn)

        def on_rail(data: bytes | bytearray, now_ns: int) -> None:
            """Take an angle; it is invalid while the encoder reports an error, and after an unverified restart."""
            angle_rad = decode(data)
            good = not (self._rail_in_error or self._rail_restarted)
            if good:
                self.rail_rad = angle_rad
            self.rail_quality = 0 if good else _INVALID
            self.rail_t_ns = now_ns
            self.rail_fresh = good

        return on_rail

    def _second_handler(self, settings: RigSettings, layout: PdoLayout) -> Handler:
        section, second = settings.second_force, self.second
        assert section is not None and second is not None  # there is no frame without it
        per_mm = section.counts_per_mm
        decode = codecs.tension_decoder(layout) if section.kind == "cell" else codecs.linear_decoder(layout, per_mm)

        def on_second(data: bytes | bytearray, now_ns: int) -> None:
            value, quality = decode(data)
            second.take(value, quality, now_ns)

        return on_second

    def _plain_cell_handler(self, message: PlainMessage) -> Handler:
        decode = dbc.tension_decoder(message)

        def on_cell(data: bytes | bytearray, now_ns: int) -> None:
            value, quality = decode(data)
            self.refused += math.isnan(value)
            self._take_cell(value, quality, now_ns)

        return on_cell

    def _plain_slope_handler(self, message: PlainMessage) -> Handler:
        decode = dbc.inclination_decoder(message)

        def on_slope(data: bytes | bytearray, now_ns: int) -> None:
            tangential, normal, quality = decode(data)
            self.refused += math.isnan(tangential)
            self._take_slope(tangential, normal, quality, now_ns)

        return on_slope

    def _on_rival(self, _data: bytes | bytearray, now_ns: int) -> None:
        """A controller's frame. It is another controller's, because the bus does not return our own frames."""
        self.rival_t_ns, self.rival_words = now_ns, "commands this bus"

    def _sdo_request_handler(self, node: int) -> Handler:
        """An SDO request is another master's, because the bus does not return our own frames."""

        def on_request(data: bytes | bytearray, now_ns: int) -> None:
            where = sdo.multiplexer(data)
            self._foreign_request_ns = now_ns
            self._on_foreign_sdo(node, where, sdo.foreign_request(node, data), now_ns)
            if self._readback is not None:
                self._readback.suspect(node, where)

        return on_request

    def _sdo_answer_handler(self, node: int) -> Handler:
        def on_answer(data: bytes | bytearray, now_ns: int) -> None:
            if self._readback is not None and self._readback.take(node, data, now_ns):
                return
            if now_ns - self._foreign_request_ns < ANSWERED_NS:
                self.rival_t_ns = now_ns  # the request has been reported already
            else:
                self._on_foreign_sdo(node, sdo.multiplexer(data), sdo.foreign_answer(node, data), now_ns)

        return on_answer

    def _on_foreign_sdo(self, node: int, where: tuple[int, int] | None, words: str, now_ns: int) -> None:
        self.rival_t_ns, self.rival_words = now_ns, words
        if len(self._notices.foreign_sdo) < MAX_NOTICES:
            index, sub = where or (0, 0)
            self._notices.foreign_sdo.append((node, index << 8 | sub, words))

    def _emergency_handler(self, node: int) -> Handler:
        def on_emergency(data: bytes | bytearray, _now_ns: int) -> None:
            if len(data) != _EMCY_SIZE:
                raise ValueError("length")
            code, register = data[0] | data[1] << 8, data[2]
            error = emergency.stands(code, register)
            if node == self._rail_node:
                self._rail_in_error = error
            elif self.second is not None and node == self.second.node:
                self.second.report(in_error=error)
            elif node == self._drive_node:
                self.drive_emergency = node << 16 | code if error else 0
                if code == od.EmcyCode.EXTERNAL and self._e_stop_bit:
                    self.e_stop = True  # before the input, which comes with the next status
            else:
                self._in_error.pop(node, None)
                if error:
                    self._in_error[node] = node << 16 | code
                self.sensor_emergency = next(reversed(self._in_error.values()), 0)
            if len(self._notices.emergencies) < MAX_NOTICES:
                self._notices.emergencies.append((node, code | register << 16, data[3:].hex().encode()))

        return on_emergency

    def _heartbeat_handler(self, node: int) -> Handler:
        def on_heartbeat(data: bytes | bytearray, now_ns: int) -> None:
            if len(data) != 1:
                raise ValueError("length")
            state = data[0] & 0x7F
            if state == od.NmtState.BOOT_UP:
                if node == self._rail_node:  # only the run-out table needs it
                    self._rail_restarted = True
                elif self.second is not None and node == self.second.node:  # the cell leads without it
                    self.second.restart()
                else:
                    self.restarted = True
            if self.states.get(node) != state and len(self._notices.node_states) < MAX_NOTICES:
                self._notices.node_states.append((node, state))
            self.states[node] = state
            self.heartbeats_t_ns[node] = now_ns

        return on_heartbeat

    def _on_error_frame(self, message: can.Message) -> None:
        self.error_frames += 1
        if len(self._notices.bus_errors) < MAX_NOTICES:
            self._notices.bus_errors.append((message.arbitration_id & 0x1FFFFFFF, can_errors.details(message.data)))
