"""The newest sample of every signal, with age and quality, and what else came over the bus."""

from __future__ import annotations

import math
from collections.abc import Callable

import can

from rigctl.config import RigSettings
from rigctl.control.correction import Correction
from rigctl.control.readback import Readback
from rigctl.devices import codecs, dbc, sdo
from rigctl.devices import objects as od
from rigctl.devices.plain import PlainMessage
from rigctl.telemetry import can_errors
from rigctl.telemetry.record import FrameFlag, Quality
from rigctl.telemetry.ring import RingWriter

MAX_FRAMES_PER_TICK = 256
MAX_NOTICES = 32
NEVER_NS = -(1 << 61)
ANSWERED_NS = 1_000_000_000  # an SDO server answers sooner
OVERRANGE = 1.2  # a cell reads somewhat beyond its rated range, not more
_SATURATED, _INVALID = Quality.SATURATED.value, Quality.INVALID.value
_NEVER = Quality.NEVER.value
_EMCY_SIZE = 8


Handler = Callable[[bytes | bytearray, int], None]


def _flagged(message: can.Message) -> int:
    """Identifier of a frame that is no plain one, with the flags that say so."""
    can_id = message.arbitration_id & 0x1FFFFFFF
    can_id |= FrameFlag.EXTENDED.value if message.is_extended_id else 0
    can_id |= FrameFlag.REMOTE.value if message.is_remote_frame else 0
    return can_id | (FrameFlag.ERROR.value if message.is_error_frame else 0)


def rival_ids(settings: RigSettings) -> list[int]:
    """Identifiers of what only a controller of this rig sends: NMT, SYNC, its heartbeat, the drive's command."""
    heartbeat = od.HEARTBEAT_BASE + settings.can.controller_node
    return [od.NMT_COB, od.SYNC_COB, heartbeat, od.DRIVE_RPDO.cob_base + settings.cylinder.node]


class Inbox:
    """Drains the bus to empty without blocking and decodes by CAN id; foreign ids are only counted."""

    def __init__(
        self,
        bus: can.BusABC,
        settings: RigSettings,
        frames: RingWriter | None = None,
        readback: Readback | None = None,
    ) -> None:
        """``frames``: where every frame that comes is kept, None for nowhere. ``readback``: whose SDO answers come."""
        self._bus, self._frames, self._readback = bus, frames, readback
        rail = settings.rail_encoder
        self._divisors: tuple[int, ...] = (1, settings.inclinometer_divisor, 1)
        self._divisors += (settings.loop.rate_hz // rail.rate_hz if rail is not None else 1,)
        self._divisors += (settings.status_divisor or 1,)
        self._handlers = self._handlers_of(settings)
        e_stop = settings.cylinder.e_stop_input
        self._e_stop_bit = 1 << e_stop if e_stop is not None else 0
        self._io_mask = settings.io.mask if settings.io is not None else 0
        self._rated_current_a = settings.cylinder.rated_current_a or math.nan
        self._drive_node, self._rail_node = settings.cylinder.node, rail.node if rail is not None else 0
        self._counts_per_turn = rail.counts_per_turn if rail is not None else 1
        self.correction = Correction()
        self.reading_n = math.nan  # as the cell sends it
        self.tension_n = math.nan  # corrected
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
        self.drive_current_a = self.drive_temperature_c = math.nan
        self.drive_status_t_ns = NEVER_NS
        # By the newest of the drive's input and its emergency message; by the I/O node's input.
        self.e_stop = self.io_e_stop = False
        self.bus_t_ns = self.rival_t_ns = self.io_t_ns = self._io_opened_ns = NEVER_NS
        self._foreign_request_ns = NEVER_NS
        self.cell_fresh = self.drive_fresh = self.slope_fresh = self.rail_fresh = False
        self.received = self.refused = self.error_frames = self.receive_failures = self._syncs = 0
        self.failure_text = self.rival_words = ""  # of the last receive that failed; what the rival heard last did
        self._in_error: set[int] = set()
        self.sensors_in_error = 0  # cell, inclinometer and I/O node with an emergency that stands
        self.drive_in_error = False
        self.emergencies: list[tuple[int, int]] = []  # (node, code) since last taken
        self.node_states: list[tuple[int, int]] = []  # (node, NMT state) changes since last taken
        self.bus_errors: list[tuple[int, int]] = []  # (error class, its details) since last taken
        self.foreign_sdo: list[tuple[int, int, str]] = []  # (node, index << 8 | sub, in words) since last taken
        self.restarted = False  # a device booted since start-up: what was set and verified there is gone
        self._tension_max_n = settings.tension_cell.range_n * OVERRANGE
        self._slope_max_rad = math.radians(settings.inclinometer.range_deg)
        self._states: dict[int, int] = {}
        self._counts = [0] * 5  # cell, slope, drive, rail, drive status frames since the first of each
        self._bases = [-1] * 5  # SYNCs sent when the first came

    def _handlers_of(self, settings: RigSettings) -> dict[int, Handler]:
        """What to do with the frames of each identifier that means something."""
        nodes, plain = settings.canopen_nodes, settings.plain_messages
        handlers: dict[int, Handler] = {}
        for device, base, on_frame in (
            ("tension_cell", od.CELL_TPDO.cob_base, self._on_cell),
            ("inclinometer", od.SLOPE_TPDO.cob_base, self._on_slope),
            ("cylinder", od.DRIVE_TPDO.cob_base, self._on_drive),
            ("rail_encoder", od.ENCODER_TPDO.cob_base, self._on_rail),
            ("io", od.TPDO1_BASE, self._on_inputs),
        ):
            if device in nodes:
                handlers[base + nodes[device]] = on_frame
        for device, handler in (
            ("tension_cell", self._plain_cell_handler),
            ("inclinometer", self._plain_slope_handler),
        ):
            if device in plain:
                handlers[plain[device].can_id] = handler(plain[device])
        for node in nodes.values():
            handlers[od.EMCY_BASE + node] = self._emergency_handler(node)
            handlers[od.HEARTBEAT_BASE + node] = self._heartbeat_handler(node)
            handlers[od.SDO_RX_BASE + node] = self._sdo_request_handler(node)
            handlers[od.SDO_TX_BASE + node] = self._sdo_answer_handler(node)
        for can_id in rival_ids(settings):
            handlers[can_id] = self._on_rival
        if settings.status_divisor:
            handlers[od.DRIVE_TPDO2.cob_base + settings.cylinder.node] = self._on_drive_status
        return handlers

    def drain(self, now_ns: int, syncs_sent: int) -> None:
        """Read until the bus is empty; samples are stamped ``now_ns``."""
        self.cell_fresh = self.drive_fresh = self.slope_fresh = self.rail_fresh = False
        self._syncs = syncs_sent
        receive, handlers, frames = self._bus.recv, self._handlers, self._frames
        for _ in range(MAX_FRAMES_PER_TICK):
            try:
                message = receive(0)
            except can.CanError as error:
                self.receive_failures += 1
                self.failure_text = str(error)
                return
            if message is None:
                return
            if frames is not None:
                can_id = message.arbitration_id
                if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
                    can_id = _flagged(message)
                frames.write(now_ns, can_id, 0, message.dlc, message.data)
            if message.is_error_frame:
                self._on_error_frame(message)
                continue
            self.received += 1
            self.bus_t_ns = now_ns
            handler = handlers.get(message.arbitration_id)
            if handler is None or message.is_extended_id or message.is_remote_frame:
                continue
            try:
                handler(message.data, now_ns)
            except ValueError:
                self.refused += 1

    def frames_missing(self) -> int:
        """Answers due to the SYNCs sent before this tick that have not come (late ones count until they do).

        Plain frames answer no SYNC: none is ever due.
        """
        missing = 0
        for i, divisor in enumerate(self._divisors):
            if self._bases[i] >= 0:
                missing += max(0, (self._syncs - self._bases[i]) // divisor + 1 - self._counts[i])
        return missing

    def _count(self, i: int) -> None:
        if self._bases[i] < 0:
            self._bases[i] = self._syncs
        self._counts[i] += 1

    def _on_cell(self, data: bytes | bytearray, now_ns: int) -> None:
        tension_n, quality = codecs.decode_tension(data)
        self._take_cell(tension_n, quality, now_ns)
        self._count(0)

    def correct(self, correction: Correction) -> None:
        """Read the cell with another correction from now on, the newest sample included."""
        self.correction = correction
        self.tension_n = correction.applied(self.reading_n)

    def _take_cell(self, reading_n: float, quality: int, now_ns: int) -> None:
        """Newest tension; a reading beyond the cell's range is saturated, whatever the device says."""
        if not quality and abs(reading_n) > self._tension_max_n:
            quality = _SATURATED
        if not quality:
            self.reading_n = reading_n
            correction = self.correction
            self.tension_n = (reading_n - correction.zero_n) * correction.scale
        self.cell_quality = quality
        self.cell_t_ns = now_ns
        self.cell_fresh = quality == 0

    def _take_slope(self, tangential_rad: float, normal_rad: float, quality: int, now_ns: int) -> None:
        """Newest inclination; one beyond the sensor's range is invalid, whatever the device says."""
        if not quality and (abs(tangential_rad) > self._slope_max_rad or abs(normal_rad) > self._slope_max_rad):
            quality = _INVALID
        if not quality:
            self.tangential_rad, self.normal_rad = tangential_rad, normal_rad
        self.slope_quality = quality
        self.slope_t_ns = now_ns
        self.slope_fresh = quality == 0

    def _on_slope(self, data: bytes | bytearray, now_ns: int) -> None:
        tangential, normal, quality = codecs.decode_inclination(data)
        self._take_slope(tangential, normal, quality, now_ns)
        self._count(1)

    def _on_drive(self, data: bytes | bytearray, now_ns: int) -> None:
        self.statusword, self.stroke_mm, self.speed_mm_s = codecs.decode_drive(data)
        self.drive_t_ns = now_ns
        self.drive_fresh = True
        self._count(2)

    def _on_drive_status(self, data: bytes | bytearray, now_ns: int) -> None:
        current, self.drive_temperature_c, inputs = codecs.decode_drive_status(data)
        self.drive_current_a = current * self._rated_current_a
        if self._e_stop_bit:
            self.e_stop = not inputs & self._e_stop_bit
        self.drive_status_t_ns = now_ns
        self._count(4)

    def _on_inputs(self, data: bytes | bytearray, now_ns: int) -> None:
        """Open in any of the frames that came together: a contact that bounces is one that was pressed."""
        if not codecs.decode_inputs(data) & self._io_mask:
            self._io_opened_ns = now_ns
        self.io_e_stop = self._io_opened_ns == now_ns
        self.io_t_ns = now_ns

    def _on_rail(self, data: bytes | bytearray, now_ns: int) -> None:
        """Newest angle of the rail; invalid while its encoder reports an error, or runs unverified after a restart."""
        angle_rad = codecs.decode_encoder(data, self._counts_per_turn)
        good = not (self._rail_in_error or self._rail_restarted)
        if good:
            self.rail_rad = angle_rad
        self.rail_quality = 0 if good else _INVALID
        self.rail_t_ns = now_ns
        self.rail_fresh = good
        self._count(3)

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
        """What only a controller sends, and it was not us: the bus gives nobody his own frames."""
        self.rival_t_ns, self.rival_words = now_ns, "commands this bus"

    def _sdo_request_handler(self, node: int) -> Handler:
        """A request to a device is another master's: the bus gives nobody his own frames."""

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
                self.rival_t_ns = now_ns  # what it asked for has been told
            else:
                self._on_foreign_sdo(node, sdo.multiplexer(data), sdo.foreign_answer(node, data), now_ns)

        return on_answer

    def _on_foreign_sdo(self, node: int, where: tuple[int, int] | None, words: str, now_ns: int) -> None:
        self.rival_t_ns, self.rival_words = now_ns, words
        if len(self.foreign_sdo) < MAX_NOTICES:
            index, sub = where or (0, 0)
            self.foreign_sdo.append((node, index << 8 | sub, words))

    def _emergency_handler(self, node: int) -> Handler:
        def on_emergency(data: bytes | bytearray, _now_ns: int) -> None:
            if len(data) != _EMCY_SIZE:
                raise ValueError("length")
            code = data[0] | data[1] << 8
            error = code != od.EmcyCode.NO_ERROR
            if node == self._rail_node:
                self._rail_in_error = error
            elif node == self._drive_node:
                self.drive_in_error = error
                if code == od.EmcyCode.EXTERNAL and self._e_stop_bit:
                    self.e_stop = True  # at once; the input follows with the next status
            else:
                (self._in_error.add if error else self._in_error.discard)(node)
                self.sensors_in_error = len(self._in_error)
            if len(self.emergencies) < MAX_NOTICES:
                self.emergencies.append((node, code))

        return on_emergency

    def _heartbeat_handler(self, node: int) -> Handler:
        def on_heartbeat(data: bytes | bytearray, _now_ns: int) -> None:
            if len(data) != 1:
                raise ValueError("length")
            state = data[0] & 0x7F
            if state == od.NmtState.BOOT_UP:
                if node == self._rail_node:  # nothing hangs on it but the run-out table
                    self._rail_restarted = True
                else:
                    self.restarted = True
            if self._states.get(node) != state and len(self.node_states) < MAX_NOTICES:
                self.node_states.append((node, state))
            self._states[node] = state

        return on_heartbeat

    def _on_error_frame(self, message: can.Message) -> None:
        self.error_frames += 1
        if len(self.bus_errors) < MAX_NOTICES:
            self.bus_errors.append((message.arbitration_id & 0x1FFFFFFF, can_errors.details(message.data)))
