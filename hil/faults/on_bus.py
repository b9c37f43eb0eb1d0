"""Faults of the bus: a tap on the wire, or a foreign node, alters the frames."""

from __future__ import annotations

import errno
import itertools
import math
import struct
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial

import can

from hil.faults.stand import FaultPlace, FindNode, Injector, Needs, Stand, Step
from hil.hub import Port
from hil.wire import ERROR_FLAG, FRAME
from rigctl.devices import objects
from rigctl.devices.process_data import COMMAND, wanted
from rigctl.model.parts import Part

FULL_LOAD_FRAMES = 7
"""Frames of 8 bytes in a millisecond at 1 Mbit/s, 135 bits each."""
_LOWEST, _HIGHEST = 0x7F0, 0x001
NMT_STOP, NMT_PRE_OPERATIONAL, NMT_RESET = 0x02, 0x80, 0x81
_BUS_OFF, _CONTROLLER, _PASSIVE = 0x040, 0x004, 0x30  # classes and byte 1 of linux/can/error.h
_of = partial(Injector, FaultPlace.BUS, needs=Needs.OWN_WIRE)
_BUS, _MASTER, _COMPUTER = (Part.BUS,), (Part.MASTER,), (Part.COMPUTER,)

cell = FindNode("cell", (Part.AMPLIFIER,))
slope = FindNode("slope", (Part.INCLINOMETER,))
drive = FindNode("drive", (Part.DRIVE,))
io = FindNode("io", (Part.IO_NODE,))
rail = FindNode("rail", (Part.RAIL_ENCODER,))
second = FindNode("second", (Part.SECOND_FORCE,))


def can_id(frame: bytes) -> int:
    """Identifier and flags of a frame."""
    return int(FRAME.unpack(frame)[0])


def silent(find: FindNode, base: int = objects.TPDO1_BASE, seconds: float = math.inf) -> Injector:
    """One device's samples, or other frames of its own, are lost from now on."""

    def inject(stand: Stand) -> Step:
        gone = base + find(stand).id
        heard = stand.intercept(lambda _, frame: () if can_id(frame) == gone else (frame,))
        return stand.ends_after(seconds, heard)

    return _of(find.part, inject)


def lost(share: float) -> Injector:
    """A share of all frames, from any sender, is lost."""

    def inject(stand: Stand) -> None:
        draw = stand.random.random
        stand.intercept(lambda _, frame: () if draw() < share else (frame,))

    return _of(_BUS, inject)


def burst(seconds: float) -> Injector:
    """All frames are lost for a while."""

    def inject(stand: Stand) -> Step:
        return stand.ends_after(seconds, stand.intercept(lambda _, __: ()))

    return _of(_BUS, inject)


def stalled(seconds: float) -> Injector:
    """What carries the frames stands still for a while, then delivers all of them at once, as a queue does."""

    def inject(stand: Stand) -> Step:
        hub, kept = stand.rig.hub, list[tuple[Port, bytes]]()

        def tap(port: Port, frame: bytes) -> Iterable[bytes]:
            if _from_controller(stand, frame):
                return (frame,)
            kept.append((port, frame))
            return ()

        free = stand.intercept(tap)

        def deliver() -> None:
            free()
            for port, frame in kept:
                hub.put(port, frame)

        return stand.ends_after(seconds, deliver)

    return _of(_COMPUTER, inject)


def twice() -> Injector:
    """Every frame arrives twice."""

    def inject(stand: Stand) -> None:
        stand.intercept(lambda _, frame: (frame, frame))

    return _of(_BUS, inject)


def frozen(find: FindNode, base: int = objects.TPDO1_BASE) -> Injector:
    """One device's samples go on with the content of the first of them, to the last bit."""

    def inject(stand: Stand) -> None:
        ours = base + find(stand).id
        first: list[bytes] = []

        def tap(_: Port, frame: bytes) -> Iterable[bytes]:
            if can_id(frame) != ours:
                return (frame,)
            if not first:
                first.append(frame)
            return first

        stand.intercept(tap)

    return _of((*find.part, Part.BUS), inject)


def sync_lost() -> Injector:
    """No device receives SYNC any more; every other frame arrives."""

    def inject(stand: Stand) -> None:
        stand.intercept(lambda _, frame: () if can_id(frame) == objects.SYNC_COB else (frame,))

    return _of(_BUS, inject)


def sync_twice() -> Injector:
    """Every SYNC reaches the devices twice; the controller, which sends it, does not see that."""

    def inject(stand: Stand) -> None:
        stand.intercept(lambda _, frame: (frame, frame) if can_id(frame) == objects.SYNC_COB else (frame,))

    return _of(_BUS, inject)


def sync_foreign(every: int = 1) -> Injector:
    """Another node sends SYNC too, in one of ``every`` ticks."""
    return _sent(_MASTER, lambda _: [FRAME.pack(objects.SYNC_COB, 0, b"")], every)


def late(ticks: int) -> Injector:
    """The devices' frames arrive some ticks late."""

    def inject(stand: Stand) -> Step:
        hub, waiting = stand.rig.hub, deque[tuple[int, Port, bytes]]()
        now = [0]

        def tap(port: Port, frame: bytes) -> Iterable[bytes]:
            if _from_controller(stand, frame):
                return (frame,)
            waiting.append((now[0] + ticks, port, frame))
            return ()

        def step(_: float) -> None:
            now[0] += 1
            while waiting and waiting[0][0] < now[0]:
                _, port, frame = waiting.popleft()
                hub.put(port, frame)

        stand.intercept(tap)
        return step

    return _of(_BUS, inject)


def reordered() -> Injector:
    """Neighbouring frames swap places, every other frame of the devices."""

    def inject(stand: Stand) -> None:
        kept: list[bytes] = []

        def tap(_: Port, frame: bytes) -> Iterable[bytes]:
            if _from_controller(stand, frame):
                return (frame,)
            if kept:
                return (frame, kept.pop())
            kept.append(frame)
            return ()

        stand.intercept(tap)

    return _of(_BUS, inject)


def cut(find: FindNode, share: float) -> Injector:
    """A share of one device's frames has a byte too few."""

    def inject(stand: Stand) -> None:
        ours, draw = objects.TPDO1_BASE + find(stand).id, stand.random.random

        def tap(_: Port, frame: bytes) -> Iterable[bytes]:
            identifier, size, data = FRAME.unpack(frame)
            if identifier == ours and draw() < share:
                return (FRAME.pack(identifier, size - 1, data),)
            return (frame,)

        stand.intercept(tap)

    return _of(find.part, inject)


def foreign(count: int) -> Injector:
    """Frames with identifiers that no node here has, some of them extended."""

    def inject(stand: Stand) -> Step:
        known = {0x000, 0x080} | {base + node.id for base in range(0x80, 0x780, 0x80) for node in stand.rig.rig.nodes}
        ids = [i for i in range(0x100, 0x700) if i not in known and i & 0x7F != stand.settings.can.controller_node]

        def step(_: float) -> None:
            for _n in range(count):
                flag = 0x80000000 if stand.random.random() < 0.2 else 0
                data = stand.random.randbytes(8)
                stand.rig.inject(FRAME.pack(stand.random.choice(ids) | flag, stand.random.randrange(9), data))

        return step

    return _of(_MASTER, inject)


def babble() -> Injector:
    """A node sends all it can with the lowest priority: it waits for all others."""
    return _sent(_BUS, lambda stand: [FRAME.pack(_LOWEST, 8, stand.random.randbytes(8))] * FULL_LOAD_FRAMES)


def babble_loud() -> Injector:
    """A node sends all it can with the highest priority: no other node gets the bus."""

    def inject(stand: Stand) -> Step:
        noise = FRAME.pack(_HIGHEST, 8, bytes(8))
        stand.intercept(lambda _, frame: (frame,) if frame == noise else ())

        def step(_: float) -> None:
            for _n in range(FULL_LOAD_FRAMES):
                stand.rig.inject(noise)

        return step

    return _of(_BUS, inject)


def impostor() -> Injector:
    """A foreign node sends samples of its own under the cell's identifier."""

    def frames(stand: Stand) -> list[bytes]:
        value = round(stand.random.uniform(0.0, 400.0) / objects.N_PER_CELL_UNIT)
        return [FRAME.pack(objects.TPDO1_BASE + stand.cell.id, 5, struct.pack("<iB", value, 0))]

    return _sent(_MASTER, frames)


def rival() -> Injector:
    """Another controller enables the drive and sends it a speed of its own every tick, after the loop's command."""
    values = {objects.CONTROLWORD: objects.Controlword.ENABLE_OPERATION, objects.TARGET_VELOCITY: 5000}

    def frames(stand: Stand) -> list[bytes]:
        layout = wanted(stand.settings).frames[COMMAND]
        data = layout.codec.pack(*(values.get(index, 0) for index, _ in layout.objects))
        return [FRAME.pack(layout.cob_base + stand.settings.cylinder.node, layout.size, data)]

    return _sent(_MASTER, frames)


def sdo_write(index: int, sub: int, size: int, value: int = 0, find: FindNode = drive) -> Injector:
    """Another master writes an object of a device once, as a commissioning tool left connected does."""

    def inject(stand: Stand) -> None:
        specifier = 0x23 | (4 - size) << 2
        data = struct.pack("<BHBI", specifier, index, sub, value)
        stand.rig.inject(FRAME.pack(objects.SDO_RX_BASE + find(stand).id, 8, data))

    return _of(_MASTER, inject)


def sdo_read() -> Injector:
    """Another master reads the drive's temperature ten times a second."""
    data = struct.pack("<BHB4x", 0x40, objects.DRIVE_TEMPERATURE, 0)
    return _sent(_MASTER, lambda stand: [FRAME.pack(objects.SDO_RX_BASE + stand.drive.id, 8, data)], every=100)


def sdo_answers() -> Injector:
    """The drive answers requests that the rig has not sent; the requests themselves are not received."""
    data = struct.pack("<BHB4x", 0x60, objects.QUICK_STOP_OPTION, 0)
    return _sent(_MASTER, lambda stand: [FRAME.pack(objects.SDO_TX_BASE + stand.drive.id, 8, data)])


def error_frames() -> Injector:
    """The controller reports itself error-passive, ten times a second; every frame still arrives."""
    frame = FRAME.pack(ERROR_FLAG | _CONTROLLER, 8, bytes([0, _PASSIVE, 0, 0, 0, 0, 0, 0]))
    return _sent(_BUS, lambda _: [frame], every=100)


def bus_off() -> Injector:
    """The controller's interface goes off the bus: an error frame reports it, then sending fails and nothing comes."""

    def inject(stand: Stand) -> None:
        def tap(_: Port, frame: bytes) -> Iterable[bytes]:
            if _from_controller(stand, frame):
                raise can.CanOperationError("no buffer space available", errno.ENOBUFS)
            return ()

        stand.rig.inject(FRAME.pack(ERROR_FLAG | _BUS_OFF, 8, bytes(8)))
        stand.intercept(tap)

    return _of(_BUS, inject)


def nmt(command: int, find: FindNode | None = None) -> Injector:
    """Another master gives an NMT command, to all nodes or to one."""

    def inject(stand: Stand) -> None:
        node = 0 if find is None else find(stand).id
        stand.rig.inject(FRAME.pack(objects.NMT_COB, 2, bytes([command, node])))

    return _of(_MASTER, inject)


def emergency(find: FindNode, code: int, register: int = 1) -> Injector:
    """A device's emergency message that reports only some error; its samples go on."""

    def inject(stand: Stand) -> None:
        node, data = find(stand), struct.pack("<HB5x", code, register)
        node.claims_error = True
        stand.rig.inject(FRAME.pack(objects.EMCY_BASE + node.id, 8, data))

    return _of(find.part, inject)


def _sent(part: tuple[Part, ...], frames: Callable[[Stand], list[bytes]], every: int = 1) -> Injector:
    """A node sends these frames in the first tick and in one of ``every``."""

    def inject(stand: Stand) -> Step:
        ticks = itertools.count()

        def step(_: float) -> None:
            for frame in frames(stand) if next(ticks) % every == 0 else ():
                stand.rig.inject(frame)

        return step

    return _of(part, inject)


def _from_controller(stand: Stand, frame: bytes) -> bool:
    identifier = can_id(frame)
    ours = (
        objects.SYNC_COB,
        objects.NMT_COB,
        objects.DRIVE_RPDO.cob_base + stand.settings.cylinder.node,
        objects.HEARTBEAT_BASE + stand.settings.can.controller_node,
        *(objects.SDO_RX_BASE + node for node in stand.settings.canopen_nodes.values()),
    )
    return identifier in ours
