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
from rigctl.config_io import INPUTS_PER_BLOCK, IoSettings
from rigctl.devices import objects as od
from rigctl.devices.remote_node import Device, RemoteNode, StartupError, StopSetting

__all__ = ["Device", "StartupError", "bring_up", "refuse_rival", "release"]

DEVICE_HEARTBEAT_MS = 100
_LISTENED_HEARTBEATS = 2.5
_INHIBIT_UNITS_PER_MS = 10
_DEVICES = {
    "tension_cell": ("tension cell", od.DEVICE_TYPE_404),
    "inclinometer": ("inclinometer", od.DEVICE_TYPE_410),
    "rail_encoder": ("rail encoder", od.DEVICE_TYPE_406),
    "io": ("I/O node", od.DEVICE_TYPE_401),
    "cylinder": ("cylinder drive", od.DEVICE_TYPE_402),
}


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
    supervision: tuple[StopSetting, ...]

    @property
    def supervised(self) -> bool:
        """The drive stops by itself when we go silent."""
        return all(setting.ok for setting in self.supervision)

    def as_json(self) -> dict[str, Any]:
        """For control.json."""
        stop = [{**asdict(setting), "ok": setting.ok} for setting in self.supervision]
        return {"devices": [asdict(device) for device in self.devices], "supervision": stop}


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
        nodes[device] = RemoteNode(network, settings, name, section.node, section.eds)
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
    if settings.io is not None:
        _ask_for_inputs(nodes["io"], settings.io)
    drive = nodes["cylinder"]
    drive.expect(od.SI_MICROMETRE, od.SI_UNIT_POSITION)
    drive.expect(od.SI_MICROMETRE_PER_SECOND, od.SI_UNIT_VELOCITY)
    drive.map_pdo(od.DRIVE_TPDO, od.TPDO1_COMMUNICATION, od.TPDO1_MAPPING, 1)
    if settings.status_divisor:
        _ask_for_status(drive, settings)
    drive.map_pdo(od.DRIVE_RPDO, od.RPDO1_COMMUNICATION, od.RPDO1_MAPPING, 1)
    drive.write(od.CYCLIC_SYNCHRONOUS_VELOCITY, od.MODE_OF_OPERATION)
    supervision = _supervise(drive, settings)
    for node in nodes.values():
        node.write(DEVICE_HEARTBEAT_MS, od.PRODUCER_HEARTBEAT)
    for node in nodes.values():
        node.remote.nmt.state = "OPERATIONAL"
    return Report((*devices, *_plain_devices(settings)), supervision)


def _check_encoder(encoder: RemoteNode, settings: RigSettings) -> None:
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


def _ask_for_inputs(node: RemoteNode, io: IoSettings) -> None:
    """The emergency stop's input by the node's own events and timer: inverted by nobody, kept back by no mask."""
    device_type = node.read(od.DEVICE_TYPE)
    if not device_type & od.DIGITAL_INPUTS_FITTED:
        raise StartupError(f"{node.where(od.DEVICE_TYPE, 0)}: found {device_type:#x}, allowed one with digital inputs")
    blocks = node.read(od.INPUTS_8)
    if blocks < io.block:
        raise StartupError(
            f"{node.where(od.INPUTS_8, 0)}: found {blocks * INPUTS_PER_BLOCK} inputs, "
            f"allowed more than io.e_stop_input ({io.e_stop_input})"
        )
    if node.has(od.INPUT_POLARITY_8, io.block):
        node.expect(0, od.INPUT_POLARITY_8, io.block)
    if node.has(od.INPUT_EVENTS):
        node.write(1, od.INPUT_EVENTS)
    if node.has(od.INPUT_EVENT_MASK_8, io.block):
        node.write(od.EVERY_INPUT_8, od.INPUT_EVENT_MASK_8, io.block)
    timers = {3: io.inhibit_ms * _INHIBIT_UNITS_PER_MS, 5: io.event_ms}
    layout = od.inputs_tpdo(io.block)
    node.map_pdo(layout, od.TPDO1_COMMUNICATION, od.TPDO1_MAPPING, od.EVENT_DRIVEN, timers)


def _plain_devices(settings: RigSettings) -> list[PlainDevice]:
    return [
        PlainDevice(_DEVICES[device][0], getattr(settings, device).dbc.file, message.name, message.can_id)
        for device, message in settings.plain_messages.items()
    ]


def _ask_for_status(drive: RemoteNode, settings: RigSettings) -> None:
    """Motor current, temperature and inputs by the drive's second TPDO; its unit of current is the rated one."""
    rated_a = settings.cylinder.rated_current_a
    assert rated_a is not None  # the settings need it where they ask for the status
    drive.expect(round(rated_a / od.A_PER_RATED_CURRENT_UNIT), od.MOTOR_RATED_CURRENT)
    drive.map_pdo(od.DRIVE_TPDO2, od.TPDO2_COMMUNICATION, od.TPDO2_MAPPING, settings.status_divisor)


def _supervise(drive: RemoteNode, settings: RigSettings) -> tuple[StopSetting, ...]:
    """Make the drive stop by itself when we go silent, and read every such setting back.

    One that the drive does not take ends no start: the rig can be looked at, and arming says what is wrong. A velocity
    offset left in the drive by its commissioning tool would move the stroke while the loop commands 0.
    """
    cylinder = settings.cylinder
    deceleration = round(cylinder.stop_deceleration_mm_s2 / od.MM_S_PER_VELOCITY_UNIT)
    consumer = settings.can.controller_node << 16 | cylinder.heartbeat_timeout_ms
    wanted = (
        ("consumer heartbeat", consumer, od.CONSUMER_HEARTBEAT, 1),
        ("command deadline", cylinder.command_deadline_ms, od.RPDO1_COMMUNICATION, 5),
        ("abort connection option", od.ABORT_CONNECTION_QUICK_STOP, od.ABORT_CONNECTION_OPTION, 0),
        ("quick stop option", od.QUICK_STOP_RAMP_THEN_OFF, od.QUICK_STOP_OPTION, 0),
        ("shutdown option", od.SLOW_DOWN_THEN_OFF, od.SHUTDOWN_OPTION, 0),
        ("disable operation option", od.SLOW_DOWN_THEN_OFF, od.DISABLE_OPERATION_OPTION, 0),
        ("fault reaction option", od.FAULT_REACTION_QUICK_STOP, od.FAULT_REACTION_OPTION, 0),
        ("quick stop deceleration", deceleration, od.QUICK_STOP_DECELERATION, 0),
        *((("velocity offset", 0, od.VELOCITY_OFFSET, 0),) if drive.has(od.VELOCITY_OFFSET) else ()),
    )
    return tuple(drive.enforce(*setting) for setting in wanted)


def release(bus: can.BusABC, settings: RigSettings) -> None:
    """Before a daemon ends: the drive, off with its brake closed, need not wait for us any more.

    Without this it would miss our heartbeat and meet the next daemon with a fault. Best effort: a drive that does not
    answer keeps its supervision, which is the safe side.
    """
    network = canopen.Network(bus)
    network.NOTIFIER_CYCLE = 0.01
    network.connect()
    try:
        drive = RemoteNode(network, settings, "cylinder drive", settings.cylinder.node, settings.cylinder.eds)
        drive.write(0, od.RPDO1_COMMUNICATION, 5, verify=False)
        drive.write(0, od.CONSUMER_HEARTBEAT, 1, verify=False)
    except (StartupError, can.CanError):
        return
    finally:
        if network.notifier is not None:
            network.notifier.stop()
