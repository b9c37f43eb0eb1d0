"""Bringing the CANopen devices up, before the loop runs: identity, units, PDO mapping, and the drive's own stop.

Uses the `canopen` library over the loop's bus. Every value written is read back; what does not agree ends the start
with one line that names device, object, found and allowed.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import can
import canopen

from rigctl.config import RigSettings
from rigctl.devices import objects as od

DEVICE_HEARTBEAT_MS = 100
_NOT_VALID = 1 << 31
_LISTENED_HEARTBEATS = 2.5
_DEVICES = {
    "tension_cell": ("tension cell", od.DEVICE_TYPE_404),
    "inclinometer": ("inclinometer", od.DEVICE_TYPE_410),
    "rail_encoder": ("rail encoder", od.DEVICE_TYPE_406),
    "cylinder": ("cylinder drive", od.DEVICE_TYPE_402),
}


class StartupError(RuntimeError):
    """The rig is not what the rig file says, or does not answer; ``str()`` is one line."""


@dataclass(frozen=True)
class Device:
    """Identity of a device, CiA 301 0x1000 and 0x1018."""

    name: str
    node: int
    device_type: int
    vendor: int
    product: int
    revision: int
    serial: int


@dataclass(frozen=True)
class PlainDevice:
    """A device with plain frames: nothing of it can be read back, so this is what the rig file says of it."""

    name: str
    dbc: str
    message: str
    can_id: int


@dataclass(frozen=True)
class Report:
    """What start-up found; ``supervision`` holds the drive's own stop settings as read back."""

    devices: tuple[Device | PlainDevice, ...]
    supervision: dict[str, int]

    def as_json(self) -> dict[str, Any]:
        """For control.json."""
        return {"devices": [asdict(device) for device in self.devices], "supervision": self.supervision}


class _Node:
    """One device under configuration, with errors that name it."""

    def __init__(self, network: canopen.Network, settings: RigSettings, name: str, node: int, eds: str) -> None:
        self.name, self.id = name, node
        self._channel = f"{settings.can.interface}:{settings.can.channel}"
        self.remote = network.add_node(canopen.RemoteNode(node, str(settings.file(eds))))

    def where(self, index: int, sub: int) -> str:
        return f"{self.name} (node {self.id}), object 0x{index:04X}:{sub:02X}"

    def _variable(self, index: int, sub: int) -> Any:
        entry = self.remote.sdo[index]
        return entry[sub] if hasattr(entry, "__getitem__") and not hasattr(entry, "raw") else entry

    def read(self, index: int, sub: int = 0) -> int:
        try:
            return int(self._variable(index, sub).raw)
        except canopen.SdoAbortedError as error:
            raise StartupError(f"{self.where(index, sub)}: cannot be read: {error}") from None
        except canopen.SdoCommunicationError:
            raise StartupError(
                f"{self.name} (node {self.id}) does not answer on {self._channel}: is the rig on and connected?"
            ) from None
        except KeyError:
            raise StartupError(f"{self.where(index, sub)}: not in its EDS file") from None

    def write(self, value: int, index: int, sub: int = 0, *, verify: bool = True) -> int:
        try:
            self._variable(index, sub).raw = value
        except canopen.SdoAbortedError as error:
            raise StartupError(f"{self.where(index, sub)}: {value:#x} refused: {error}") from None
        except canopen.SdoCommunicationError:
            raise StartupError(f"{self.name} (node {self.id}) stopped answering on {self._channel}") from None
        except KeyError:
            raise StartupError(f"{self.where(index, sub)}: not in its EDS file") from None
        return self.expect(value, index, sub) if verify else value

    def expect(self, value: int, index: int, sub: int = 0) -> int:
        found = self.read(index, sub)
        if found != value:
            raise StartupError(f"{self.where(index, sub)}: found {found:#x}, allowed {value:#x}")
        return found

    def identity(self, profile: int) -> Device:
        device_type = self.read(od.DEVICE_TYPE)
        if device_type & 0xFFFF != profile & 0xFFFF:
            raise StartupError(
                f"{self.name} (node {self.id}): found CiA profile {device_type & 0xFFFF}, allowed {profile & 0xFFFF}"
            )
        numbers = (self.read(od.IDENTITY, sub) for sub in (1, 2, 3, 4))
        return Device(self.name, self.id, device_type, *numbers)

    def map_pdo(self, layout: od.PdoLayout, communication: int, mapping: int, transmission: int) -> None:
        """Map ``layout`` onto a PDO, CiA 301 order: disable, clear, write, count, enable."""
        cob_id = layout.cob_base + self.id
        self.write(cob_id | _NOT_VALID, communication, 1, verify=False)
        self.write(transmission, communication, 2)
        self.write(0, mapping, 0)
        for sub, entry in enumerate(layout.mapping, 1):
            self.write(entry, mapping, sub)
        self.write(len(layout.mapping), mapping, 0)
        self.write(cob_id, communication, 1)


def refuse_rival(bus: can.BusABC, settings: RigSettings) -> None:
    """Listen before speaking: another controller's SYNC or heartbeat on the bus ends the start.

    Raises:
        StartupError: there is one, or the interface is down.
    """
    ours = (od.SYNC_COB, od.HEARTBEAT_BASE + settings.can.controller_node)
    until = time.monotonic() + settings.can.heartbeat_ms * 1e-3 * _LISTENED_HEARTBEATS
    while (left := until - time.monotonic()) > 0:
        try:
            message = bus.recv(left)
        except can.CanError as error:
            raise StartupError(
                f"{settings.can.interface}:{settings.can.channel} cannot be read: {error} (is the interface up?)"
            ) from None
        if message is not None and not message.is_error_frame and message.arbitration_id in ours:
            raise StartupError(
                f"another controller is active on {settings.can.channel} (saw frame 0x{message.arbitration_id:03X}); "
                "one rig has one controller"
            )


def bring_up(bus: can.BusABC, settings: RigSettings) -> Report:
    """Configure the CANopen devices and start them; the drive stays off, its brake closed.

    Devices with plain frames have nothing to configure: whether they send is seen by the loop's preflight.

    Raises:
        StartupError: one line.
    """
    refuse_rival(bus, settings)
    network = canopen.Network(bus)
    network.NOTIFIER_CYCLE = 0.01
    network.connect()
    try:
        return _configure(network, settings)
    except can.CanError as error:
        raise StartupError(f"{settings.can.interface}:{settings.can.channel}: {error}") from None
    finally:
        if network.notifier is not None:
            network.notifier.stop()


def _configure(network: canopen.Network, settings: RigSettings) -> Report:
    nodes = {}
    for device in settings.canopen_nodes:
        section, (name, _) = getattr(settings, device), _DEVICES[device]
        nodes[device] = _Node(network, settings, name, section.node, section.eds)
    for node in nodes.values():
        node.remote.nmt.state = "PRE-OPERATIONAL"
    devices = [node.identity(_DEVICES[device][1]) for device, node in nodes.items()]
    if cell := nodes.get("tension_cell"):
        cell.expect(od.SI_UNIT_NEWTON, od.AI_PHYSICAL_UNIT, 1)
        cell.expect(od.CELL_DECIMAL_DIGITS, od.AI_DECIMAL_DIGITS, 1)
        cell.map_pdo(od.CELL_TPDO, od.TPDO1_COMMUNICATION, od.TPDO1_MAPPING, 1)
    if slope := nodes.get("inclinometer"):
        slope.expect(od.SLOPE_RESOLUTION_MDEG, od.SLOPE_RESOLUTION)
        slope.map_pdo(od.SLOPE_TPDO, od.TPDO1_COMMUNICATION, od.TPDO1_MAPPING, settings.inclinometer_divisor)
    if encoder := nodes.get("rail_encoder"):
        _check_encoder(encoder, settings)
    drive = nodes["cylinder"]
    drive.expect(od.SI_MICROMETRE, od.SI_UNIT_POSITION)
    drive.expect(od.SI_MICROMETRE_PER_SECOND, od.SI_UNIT_VELOCITY)
    drive.map_pdo(od.DRIVE_TPDO, od.TPDO1_COMMUNICATION, od.TPDO1_MAPPING, 1)
    drive.map_pdo(od.DRIVE_RPDO, od.RPDO1_COMMUNICATION, od.RPDO1_MAPPING, 1)
    drive.write(od.CYCLIC_SYNCHRONOUS_VELOCITY, od.MODE_OF_OPERATION)
    supervision = _supervise(drive, settings)
    for node in nodes.values():
        node.write(DEVICE_HEARTBEAT_MS, od.PRODUCER_HEARTBEAT)
    for node in nodes.values():
        node.remote.nmt.state = "OPERATIONAL"
    return Report((*devices, *_plain_devices(settings)), supervision)


def _check_encoder(encoder: _Node, settings: RigSettings) -> None:
    """One turn is what the rig file says, and the position begins again at the end of a turn, not within one."""
    rail = settings.rail_encoder
    assert rail is not None  # there is no node without it
    encoder.expect(rail.counts_per_turn, od.ENCODER_COUNTS_PER_TURN)
    total = encoder.read(od.ENCODER_TOTAL_RANGE)
    if total == 0 or total % rail.counts_per_turn:
        raise StartupError(
            f"{encoder.where(od.ENCODER_TOTAL_RANGE, 0)}: found {total}, allowed whole turns of {rail.counts_per_turn}"
        )
    divisor = settings.loop.rate_hz // rail.rate_hz
    encoder.map_pdo(od.ENCODER_TPDO, od.TPDO1_COMMUNICATION, od.TPDO1_MAPPING, divisor)


def _plain_devices(settings: RigSettings) -> list[PlainDevice]:
    return [
        PlainDevice(_DEVICES[device][0], getattr(settings, device).dbc.file, message.name, message.can_id)
        for device, message in settings.plain_messages.items()
    ]


def _supervise(drive: _Node, settings: RigSettings) -> dict[str, int]:
    """Make the drive stop by itself when we go silent, and read every such setting back."""
    cylinder = settings.cylinder
    deceleration = round(cylinder.stop_deceleration_mm_s2 / od.MM_S_PER_VELOCITY_UNIT)
    consumer = settings.can.controller_node << 16 | cylinder.heartbeat_timeout_ms
    return {
        "consumer_heartbeat_0x1016": drive.write(consumer, od.CONSUMER_HEARTBEAT, 1),
        "abort_connection_0x6007": drive.write(od.ABORT_CONNECTION_QUICK_STOP, od.ABORT_CONNECTION_OPTION),
        "fault_reaction_0x605E": drive.write(od.FAULT_REACTION_QUICK_STOP, od.FAULT_REACTION_OPTION),
        "quick_stop_deceleration_0x6085": drive.write(deceleration, od.QUICK_STOP_DECELERATION),
        "command_deadline_ms_0x1400": drive.write(cylinder.command_deadline_ms, od.RPDO1_COMMUNICATION, 5),
    }


def release(bus: can.BusABC, settings: RigSettings) -> None:
    """Before a daemon ends: the drive, off with its brake closed, need not wait for us any more.

    Without this it would miss our heartbeat and meet the next daemon with a fault. Best effort: a drive that does not
    answer keeps its supervision, which is the safe side.
    """
    network = canopen.Network(bus)
    network.NOTIFIER_CYCLE = 0.01
    network.connect()
    try:
        drive = _Node(network, settings, "cylinder drive", settings.cylinder.node, settings.cylinder.eds)
        drive.write(0, od.RPDO1_COMMUNICATION, 5, verify=False)
        drive.write(0, od.CONSUMER_HEARTBEAT, 1, verify=False)
    except (StartupError, can.CanError):
        return
    finally:
        if network.notifier is not None:
            network.notifier.stop()
