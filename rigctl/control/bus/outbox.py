"""Sends command, SYNC, heartbeat and SDO request, in that order, without waiting for the bus; or falls silent."""

from __future__ import annotations

import can

from rigctl.config.settings import RigSettings
from rigctl.control.power.drive_enable import DriveEnable
from rigctl.devices import codecs, sdo
from rigctl.devices import objects as od
from rigctl.devices.process_data import COMMAND, ProcessData, wanted
from rigctl.ipc.ring import RingWriter
from rigctl.model.device_states import NmtState

CUTS, NMT_STOPS = 5, 10  # in as many ticks, since a frame may be lost
CONTROLWORD_WRITTEN = (od.CONTROLWORD, 0)  # by SDO, see `Outbox.silence`


class Outbox:
    """Sends and counts; a frame the bus refuses is counted and is no error of the tick."""

    def __init__(
        self, bus: can.BusABC, settings: RigSettings, frames: RingWriter, process_data: ProcessData | None = None
    ) -> None:
        """``frames``: ring for every frame the bus has taken. ``process_data``: see `rigctl.control.bus.inbox`."""
        self._bus, self._frames = bus, frames
        data = process_data or wanted(settings)
        self._command_id = data.can_ids(settings)[COMMAND]
        self._encode = codecs.command_encoder(data.frames[COMMAND], data.units, settings.cylinder.rated_force_n)
        self.enable = DriveEnable(settings, data)
        self._heartbeat_id = od.HEARTBEAT_BASE + settings.can.controller_node
        period_ticks = settings.can.heartbeat_ms * settings.loop.rate_hz // 1000
        self._heartbeat_every = max(1, period_ticks)
        self._until_heartbeat = 1
        self._operational = bytes([NmtState.OPERATIONAL])
        self._stop_drive = bytes([od.NMT_STOP, settings.cylinder.node])
        self._cut_power = sdo.write_request(*CONTROLWORD_WRITTEN, od.Controlword.DISABLE_VOLTAGE)
        self._drive_node = settings.cylinder.node
        self._cuts_left, self._stops_left = CUTS, NMT_STOPS
        self._now_ns = 0
        self.synced_ns = 0  # when the newest SYNC was handed to the bus
        self.controlword = 0
        self.sent = self.failures = self.syncs = 0
        self.failure_text = ""
        self.safe_frames = 0  # commands of no speed in a row that the bus has taken

    def command(
        self, controlword: int, speed_mm_s: float, now_ns: int, preload_n: float = 0.0, *, enable: bool | None = None
    ) -> None:
        """The command PDO, then SYNC, then the heartbeat when it is due.

        ``enable``: the drive's hard-wired enable, where there is one; None: as before.
        """
        self._now_ns = now_ns
        self.controlword = controlword
        taken = self._send(self._command_id, self._encode(controlword, speed_mm_s, preload_n))
        self.safe_frames = self.safe_frames + taken if speed_mm_s == 0.0 else 0
        self.syncs += self._send(od.SYNC_COB, b"")
        self.synced_ns = now_ns
        self._until_heartbeat -= 1
        due = not self._until_heartbeat
        if due:
            self._until_heartbeat = self._heartbeat_every
            self._send(self._heartbeat_id, self._operational)
        self._send_enable(self.enable.on if enable is None else enable, heartbeat=due)

    def silence(self, now_ns: int) -> None:
        """Neither command nor heartbeat, for good; SYNC goes on alone, for the sensors.

        At first the drive's power is cut by SDO, because process data have had no effect and a motor that does not come
        to rest never ends the ramp of its own supervision. NMT stop follows, after which a drive takes no SDO. The
        drive's hard-wired enable, where there is one, drops at once.
        """
        self._now_ns = now_ns
        self.controlword = 0
        self._send_enable(False, heartbeat=False)
        if self._cuts_left:
            self._cuts_left -= 1
            self.request(self._drive_node, self._cut_power)
        elif self._stops_left:
            self._stops_left -= self._send(od.NMT_COB, self._stop_drive)
        self.syncs += self._send(od.SYNC_COB, b"")
        self.synced_ns = now_ns

    def start(self, node: int) -> None:
        """NMT start; after `command`, as an SDO request."""
        self._send(od.NMT_COB, bytes([od.NMT_START, node]))

    def request(self, node: int, request: bytes) -> bool:
        """Send an SDO request; after `command`, because cyclic frames go first. Whether the queue has taken it."""
        return bool(self._send(od.SDO_RX_BASE + node, request))

    def count_failure(self) -> None:
        """A frame could not be sent, and the bus has not said why."""
        self.failures += 1

    def _send_enable(self, on: bool, *, heartbeat: bool) -> None:
        if (frame := self.enable.due(on, heartbeat=heartbeat)) is not None:
            self._send(self.enable.can_id, frame)

    def _send(self, can_id: int, data: bytes) -> int:
        try:
            # In the order of its parameters, since names cost python-can's constructor a third of its time.
            self._bus.send(can.Message(0.0, can_id, False, False, False, None, len(data), bytearray(data)))
        except can.CanError as error:
            self.failures += 1
            self.failure_text = str(error)
            return 0
        self.sent += 1
        self._frames.write(self._now_ns, can_id, 1, len(data), data)
        return 1
