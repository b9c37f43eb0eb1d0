"""What the bus shows beside the samples: emergencies, NMT states, heartbeats, error frames, and other controllers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import can

from rigctl.config.settings import RigSettings
from rigctl.control.bus.channels import NEVER_NS, Data, NoDriveStatus, Take
from rigctl.control.bus.readback import Readback
from rigctl.devices import objects as od
from rigctl.devices import sdo
from rigctl.model import can_errors, emergency
from rigctl.model.device_states import NmtState

MAX_NOTICES = 32
ANSWERED_NS = 1_000_000_000  # an SDO server answers within this time
_EMCY_SIZE = 8


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


class OptionalDevice(Protocol):
    """A device that the rig runs without: its errors make its own samples invalid, and nothing else."""

    def report(self, *, in_error: bool) -> None:
        """It reports an error, or the end of it."""

    def restart(self) -> None:
        """It has restarted, with unverified settings."""


def master_ids(settings: RigSettings) -> list[int]:
    """Identifiers that only a controller of this rig sends: NMT, SYNC, its heartbeat, the drive's command."""
    heartbeat = od.HEARTBEAT_BASE + settings.can.controller_node
    return [od.NMT_COB, od.SYNC_COB, heartbeat, od.DRIVE_RPDO.cob_base + settings.cylinder.node]


class NetworkState:
    """State of the nodes, and what is to be reported of the bus.

    ``states``: newest NMT state of each node. ``heartbeats_t_ns``: when each was last heard. ``restarted``: a device
    booted since start-up, so its verified settings are lost. ``sensor_emergency``, ``drive_emergency``: node << 16 |
    code of an active emergency, 0 for none. ``master_t_ns``, ``master_words``: when another controller last sent, and
    what it did.
    """

    def __init__(
        self,
        settings: RigSettings,
        readback: Readback,
        drive_status: NoDriveStatus,
        optional: Mapping[int, OptionalDevice],
    ) -> None:
        """``readback``: takes the SDO answers. ``optional``: by node."""
        self._readback, self._drive_status, self._optional = readback, drive_status, optional
        self._drive_node = settings.cylinder.node
        self._nodes = tuple(settings.canopen_nodes.values())
        self._notices = Notices()
        self.states: dict[int, int] = {}
        self.heartbeats_t_ns: dict[int, int] = {}
        self.restarted = False
        self._in_error: dict[int, int] = {}  # emergencies of cell, inclinometer and I/O node, the newest last
        self.sensor_emergency = self.drive_emergency = self.error_frames = 0
        self.master_t_ns = self._foreign_request_ns = NEVER_NS
        self.master_words = ""

    def channels(self, settings: RigSettings) -> dict[int, Take]:
        """What takes each frame, by identifier."""
        found: dict[int, Take] = {}
        for node in self._nodes:
            found[od.EMCY_BASE + node] = partial(self._take_emergency, node)
            found[od.HEARTBEAT_BASE + node] = partial(self._take_heartbeat, node)
            found[od.SDO_RX_BASE + node] = partial(self._take_sdo_request, node)
            found[od.SDO_TX_BASE + node] = partial(self._take_sdo_answer, node)
        return found | dict.fromkeys(master_ids(settings), self._take_command)

    def begin(self, now_ns: int) -> None:
        """The first tick: start-up has just reached all nodes."""
        self.heartbeats_t_ns.update(dict.fromkeys(self._nodes, now_ns))

    def notices(self) -> Notices | None:
        """What is to be reported since the last call, None if nothing."""
        found = self._notices
        if not (found.emergencies or found.node_states or found.bus_errors or found.foreign_sdo):
            return None
        self._notices = Notices()
        return found

    def take_error_frame(self, message: can.Message) -> None:
        """Count a CAN error frame, and report it."""
        self.error_frames += 1
        if len(self._notices.bus_errors) < MAX_NOTICES:
            self._notices.bus_errors.append((message.arbitration_id & 0x1FFFFFFF, can_errors.details(message.data)))

    def _take_emergency(self, node: int, data: Data, _now_ns: int) -> None:
        if len(data) != _EMCY_SIZE:
            raise ValueError("length")
        code, register = data[0] | data[1] << 8, data[2]
        error = emergency.stands(code, register)
        if node in self._optional:
            self._optional[node].report(in_error=error)
        elif node == self._drive_node:
            self.drive_emergency = node << 16 | code if error else 0
            if code == od.EmcyCode.EXTERNAL:
                self._drive_status.report_external()
        else:
            self._in_error.pop(node, None)
            if error:
                self._in_error[node] = node << 16 | code
            self.sensor_emergency = next(reversed(self._in_error.values()), 0)
        if len(self._notices.emergencies) < MAX_NOTICES:
            self._notices.emergencies.append((node, code | register << 16, data[3:].hex().encode()))

    def _take_heartbeat(self, node: int, data: Data, now_ns: int) -> None:
        if len(data) != 1:
            raise ValueError("length")
        state = data[0] & 0x7F
        if state == NmtState.BOOT_UP:
            if node in self._optional:
                self._optional[node].restart()
            else:
                self.restarted = True
        if self.states.get(node) != state and len(self._notices.node_states) < MAX_NOTICES:
            self._notices.node_states.append((node, state))
        self.states[node] = state
        self.heartbeats_t_ns[node] = now_ns

    def _take_command(self, _data: Data, now_ns: int) -> None:
        """A controller's frame. It is another controller's, because the bus does not return our own frames."""
        self.master_t_ns, self.master_words = now_ns, "commands this bus"

    def _take_sdo_request(self, node: int, data: Data, now_ns: int) -> None:
        """An SDO request is another master's, because the bus does not return our own frames."""
        where = sdo.multiplexer(data)
        self._foreign_request_ns = now_ns
        self._take_foreign_sdo(node, where, sdo.foreign_request(node, data), now_ns)
        self._readback.suspect(node, where)

    def _take_sdo_answer(self, node: int, data: Data, now_ns: int) -> None:
        if self._readback.take(node, data, now_ns):
            return
        if now_ns - self._foreign_request_ns < ANSWERED_NS:
            self.master_t_ns = now_ns  # the request has been reported already
        else:
            self._take_foreign_sdo(node, sdo.multiplexer(data), sdo.foreign_answer(node, data), now_ns)

    def _take_foreign_sdo(self, node: int, where: tuple[int, int] | None, words: str, now_ns: int) -> None:
        self.master_t_ns, self.master_words = now_ns, words
        if len(self._notices.foreign_sdo) < MAX_NOTICES:
            index, sub = where or (0, 0)
            self._notices.foreign_sdo.append((node, index << 8 | sub, words))
