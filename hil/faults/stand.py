"""A rig brought to a mode, with the access that a fault's injector needs."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum, StrEnum, auto
from typing import Protocol, TypeVar

from hil.hub import Hub, Port, Tap
from hil.lockstep import Lockstep
from hil.nodes.cylinder_drive import CylinderDrive
from hil.nodes.inclinometer import Inclinometer
from hil.nodes.io_node import IoNode
from hil.nodes.node import Node
from hil.nodes.rail_encoder import RailEncoder
from hil.nodes.second_force import SecondForceNode
from hil.nodes.tension_amplifier import TensionAmplifier
from hil.operated_rig import arm_and_tension
from hil.plant import Plant
from hil.rig import SimulatedRig
from rigctl.config.settings import RigSettings
from rigctl.devices import objects
from rigctl.model.parts import Part
from rigctl.model.states import HeldBy, Mode
from rigctl.model.verbs import Verb

WAKE_S = 0.2
SETTLE_S = 0.6
"""Time until the filter has settled on a tension that was there before it."""
RAMP_S = 1.0
CLOSED_S = 0.3
RELEASE_S = 0.5
PARKED_S = 2.5
"""For standstill, the brake, its first second, and a load that is seen at rest."""
SILENCE_MS = 30
TENSIONING_FROM_N = 100.0
CLOSED_BELOW_N = 25.0
"""Preload below the target: enough way for the sign checks of the first tensioning."""
TENSION_LIMIT_S = 20.0

_Device = TypeVar("_Device")
_CLOSED = (Mode.COMPENSATING, Mode.FAULT)
_RAMPS = {Mode.TENSIONING: (Verb.TENSION, RAMP_S), Mode.RELEASING: (Verb.RELEASE, RELEASE_S)}

Step = Callable[[float], None]
"""Called before every tick with the seconds since the fault began."""


class FaultPlace(StrEnum):
    """Where a fault is."""

    BUS = "bus"
    DEVICE = "device"
    PLANT = "plant"
    CONTROLLER = "controller"
    SEVERAL = "several"


class Needs(Enum):
    """What a rig must have, apart from the device, for a fault while it runs; each member needs more than the last."""

    NOTHING = auto()
    OWN_WIRE = auto()  # of the simulator
    LOOP = auto()  # in lockstep
    START = auto()  # the fault is a state of the rig from its start


@dataclass(frozen=True)
class Injector:
    """Puts a fault into a rig: ``begin`` returns what goes on with it, if anything does."""

    place: FaultPlace
    part: tuple[Part, ...]
    """Any of which may be named for the fault, several where signals cannot decide; a command has none."""
    begin: Callable[[Stand], Step | None]
    needs: Needs = Needs.NOTHING

    def __call__(self, stand: Stand) -> Step | None:
        """Begin."""
        return self.begin(stand)


def parts_of(injectors: Iterable[Injector]) -> tuple[Part, ...]:
    """The parts of several faults."""
    return tuple(dict.fromkeys(part for injector in injectors for part in injector.part))


def needs_of(injectors: Iterable[Injector]) -> Needs:
    """What a rig must have for several faults: the most that one of them needs."""
    return max((injector.needs for injector in injectors), key=lambda needs: needs.value, default=Needs.NOTHING)


@dataclass(frozen=True)
class FindNode:
    """Finds one device of the rig."""

    name: str
    """Property of `Stand`."""
    part: tuple[Part, ...]

    def __call__(self, stand: Stand) -> Node:
        """The device.

        Raises:
            NoDeviceError: the rig has none.
        """
        found: Node = getattr(stand, self.name)
        return found


class NoDeviceError(LookupError):
    """The rig lacks the device that a fault is about; ``str()`` is one line."""


class FaultyRig(Protocol):
    """A running rig as a fault meets it: `hil.lockstep.Lockstep`, or the rig that ``python -m hil serve`` runs."""

    @property
    def settings(self) -> RigSettings:
        """The rig file."""

    @property
    def rig(self) -> SimulatedRig:
        """Plant and devices."""

    @property
    def hub(self) -> Hub:
        """The wire."""

    def inject(self, frame: bytes) -> None:
        """Put a frame on the bus as a foreign node would."""


class Stand:
    """A rig. A fault takes its random numbers from ``random``, which a row always seeds alike."""

    def __init__(self, rig: FaultyRig, seed: str) -> None:
        self.rig = rig
        self.random = random.Random(seed)

    @property
    def lockstep(self) -> Lockstep:
        """The loop beside the rig, for faults of the loop itself.

        Raises:
            NoDeviceError: the loop is another process.
        """
        return _there(self.rig if isinstance(self.rig, Lockstep) else None, "loop in lockstep")

    @property
    def settings(self) -> RigSettings:
        """The rig file with the row's changes."""
        return self.rig.settings

    @property
    def plant(self) -> Plant:
        """Rope, payload and cylinder."""
        return self.rig.rig.plant

    @property
    def drive(self) -> CylinderDrive:
        """The cylinder's drive."""
        return self.rig.rig.drive

    @property
    def cell(self) -> TensionAmplifier:
        """The cell's amplifier, CANopen."""
        cell = self.rig.rig.cell
        return _there(cell if isinstance(cell, TensionAmplifier) else None, "CANopen tension amplifier")

    @property
    def slope(self) -> Inclinometer:
        """The inclinometer, CANopen."""
        slope = self.rig.rig.inclinometer
        return _there(slope if isinstance(slope, Inclinometer) else None, "CANopen inclinometer")

    @property
    def io(self) -> IoNode:
        """The I/O node, in the rows whose rig has one."""
        return _there(self.rig.rig.io, "I/O node")

    @property
    def rail(self) -> RailEncoder:
        """The rail's encoder, in the rows whose rig has one."""
        return _there(self.rig.rig.rail_encoder, "rail encoder")

    @property
    def second(self) -> SecondForceNode:
        """The second force path, in the rows whose rig has one."""
        return _there(self.rig.rig.second_force, "second force path")

    def intercept(self, tap: Tap) -> Callable[[], None]:
        """Put a defect of the wire behind those it has already; returns what takes this one out again."""
        before, present = self.rig.hub.tap, [tap]

        def chained(port: Port, frame: bytes) -> Iterable[bytes]:
            frames = (frame,) if before is None else before(port, frame)
            return [out for passed in frames for out in present[0](port, passed)] if present else frames

        self.rig.hub.tap = chained
        return present.clear

    def ends_after(self, seconds: float, undo: Callable[[], None]) -> Step:
        """A step that calls ``undo`` once, ``seconds`` after the fault began."""
        pending = [undo]

        def step(t_s: float) -> None:
            if pending and t_s >= seconds:
                pending.pop()()

        return step


def _there(device: _Device | None, words: str) -> _Device:
    if device is None:
        raise NoDeviceError(f"this rig has no {words}")
    return device


def start(rig: Lockstep, mode: Mode, preload_n: float | None) -> None:
    """Switch power on with the load on the rope (or slack, with 0 N) and wait until every signal is fresh."""
    target_n = rig.settings.tension.target_n
    usual = {Mode.TENSIONING: TENSIONING_FROM_N, **dict.fromkeys(_CLOSED, target_n - CLOSED_BELOW_N)}.get(
        mode, target_n
    )
    tension_n = usual if preload_n is None else preload_n
    if tension_n:
        rig.rig.plant.preload(tension_n)
    rig.run(SETTLE_S if tension_n else WAKE_S)


def enter(rig: Lockstep, mode: Mode) -> None:
    """Take the rig from DISARMED to a mode as an operator does; to FAULT by a short silence of the cell.

    Raises:
        RuntimeError: the rig did not get there.
    """
    if mode in _CLOSED:
        arm_and_tension(rig, armed_s=WAKE_S, limit_s=TENSION_LIMIT_S, settle_s=CLOSED_S)
    elif mode is not Mode.DISARMED:
        rig.do(Verb.ARM)
        rig.run(WAKE_S)
    if mode in _RAMPS:
        verb, seconds = _RAMPS[mode]
        rig.do(verb)
        rig.run(seconds)
    if mode is Mode.FAULT:
        samples = objects.TPDO1_BASE + rig.settings.tension_cell.node
        rig.hub.tap = lambda _, frame: () if int.from_bytes(frame[:2], "little") == samples else (frame,)
        rig.run(SILENCE_MS * 1e-3)
        rig.hub.tap = None
        rig.run(WAKE_S)
    found = rig.loop.machine.mode
    if found is not mode:
        raise RuntimeError(f"not in {mode.name} but in {found.name}, fault {rig.loop.machine.fault.name}")


def park(rig: Lockstep) -> None:
    """Wait until the brake has the load, and its first second is over.

    Raises:
        RuntimeError: it has not taken it.
    """
    rig.run(rig.settings.hold.park_s + PARKED_S)
    held_by = HeldBy(int(rig.record["held_by"]))
    if held_by is not HeldBy.BRAKE:
        raise RuntimeError(f"not held by the brake but by {held_by.name}")
