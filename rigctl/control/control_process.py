"""The control process: bring the devices up, take the gains, request real time, run the loop.

Only numbers cross to it: settings from the runtime folder, gains as one line on standard input, rings for the rest.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
from collections.abc import Callable
from dataclasses import asdict
from types import FrameType

import can
import msgspec
from can.typechecking import CanFilters
from pydantic import ValidationError

from rigctl.config.settings import RigSettings
from rigctl.control import realtime
from rigctl.control.bus.cell_correction import cell_history
from rigctl.control.bus.hold_sockets import HoldSockets, prepared
from rigctl.control.bus.network_state import master_ids
from rigctl.control.clock import GridClock, SimulatedClock
from rigctl.control.law.gain_table import ScheduledGains
from rigctl.control.law.tension import Gains
from rigctl.control.load import last_stroke
from rigctl.control.logbook import Rings
from rigctl.control.loop import Loop
from rigctl.devices import can_interface, startup
from rigctl.devices import objects as od
from rigctl.devices.process_data import COMMAND, ProcessData
from rigctl.ipc.ledger import in_force
from rigctl.ipc.runtime_folder import REFUSED, WAITS, FolderError, Runtime
from rigctl.ipc.termination import EXIT_STARTS_ANEW, on_signals
from rigctl.model.checks import Check
from rigctl.model.device_states import STATUSWORD

WARM_UP_TICKS = 50
# Other interfaces filter in python-can, where a refused frame ends a drain and old samples would pile up behind it.
FILTERS_IN_FULL = ("socketcan", "rigsim")
EXIT_CANNOT_START = 1
SUPERVISOR_ENDED = signal.SIGINT
"""Sent by the kernel while the loop runs: a request to end, but never the second one, which leaves the load."""


def receive_filters(settings: RigSettings, process_data: ProcessData) -> CanFilters:
    """Ids the loop reads, so that in-kernel filters keep all other frames from the socket."""
    bases = (od.EMCY_BASE, od.HEARTBEAT_BASE, od.SDO_TX_BASE, od.SDO_RX_BASE)
    ids = [base + node for base in bases for node in settings.canopen_nodes.values()]
    ids += list(process_data.can_ids(settings).values())
    ids += master_ids(settings)
    ids += [message.can_id for message in settings.plain_messages.values()]
    return [{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in ids]


def open_bus(settings: RigSettings) -> can.BusABC:
    """The loop's bus.

    Raises:
        StartupError: one line.
    """
    try:
        return can_interface.opened(settings.can)
    except can_interface.OpenError as error:
        where = f"{settings.can.interface}:{settings.can.channel}"
        raise startup.StartupError(f"{where} cannot be opened: {error}") from None


def warm_up(settings: RigSettings, gains: Gains, process_data: ProcessData) -> None:
    """Run every path of the tick on a bus of its own, so that no real tick is the first to execute its code.

    Rings and socket are this process's alone: a loop that comes back needs no room that others could have taken.
    """
    bus = can.Bus(interface="virtual", channel=f"warm-up-{os.getpid()}")
    other = can.Bus(interface="virtual", channel=f"warm-up-{os.getpid()}")
    clock = SimulatedClock(settings.loop.period_ns, lambda _t: _answer(other, settings, process_data))
    taken, given = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    holds = HoldSockets([prepared(taken)])
    given.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)  # has the kernel give it an address for the answer
    loop = Loop(
        settings, gains, bus, clock, Rings.in_own_memory(), supervised=True, process_data=process_data, holds=holds
    )
    given.send(b"warm-up")
    for _ in range(WARM_UP_TICKS):
        loop.tick()
    holds.close()
    given.close()
    bus.shutdown()
    other.shutdown()


def _answer(bus: can.BusABC, settings: RigSettings, process_data: ProcessData) -> None:
    samples = {
        od.AI_PROCESS_VALUE: 300_000, od.SLOPE_LONG: 10, STATUSWORD: 0x0237, od.POSITION_ACTUAL: 50_000,
        od.VELOCITY_ACTUAL: 1, od.VELOCITY_ACTUAL_16: 1, od.CURRENT_ACTUAL: 100, od.DIGITAL_INPUTS: 0xFFFFFFFF,
        od.INPUTS_8: od.EVERY_INPUT_8,
    }  # fmt: skip
    ids = process_data.can_ids(settings)
    frames = {
        ids[name]: layout.codec.pack(*(samples.get(index, 0) for index, _ in layout.objects))
        for name, layout in process_data.frames.items()
        if name != COMMAND
    }
    for message in settings.plain_messages.values():
        frames[message.can_id] = message.payload({"tension": 300.0, "tangential": 1e-3, "normal": 0.0, "valid": 1.0})
    for can_id, data in frames.items():
        bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
    while bus.recv(0) is not None:
        pass


def _stop_on_signal(loop: Loop) -> Callable[[int, FrameType | None], None]:
    def on_signal(number: int, _frame: FrameType | None) -> None:
        if loop.stop_requested and number != SUPERVISOR_ENDED:
            loop.repeated_stops += 1
        loop.stop_requested = True

    return on_signal


def _say(line: str) -> None:
    sys.stderr.write(f"rigctl: {line}\n")
    sys.stderr.flush()


class _Waits:
    """Shows the supervisor what this start waits for, once for each thing in turn."""

    def __init__(self, runtime: Runtime) -> None:
        self._runtime, self._shown = runtime, ""

    def __call__(self, name: str) -> None:
        if name != self._shown:
            self._shown = name
            with contextlib.suppress(OSError):  # no room: it is not shown
                self._runtime.write_json(WAITS, {"waits_for": name})


def _brought_up(
    settings: RigSettings, clock: GridClock, waits: Callable[[str], None]
) -> tuple[can.BusABC, startup.StartupReport]:
    """The bus, with the devices up.

    Raises:
        StartupError: they are not, and the bus is closed.
    """
    waits(f"bus {settings.can.interface}")
    bus = open_bus(settings)
    try:
        return bus, startup.bring_up(bus, settings, clock.now, _say, waits)
    except BaseException:
        bus.shutdown()
        raise


def _refuse(runtime: Runtime, why: str) -> None:
    """Leave the reason to the supervisor, which puts it on the terminal and on record."""
    try:
        runtime.write_json(REFUSED, {"why": why})
    except OSError:
        _say(why)


def run(directory: str) -> int:
    """Body of the process; returns its exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    realtime.die_with_parent(signal.SIGTERM)
    try:
        runtime = Runtime.entered(directory)
    except FolderError as error:
        _say(f"control: {error}")
        return EXIT_CANNOT_START
    try:
        settings = RigSettings.model_validate(runtime.read_json("active.json").get("settings"))
    except (OSError, msgspec.MsgspecError, ValidationError):
        sys.stderr.write("rigctl: control: active.json holds no valid settings\n")
        return EXIT_CANNOT_START
    clock, waits = GridClock(settings.loop.period_ns, settings.loop.spin_us * 1000), _Waits(runtime)
    try:
        bus, report = _brought_up(settings, clock, waits)
    except startup.StartupError as error:
        _refuse(runtime, str(error))
        return EXIT_CANNOT_START
    waits("design of the gains")
    line = sys.stdin.readline()
    if not line:
        bus.shutdown()
        return EXIT_CANNOT_START  # the supervisor has ended or refused the design
    gains = msgspec.json.decode(line, type=ScheduledGains)
    waits("first tick of the loop")
    warm_up(settings, gains, report.process_data)
    if settings.can.interface in FILTERS_IN_FULL:
        bus.set_filters(receive_filters(settings, report.process_data))
    correction, kept = in_force(runtime).correction, last_stroke.in_force(runtime)
    history = cell_history(runtime.records.reader())
    try:
        holds = HoldSockets.of(runtime)
    except OSError as error:
        bus.shutdown()
        _refuse(runtime, f"{settings.rig}: the sockets for HOLD cannot be made: {error.strerror}")
        return EXIT_CANNOT_START
    loop = Loop(
        settings,
        gains,
        bus,
        clock,
        Rings.of(runtime),
        supervised=report.supervised,
        host_checks=Check.HOST,  # the gateway evaluates them before an operator can arm
        correction=correction,
        process_data=report.process_data,
        watched=report.watched,
        found=report.found,
        last_stroke=kept.stroke,
        kept_brake=kept.brake,
        cell_history=history,
        holds=holds,
    )
    on_signals(_stop_on_signal(loop), signal.SIGTERM, signal.SIGHUP, SUPERVISOR_ENDED)
    realtime.die_with_parent(SUPERVISOR_ENDED)
    frozen = realtime.freeze_garbage_collector()  # before real time: its 100 ms must not delay another loop
    applied = [*realtime.apply(settings.loop), frozen]
    found = {
        "pid": os.getpid(),
        "host_checks": int(Check.HOST),  # as the loop started with them, for a replay
        "realtime": [asdict(setting) for setting in applied],
        "last_stroke": asdict(kept.stroke),  # also for a replay
        "kept_brake": asdict(kept.brake),  # also for a replay
        "cell_history": history,  # also for a replay
        "warnings": [f"{setting.name}: {setting.warning}" for setting in applied if not setting.ok],
        **report.as_json(),
    }
    try:
        runtime.write_json("control.json", found)
    except OSError as error:
        _say(f"WARNING: control.json cannot be written: {error.strerror}; what the loop found is not shown")
    loop.run()
    anew = loop.machine.sequence.anew
    if loop.drive_off and not anew:  # else the drive keeps its supervision, which stops it
        bus.set_filters(None)
        startup.release(bus, settings, clock.now)
    bus.shutdown()
    holds.close()
    realtime.leave()  # not earlier: until its release the drive supervises us
    return EXIT_STARTS_ANEW if anew else 0
