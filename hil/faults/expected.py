"""What may be expected of a rig in which something fails, and what a fault's row in the catalogue says."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum

from hil.faults.stand import Injector
from hil.plant.inputs import Track
from rigctl.config.settings_base import Settings
from rigctl.control.modes import Mode


class Reaction(StrEnum):
    """What the rig does about a fault; the first eight may be expected of it, the rest is only ever found."""

    RIDDEN = "ridden through"  # no reaction: the mode goes on
    HELD = "held"  # FAULT latched, stroke held
    EITHER = "held or ridden through"
    DRIVE_OFF = "drive off"  # FAULT latched and the drive's power taken away: a held drive would not stand still
    DRIVE_STOPS = "drive stops"  # nobody commands it any more: it stops and closes its brake by itself
    REFUSED = "arm refused"
    LATCHED = "latched"  # FAULT from DISARMED: the brake holds, or should
    KEPT = "kept"  # FAULT stays latched, the stroke held
    ARMED = "arm accepted"
    MOVES = "latched, still moving"
    LEFT = "mode left without a fault"


EVERY = tuple(Mode)
ARMED = (Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)
MOVING = (Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING)

Expected = Mapping[Mode, Reaction]
RIDE: Expected = dict.fromkeys(EVERY, Reaction.RIDDEN) | {Mode.FAULT: Reaction.KEPT}
"""It must not matter."""
HOLD: Expected = dict.fromkeys(ARMED, Reaction.HELD) | {
    Mode.DISARMED: Reaction.REFUSED,
    Mode.FAULT: Reaction.KEPT,
}
"""Any loss ends with the stroke held, latched; nobody arms a rig that has it."""
PASSING: Expected = {**HOLD, Mode.DISARMED: Reaction.RIDDEN}
"""As ``HOLD``, but over by the time somebody arms, or not to be seen by a rig at rest."""
LOST: Expected = PASSING
"""The load itself has gone: the drive must not run after it."""
FROM_START: Expected = {Mode.TENSIONING: Reaction.HELD}
"""There before the rig is armed for the first time, and seen when the rope gets tight."""
WHEN_MOVING: Expected = {**RIDE, **dict.fromkeys(MOVING, Reaction.HELD)}
"""Only shows, and only matters, where the stroke should move."""
POWER_OFF: Expected = dict.fromkeys((*ARMED, Mode.FAULT), Reaction.DRIVE_OFF)
"""A drive that does not do as it is told: to hold it takes away its power, then its brake holds."""

PRESSED: Expected = {**POWER_OFF, Mode.DISARMED: Reaction.LATCHED}
"""The emergency stop, told by software: quick stop, then the brake; latched from everywhere."""
DRIVE_STOPS: Expected = dict.fromkeys((*ARMED, Mode.FAULT), Reaction.DRIVE_STOPS) | {Mode.DISARMED: Reaction.RIDDEN}
"""Nobody commands the drive."""
EITHER: Expected = dict.fromkeys(ARMED, Reaction.EITHER) | {Mode.DISARMED: Reaction.RIDDEN, Mode.FAULT: Reaction.KEPT}
"""Whether it is too bad to go on is the rig's choice; the bound on the tension is not."""

SENSOR_MS = 20.0
"""From the first sample called bad to the safe command, sensors and bus."""
DRIVE_MS = 120.0
"""The same where a drive has to be told from its own lag: its speed, over 100 ms, and a tick or two."""
NO_HEARTBEAT_MS = 610.0
"""Five periods of 100 ms without a device's heartbeat, up to one since the last that came, and a tick or two."""
ACCURACY_N = 9.0
"""3 % of 300 N: what a hanging load may have from a fault it is carried through."""


@dataclass(frozen=True)
class Around:
    """What the rig is like, and what it is doing, when the fault comes; the run without the fault has it too."""

    change: tuple[tuple[str, float | Settings], ...] = ()
    """Settings, or a whole section, by dotted key."""
    motion: Callable[[], Mapping[int, Track]] | None = None
    """What is prescribed to the plant from the moment of the fault on."""
    preload_n: float | None = None
    """Tension the mode is entered with, where it is not the usual."""


@dataclass(frozen=True)
class InjectedFault:
    """One fault of the catalogue.

    ``band_n`` is how far the true tension may be from what it would be without the fault, up to the reaction, and from
    there on from what it was then; ``held_mm`` how far the true stroke may be from what it would be without the fault,
    in the modes that keep it (DISARMED, HOLD, FAULT), from the fault's beginning on; ``within_ms`` the time from the
    fault's beginning to the reaction, where physics give one; ``latency_ms`` the time from the first sample that a
    limit of the rig calls bad.
    """

    id: str
    place: str  # bus, device, plant, controller or process
    what: str
    inject: Injector
    expected: Expected
    _: KW_ONLY
    seconds: float = 1.0
    band_n: float = ACCURACY_N
    held_mm: float = math.inf
    within_ms: float = math.inf
    latency_ms: float = SENSOR_MS
    carried: bool = True
    from_start: bool = False  # there since power was switched on; the mode is entered with it
    counter: str = ""  # field of the record that must have counted it
    around: Around = field(default_factory=Around)
    why: str = ""

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Where it can happen."""
        return tuple(mode for mode in EVERY if mode in self.expected)
