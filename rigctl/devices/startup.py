"""Bringing the CANopen devices up, before the loop runs: identity, units, PDO mapping, and the drive's own stop.

Uses the `canopen` library over the loop's bus. Every value written is read back; a difference ends the start with
one line that names device, object, found and expected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import can

from rigctl.config.io_section import INPUTS_PER_BLOCK, IoSettings
from rigctl.config.settings import RigSettings
from rigctl.devices import busload
from rigctl.devices import objects as od
from rigctl.devices.drive import LeftInDrive
from rigctl.devices.drive_at_start import DriveAtStart
from rigctl.devices.objects import DEVICE_HEARTBEAT_MS
from rigctl.devices.process_data import (
    CELL_TEMPERATURE,
    COMMAND,
    DRIVE_ENABLE,
    DRIVE_SPEED,
    DRIVE_STATUS,
    SECOND_FORCE,
    DriveUnits,
    ProcessData,
    in_increments,
    wanted,
)
from rigctl.devices.remote_node import Device, RemoteNode, StartupError, StopSetting
from rigctl.devices.sdo import Watched
from rigctl.devices.startup_bus import StartupBus
from rigctl.model.device_states import NmtState

__all__ = ["DEVICE_HEARTBEAT_MS", "Device", "StartupError", "bring_up", "refuse_rival", "release"]

_LISTENED_HEARTBEATS = 2.5
_STARTED_HEARTBEATS = 2.5
_HEARTBEATS = "heartbeats of the devices"
_INHIBIT_UNITS_PER_MS = 10
_SAME_SCALE = 1e-6  # relative: two values of the same scale differ by rounding at most
_METRE, _PER_SECOND = 0x01, 0x03  # CiA 303-2
_FINEST, _COARSEST = -9, -5  # powers of ten of a metre: 1 nm to 10 um
_DEVICES = {
    "tension_cell": ("tension cell", od.DEVICE_TYPE_404),
    "inclinometer": ("inclinometer", od.DEVICE_TYPE_410),
    "rail_encoder": ("rail encoder", od.DEVICE_TYPE_406),
    "second_force": ("second force path", od.DEVICE_TYPE_404),
    "io": ("I/O node", od.DEVICE_TYPE_401),
    "cylinder": ("cylinder drive", od.DEVICE_TYPE_402),
}


@dataclass(frozen=True)
class PlainDevice:
    """A device with plain frames, as the rig file describes it: nothing can be read back."""

    name: str
    dbc: str
    message: str
    can_id: int


@dataclass(frozen=True)
class StartupReport:
    """Result of start-up; ``supervision`` holds the drive's own stop settings as read back.

    ``watched``: every object that was verified, the drive's first, for `rigctl.control.bus.readback`. ``found``: what a
    former controller had left in the drive.
    """

    devices: tuple[Device | PlainDevice, ...]
    supervision: tuple[StopSetting, ...]
    process_data: ProcessData
    watched: tuple[Watched, ...] = ()
    found: tuple[LeftInDrive, ...] = ()

    @property
    def supervised(self) -> bool:
        """The drive stops by itself when we go silent."""
        return all(setting.ok for setting in self.supervision)

    def as_json(self) -> dict[str, Any]:
        """For control.json."""
        stop = [{**asdict(setting), "ok": setting.ok} for setting in self.supervision]
        return {
            "devices": [asdict(device) for device in self.devices],
            "supervision": stop,
            "process_data": self.process_data.as_json(),
            "watched": [asdict(item) for item in self.watched],
        }


def refuse_rival(bus: StartupBus, settings: RigSettings) -> None:
    """Listen before sending: another controller's SYNC or heartbeat on the bus ends the start.

    Raises:
        StartupError: there is another controller, or the interface is down.
    """
    ours = (od.SYNC_COB, od.HEARTBEAT_BASE + settings.can.controller_node)
    until_ns = bus.until_ns(listened_s(settings))
    while bus.now_ns() < until_ns:
        try:
            message = bus.receive(until_ns)
        except can.CanError as error:
            raise StartupError(
                f"{settings.can.interface}:{settings.can.channel} cannot be read: "
                f"{bus_words(error, settings)} (is the interface up?)"
            ) from None
        if message is not None and message.arbitration_id in ours:
            raise StartupError(
                f"another controller is active on {settings.can.channel} (saw frame 0x{message.arbitration_id:03X}); "
                "one rig has one controller"
            )


def listened_s(settings: RigSettings) -> float:
    """How long a start listens for another controller, in seconds."""
    return settings.can.heartbeat_ms * 1e-3 * _LISTENED_HEARTBEATS


def bring_up(
    bus: can.BusABC,
    settings: RigSettings,
    now_ns: Callable[[], int],
    say: Callable[[str], None] = lambda _line: None,
    waits: Callable[[str], None] = lambda _name: None,
) -> StartupReport:
    """Configure the CANopen devices and start them; the drive stays off, its brake closed.

    ``now_ns``: the clock of ``bus``, see `StartupBus`. ``say``: called with one line for each wait. ``waits``: with the
    name of what the start waits for, however short.

    Devices with plain frames need no configuration; the loop's preflight checks that they send.

    Raises:
        StartupError: one line.
    """
    channel = f"{settings.can.interface}:{settings.can.channel}"
    line = StartupBus(bus, now_ns, lambda words: say(f"{channel}: {words}"), waits)
    nodes = {device: RemoteNode(line, settings, device, _DEVICES[device][0]) for device in settings.canopen_nodes}
    refuse_rival(line, settings)
    try:
        return _configure(line, nodes, settings, say)
    except can.CanError as error:
        raise StartupError(f"{channel}: {bus_words(error, settings)}") from None


def bus_words(error: Exception, settings: RigSettings) -> str:
    """What a bus reports, on one line and without the name of the interface that some backends put before it."""
    words = " ".join(str(error).split())
    for name in (f"{settings.can.interface}:{settings.can.channel}", settings.can.channel):
        words = words.removeprefix(f"{name}: ")
    return words


def _configure(
    bus: StartupBus, nodes: Mapping[str, RemoteNode], settings: RigSettings, say: Callable[[str], None]
) -> StartupReport:
    drive = nodes["cylinder"]
    bus.boots_until_ns = until_ns = bus.until_ns(settings.can.boot_wait_s)
    at_start = DriveAtStart(bus, drive, settings.cylinder.brake_delay_ms * 1e-3, say)
    at_start.take_off_power(at_start.known_state(until_ns))
    at_start.clear_targets()
    for node in nodes.values():
        node.remote.nmt.state = "PRE-OPERATIONAL"
    for node in nodes.values():
        node.await_boot(until_ns, say)
        if error := node.error():
            say(f"{error}: reset communication")
            node.reset_communication(until_ns, say)
    pdos = wanted(settings).frames
    frames = {}
    devices = [node.identity(_device_type(settings, device)) for device, node in nodes.items()]
    if cell := nodes.get("tension_cell"):
        cell.expect(od.SI_UNIT_NEWTON, od.AI_PHYSICAL_UNIT, 1)
        cell.expect(od.CELL_DECIMAL_DIGITS, od.AI_DECIMAL_DIGITS, 1)
        frames["tension_cell"] = cell.map_pdo(pdos["tension_cell"], 1)
        if CELL_TEMPERATURE in pdos:
            cell.expect(od.SI_UNIT_CELSIUS, od.AI_PHYSICAL_UNIT, 2)
            cell.expect(od.CELSIUS_DECIMAL_DIGITS, od.AI_DECIMAL_DIGITS, 2)
            frames[CELL_TEMPERATURE] = cell.map_pdo(pdos[CELL_TEMPERATURE], settings.cell_temperature_divisor)
    if slope := nodes.get("inclinometer"):
        slope.expect(od.SLOPE_RESOLUTION_MDEG, od.SLOPE_RESOLUTION)
        frames["inclinometer"] = slope.map_pdo(pdos["inclinometer"], settings.inclinometer_divisor)
    frames |= _map_fitted(nodes, settings, pdos)
    units = _units(drive, settings)
    if drive.has(od.POLARITY):  # a drive mounted the other way round needs one; the sign check proves it right
        drive.watch(drive.read(od.POLARITY), od.POLARITY)
    frames["cylinder"] = drive.map_pdo(pdos["cylinder"], 1)
    if DRIVE_SPEED in pdos:
        frames[DRIVE_SPEED] = drive.map_pdo(pdos[DRIVE_SPEED], 1)
    if DRIVE_STATUS in pdos:
        frames[DRIVE_STATUS] = _map_status(drive, settings, pdos[DRIVE_STATUS])
    frames[COMMAND] = drive.map_pdo(pdos[COMMAND], 1)
    process_data = ProcessData(frames, units)
    _check_load(settings, process_data)
    supervision = _supervise(drive, settings, units)
    for device, node in nodes.items():
        if device != "io":  # it sends on events
            _listen_to_sync(node)
        node.write(DEVICE_HEARTBEAT_MS, od.PRODUCER_HEARTBEAT)
    drive.write(od.CYCLIC_SYNCHRONOUS_VELOCITY, od.MODE_OF_OPERATION)  # last: with it the drive may move
    if drive.has(od.MODE_DISPLAY):
        drive.watch(od.CYCLIC_SYNCHRONOUS_VELOCITY, od.MODE_DISPLAY)
    _start(bus, nodes.values(), say)
    watched = [item for node in (drive, *(n for n in nodes.values() if n is not drive)) for item in node.verified]
    return StartupReport(
        (*devices, *_plain_devices(settings)), supervision, process_data, tuple(watched), tuple(at_start.found)
    )


def _start(bus: StartupBus, nodes: Iterable[RemoteNode], say: Callable[[str], None]) -> None:
    """NMT start, verified by the heartbeats, and repeated once; the loop repeats it while its heartbeats are sent."""
    nodes = list(nodes)

    def waiting() -> list[RemoteNode]:
        return [node for node in nodes if node.reported is not NmtState.OPERATIONAL]

    bus.reported.clear()
    bus.waits(_HEARTBEATS)
    for _ in range(2):
        for node in waiting():
            node.remote.nmt.state = "OPERATIONAL"
        bus.hear(lambda: not waiting(), bus.until_ns(_STARTED_HEARTBEATS * DEVICE_HEARTBEAT_MS * 1e-3))
    for node in waiting():
        found = "no heartbeat" if node.reported is None else f"NMT state {node.reported.name.replace('_', ' ')}"
        say(f"{node.name} (node {node.id}) has not started: {found} after two commands")


def _listen_to_sync(node: RemoteNode) -> None:
    """Check that the device takes our SYNC for its own and sends none; another value is written."""
    if node.read(od.SYNC_COB_ID) == od.SYNC_COB:
        node.watch(od.SYNC_COB, od.SYNC_COB_ID)
    else:
        node.write(od.SYNC_COB, od.SYNC_COB_ID)


def _map_fitted(
    nodes: Mapping[str, RemoteNode], settings: RigSettings, pdos: Mapping[str, od.PdoLayout]
) -> dict[str, od.PdoLayout]:
    """Configure the devices that only some rigs have."""
    frames = {}
    if encoder := nodes.get("rail_encoder"):
        frames["rail_encoder"] = _check_encoder(encoder, settings, pdos["rail_encoder"])
    if second := nodes.get(SECOND_FORCE):
        frames[SECOND_FORCE] = _check_second(second, settings, pdos[SECOND_FORCE])
    if settings.io is not None:
        frames["io"] = _map_inputs(nodes["io"], settings.io, pdos["io"])
        if DRIVE_ENABLE in pdos:
            frames[DRIVE_ENABLE] = _map_enable(nodes["io"], settings, pdos[DRIVE_ENABLE])
    return frames


def _check_load(settings: RigSettings, process_data: ProcessData) -> None:
    """Check the bus load again: a fixed mapping may have longer frames than the rig file's."""
    load = busload.bus_load(settings, process_data)
    if load is not None and load > busload.LIMIT:
        raise StartupError(
            f"bus load with the devices' own mappings: found {load:.1%} of {settings.can.bitrate_bit_s} bit/s, "
            f"expected at most {busload.LIMIT:.0%}: raise the bit rate or lower loop.rate_hz"
        )


def _units(drive: RemoteNode, settings: RigSettings) -> DriveUnits:
    """The drive's units by the rig file, by its feed constant, or by its SI units; two sources must agree.

    Raises:
        StartupError: the units are unknown, or two sources disagree.
    """
    cylinder = settings.cylinder
    per_mm, source = cylinder.increments_per_mm, "cylinder.increments_per_mm"
    if cylinder.lead_mm is not None:
        found = _units_per_turn(drive) / cylinder.lead_mm
        if per_mm is not None and not math.isclose(found, per_mm, rel_tol=_SAME_SCALE):
            raise StartupError(
                f"{drive.where(od.FEED_CONSTANT, 1)}: found {found:.9g} units per mm with cylinder.lead_mm "
                f"({cylinder.lead_mm:g}), expected cylinder.increments_per_mm ({per_mm:.9g})"
            )
        per_mm, source = found, "cylinder.lead_mm"
    if per_mm is None:
        position_mm = _si_unit_mm(drive, od.SI_UNIT_POSITION, 0)
        speed_mm_s = _si_unit_mm(drive, od.SI_UNIT_VELOCITY, _PER_SECOND)
        speed_mm_s = 1.0 / cylinder.speed_units_per_mm_s if cylinder.speed_units_per_mm_s else speed_mm_s
        ramp = cylinder.ramp_units_per_mm_s2
        return DriveUnits(position_mm, speed_mm_s, 1.0 / ramp if ramp else speed_mm_s)
    si_unit = drive.read(od.SI_UNIT_POSITION) if drive.has(od.SI_UNIT_POSITION) else 0
    if si_unit >> 16 & 0xFF == _METRE:
        unit_mm = _si_unit_mm(drive, od.SI_UNIT_POSITION, 0)
        if not math.isclose(unit_mm * per_mm, 1.0, rel_tol=_SAME_SCALE):
            raise StartupError(
                f"{drive.where(od.SI_UNIT_POSITION, 0)}: found {si_unit:#x}, {1.0 / unit_mm:g} units per mm, "
                f"expected {per_mm:.9g} ({source})"
            )
    return in_increments(settings, per_mm)


def _units_per_turn(drive: RemoteNode) -> float:
    """Position units per revolution of the shaft: its feed constant; without one, increments and gear."""
    if drive.has(od.FEED_CONSTANT, 1):
        return _ratio(drive, od.FEED_CONSTANT)
    return _ratio(drive, od.ENCODER_RESOLUTION) * _ratio(drive, od.GEAR_RATIO)


def _ratio(drive: RemoteNode, index: int) -> float:
    above, below = drive.read(index, 1), drive.read(index, 2)
    if above <= 0 or below <= 0:
        raise StartupError(
            f"{drive.where(index, 1)}: found the ratio {above}/{below}, expected one of positive numbers"
        )
    drive.watch(above, index, 1)
    drive.watch(below, index, 2)
    return above / below


def _si_unit_mm(drive: RemoteNode, index: int, denominator: int) -> float:
    """Size of one unit in mm (or mm/s) by a unit object of CiA 303-2: prefix, numerator, denominator."""
    found = drive.read(index)
    prefix = (found >> 24 ^ 0x80) - 0x80
    if found & 0xFFFFFF != _METRE << 16 | denominator << 8 or not _FINEST <= prefix <= _COARSEST:
        what = "metres per second" if denominator else "metres"
        raise StartupError(
            f"{drive.where(index, 0)}: found {found:#x}, expected {what} with a prefix of 10^{_FINEST} to "
            f"10^{_COARSEST} (0xFA01{denominator:02X}00 = micro), or cylinder.increments_per_mm or lead_mm"
        )
    drive.watch(found, index)
    return float(f"1e{prefix + 3}")


def _check_encoder(encoder: RemoteNode, settings: RigSettings, layout: od.PdoLayout) -> od.PdoLayout:
    """Check that one turn has the rig file's counts, and that the position wraps at the end of a turn, not within."""
    rail = settings.rail_encoder
    assert rail is not None  # the node exists only with this section
    encoder.expect(rail.counts_per_turn, od.ENCODER_COUNTS_PER_TURN)
    total = encoder.read(od.ENCODER_TOTAL_RANGE)
    if total == 0 or total % rail.counts_per_turn:
        raise StartupError(
            f"{encoder.where(od.ENCODER_TOTAL_RANGE, 0)}: found {total}, expected whole turns of {rail.counts_per_turn}"
        )
    divisor = settings.loop.rate_hz // rail.rate_hz
    return encoder.map_pdo(layout, divisor)


def _device_type(settings: RigSettings, device: str) -> int:
    """Device type a section's device must have."""
    section = settings.second_force
    stretches = device == SECOND_FORCE and section is not None and section.kind == "stretch"
    return od.DEVICE_TYPE_406_LINEAR if stretches else _DEVICES[device][1]


def _check_second(node: RemoteNode, settings: RigSettings, layout: od.PdoLayout) -> od.PdoLayout:
    """Check the unit of the second force path: mN of a cell, the rig file's step of an encoder."""
    section = settings.second_force
    assert section is not None  # the node exists only with this section
    if section.kind == "cell":
        node.expect(od.SI_UNIT_NEWTON, od.AI_PHYSICAL_UNIT, 1)
        node.expect(od.CELL_DECIMAL_DIGITS, od.AI_DECIMAL_DIGITS, 1)
    else:
        node.expect(round(od.NM_PER_MM / section.counts_per_mm), od.ENCODER_STEP, 1)
    return node.map_pdo(layout, settings.loop.rate_hz // section.rate_hz)


def _map_inputs(node: RemoteNode, io: IoSettings, layout: od.PdoLayout) -> od.PdoLayout:
    """Have the node send the emergency stop's input on events and by its timer, not inverted and not masked."""
    device_type = node.read(od.DEVICE_TYPE)
    if not device_type & od.DIGITAL_INPUTS_FITTED:
        raise StartupError(f"{node.where(od.DEVICE_TYPE, 0)}: found {device_type:#x}, expected one with digital inputs")
    blocks = node.read(od.INPUTS_8)
    if blocks < io.block:
        raise StartupError(
            f"{node.where(od.INPUTS_8, 0)}: found {blocks * INPUTS_PER_BLOCK} inputs, "
            f"expected more than io.e_stop_input ({io.e_stop_input})"
        )
    if node.has(od.INPUT_POLARITY_8, io.block):
        node.expect(0, od.INPUT_POLARITY_8, io.block)
    if node.has(od.INPUT_EVENTS):
        node.write(1, od.INPUT_EVENTS)
    if node.has(od.INPUT_EVENT_MASK_8, io.block):
        node.write(od.EVERY_INPUT_8, od.INPUT_EVENT_MASK_8, io.block)
    timers = {3: io.inhibit_ms * _INHIBIT_UNITS_PER_MS, 5: io.event_ms}
    return node.map_pdo(layout, od.EVENT_DRIVEN, timers)


def _map_enable(node: RemoteNode, settings: RigSettings, layout: od.PdoLayout) -> od.PdoLayout:
    """Have the node switch the drive's enable by our RPDO, and drop it by itself without our heartbeat."""
    io, device_type = settings.io, node.read(od.DEVICE_TYPE)
    assert io is not None  # there is no such frame without it
    if not device_type & od.DIGITAL_OUTPUTS_FITTED:
        raise StartupError(
            f"{node.where(od.DEVICE_TYPE, 0)}: found {device_type:#x}, expected one with digital outputs"
        )
    blocks, block = node.read(od.OUTPUTS_8), io.enable_block
    if blocks < block:
        raise StartupError(
            f"{node.where(od.OUTPUTS_8, 0)}: found {blocks * INPUTS_PER_BLOCK} outputs, "
            f"expected more than io.drive_enable_output ({io.drive_enable_output})"
        )
    node.write(0, od.OUTPUTS_8, block, verify=False)  # the loop sets it, so nothing watches its value
    if node.has(od.OUTPUT_POLARITY_8, block):
        node.expect(0, od.OUTPUT_POLARITY_8, block)
    node.write(od.EVERY_OUTPUT_8, od.OUTPUT_ERROR_MODE_8, block)
    node.write(0, od.OUTPUT_ERROR_VALUE_8, block)
    if node.has(od.ERROR_BEHAVIOUR, 1):  # the node goes on sending its inputs, which show that the output has dropped
        node.write(od.NMT_STATE_STAYS, od.ERROR_BEHAVIOUR, 1)
    node.write(consumer_heartbeat(settings), od.CONSUMER_HEARTBEAT, 1)
    return node.map_pdo(layout, od.EVENT_DRIVEN)


def consumer_heartbeat(settings: RigSettings) -> int:
    """Value of 0x1016:01 in the devices that watch our heartbeat: our node and cylinder.heartbeat_timeout_ms."""
    return settings.can.controller_node << 16 | settings.cylinder.heartbeat_timeout_ms


def _plain_devices(settings: RigSettings) -> list[PlainDevice]:
    return [
        PlainDevice(_DEVICES[device][0], getattr(settings, device).dbc.file, message.name, message.can_id)
        for device, message in settings.plain_messages.items()
    ]


def _map_status(drive: RemoteNode, settings: RigSettings, layout: od.PdoLayout) -> od.PdoLayout:
    """Have the drive send motor current, temperature and inputs in its second TPDO; current is per rated current."""
    rated_a = settings.cylinder.rated_current_a
    assert rated_a is not None  # the settings require it with a status rate
    drive.expect(round(rated_a / od.A_PER_RATED_CURRENT_UNIT), od.MOTOR_RATED_CURRENT)
    return drive.map_pdo(layout, settings.status_divisor)


def _supervise(drive: RemoteNode, settings: RigSettings, units: DriveUnits) -> tuple[StopSetting, ...]:
    """Make the drive stop by itself when we go silent, and read every such setting back.

    A setting that the drive refuses does not end the start: the rig can be inspected, and arming reports the setting.
    A velocity offset left in the drive by its commissioning tool would move the stroke while the loop commands 0, and a
    torque offset when the motor takes the load over; the commands set that one where the rig file has a preload.
    """
    cylinder = settings.cylinder
    preloads = cylinder.rated_force_n is not None
    deceleration = round(cylinder.stop_deceleration_mm_s2 / units.ramp_mm_s2)
    wanted = (
        ("consumer heartbeat", consumer_heartbeat(settings), od.CONSUMER_HEARTBEAT, 1),
        ("command deadline", cylinder.command_deadline_ms, od.RPDO1_COMMUNICATION, 5),
        ("abort connection option", od.ABORT_CONNECTION_QUICK_STOP, od.ABORT_CONNECTION_OPTION, 0),
        ("quick stop option", od.QUICK_STOP_RAMP_THEN_OFF, od.QUICK_STOP_OPTION, 0),
        ("shutdown option", od.SLOW_DOWN_THEN_OFF, od.SHUTDOWN_OPTION, 0),
        ("disable operation option", od.SLOW_DOWN_THEN_OFF, od.DISABLE_OPERATION_OPTION, 0),
        ("fault reaction option", od.FAULT_REACTION_QUICK_STOP, od.FAULT_REACTION_OPTION, 0),
        ("quick stop deceleration", deceleration, od.QUICK_STOP_DECELERATION, 0),
        *((("velocity offset", 0, od.VELOCITY_OFFSET, 0),) if drive.has(od.VELOCITY_OFFSET) else ()),
        *((("torque offset", 0, od.TORQUE_OFFSET, 0),) if drive.has(od.TORQUE_OFFSET) and not preloads else ()),
    )
    return tuple(drive.enforce(*setting) for setting in wanted)


def release(bus: can.BusABC, settings: RigSettings, now_ns: Callable[[], int]) -> None:
    """End the drive's supervision of heartbeat and commands before a daemon ends; the drive is off, its brake closed.

    Without this the drive would miss our heartbeat and be in fault at the next start. Best effort: a drive that does
    not answer keeps its supervision, which is safe.
    """
    try:
        drive = RemoteNode(StartupBus(bus, now_ns), settings, "cylinder", _DEVICES["cylinder"][0])
        drive.write(0, od.RPDO1_COMMUNICATION, 5, verify=False)
        drive.write(0, od.CONSUMER_HEARTBEAT, 1, verify=False)
    except (StartupError, can.CanError):
        return
