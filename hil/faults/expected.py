"""The reactions that a fault may be expected to cause, and the fields of a fault's row in the catalogue."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum

from hil.faults.stand import FaultPlace, Injector, Needs
from hil.plant.inputs import Track
from rigctl.config.settings_base import Settings
from rigctl.model.parts import Part
from rigctl.model.states import Mode


class Reaction(StrEnum):
    """The rig's reaction to a fault; the first eight may be expected, the others are only observed."""

    RIDDEN = "ridden through"  # no reaction: the mode goes on
    HELD = "held"  # FAULT latched, stroke held
    EITHER = "held or ridden through"
    DRIVE_OFF = "drive off"  # FAULT latched and the drive's power removed: a held drive would not stand still
    DRIVE_STOPS = "drive stops"  # without commands the drive stops and closes its brake by itself
    REFUSED = "arm refused"
    LATCHED = "latched"  # FAULT from DISARMED: the brake holds, or should hold
    KEPT = "kept"  # FAULT stays latched, the stroke held
    ARMED = "arm accepted"
    MOVES = "latched, still moving"
    LEFT = "mode left without a fault"


EVERY = tuple(Mode)
ARMED = (Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)
MOVING = (Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)

Expected = Mapping[Mode, Reaction]
RIDE: Expected = dict.fromkeys(EVERY, Reaction.RIDDEN) | {Mode.FAULT: Reaction.KEPT}
"""The fault must have no effect."""
HOLD: Expected = dict.fromkeys(ARMED, Reaction.HELD) | {
    Mode.DISARMED: Reaction.REFUSED,
    Mode.FAULT: Reaction.KEPT,
}
"""Any loss ends with the stroke held, latched; a rig that has it cannot be armed."""
PASSING: Expected = {**HOLD, Mode.DISARMED: Reaction.RIDDEN}
"""As ``HOLD``, but over before the rig is armed, or invisible on a rig at rest."""
LOST: Expected = PASSING
"""The load itself is lost: the drive must not run after it."""
FROM_START: Expected = {Mode.TENSIONING: Reaction.HELD}
"""Present before the rig is armed for the first time, and detected when the rope gets tight."""
WHEN_MOVING: Expected = {**RIDE, **dict.fromkeys(MOVING, Reaction.HELD)}
"""Visible, and harmful, only where the stroke should move."""
POWER_OFF: Expected = dict.fromkeys((*ARMED, Mode.FAULT), Reaction.DRIVE_OFF)
"""A drive that disobeys is held by taking its power away; then its brake holds."""

PRESSED: Expected = {**POWER_OFF, Mode.DISARMED: Reaction.LATCHED}
"""The emergency stop, reported to the software: quick stop, then the brake; latched from every mode."""
DRIVE_STOPS: Expected = dict.fromkeys((*ARMED, Mode.FAULT), Reaction.DRIVE_STOPS) | {Mode.DISARMED: Reaction.RIDDEN}
"""The drive receives no commands."""
EITHER: Expected = dict.fromkeys(ARMED, Reaction.EITHER) | {Mode.DISARMED: Reaction.RIDDEN, Mode.FAULT: Reaction.KEPT}
"""The rig may go on or stop; the bound on the tension holds either way."""

SENSOR_MS = 20.0
"""From the first sample beyond a limit to the safe command, for sensors and bus."""
DRIVE_MS = 120.0
"""The same where a fault of the drive must differ from its lag: its speed, over 100 ms, and a tick or two."""
NO_HEARTBEAT_MS = 610.0
"""Five periods of 100 ms without a device's heartbeat, up to one since the last heartbeat, and a tick or two."""
ACCURACY_N = 9.0
"""3 % of 300 N: the tension error a hanging load may have from a fault that is ridden through."""


@dataclass(frozen=True)
class Around:
    """State of the rig, and its motion, when the fault comes; the run without the fault has it too."""

    change: tuple[tuple[str, float | str | Settings | tuple[()] | None], ...] = ()
    """Settings, or a whole section, by dotted key."""
    motion: Callable[[], Mapping[int, Track]] | None = None
    """Motion of the plant from the moment of the fault on."""
    preload_n: float | None = None
    """Tension on entering the mode, where it is not the usual one."""
    parked: bool = False
    """The brake has the load: HOLD and FAULT after their parking."""
    phase: str = ""
    """Phase of arming in which the fault comes, see `hil.faults.rows.arming_phases`; "": none is under way."""
    course: Injector | None = None
    """Commands of the run without the fault, where they move the load by more than the bound."""


@dataclass(frozen=True)
class InjectedFault:
    """One fault of the catalogue.

    ``band_n`` bounds the distance of the true tension from its value without the fault, up to the reaction, and from
    there on from that value at the reaction. ``held_mm`` bounds the distance of the true stroke from its value without
    the fault, in the modes that keep it (DISARMED, HOLD, FAULT), from the fault's beginning on. ``within_ms`` is the
    time from the fault's beginning to the reaction, where physics give one, ``latency_ms`` that from the first sample
    beyond a limit of the rig. ``after_s``: the row is watched for so long after its ``seconds``. ``shown_late_ms``: age
    that the fault itself adds to the statusword shown. ``against_cut``: instead of ``band_n``, the load may be off by
    10 % more than with the motor's power cut at the first tick that shows the fault (`hil.faults.judging.first_sign`).
    """

    id: str
    what: str
    inject: Injector
    expected: Expected
    _: KW_ONLY
    part: tuple[Part, ...] = ()  # any of which may be named for it; (): its injector's
    seconds: float = 1.0
    after_s: float = 0.0
    shown_late_ms: float = 0.0
    band_n: float = ACCURACY_N
    against_cut: bool = False
    held_mm: float = math.inf
    within_ms: float = math.inf
    latency_ms: float = SENSOR_MS
    carried: bool = True
    from_start: bool = False  # present since power-on; the mode is entered with it
    ends_elsewhere: bool = False  # commands are part of it: any mode may be the last if the load is where it was
    counter: str = ""  # field of the record that must have counted the fault
    around: Around = field(default_factory=Around)
    why: str = ""

    def __post_init__(self) -> None:
        if not self.part:
            object.__setattr__(self, "part", self.inject.part)

    @property
    def place(self) -> FaultPlace:
        """Where the fault is."""
        return self.inject.place

    @property
    def needs(self) -> Needs:
        """What a running rig must have so that the fault can be put into it."""
        return self.inject.needs

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Modes in which the fault can occur."""
        return tuple(mode for mode in EVERY if mode in self.expected)
