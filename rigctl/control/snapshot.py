"""What the safety table, the checks and the escalation look at in one tick."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from rigctl.control.findings import (
    DriveStatusSeen,
    HeldTensionSeen,
    PlausibilitySeen,
    ProbeSeen,
    ReadbackSeen,
    SignsSeen,
    SinkingSeen,
    StrokeHoldSeen,
    TakeUpSeen,
)
from rigctl.control.power.power_seen import PowerSeen
from rigctl.model.states import HeldBy, LoadAtRest

ROUNDING = 1e-9  # share of a bound that rounding surely stays below


@dataclass(slots=True)
class Snapshot:
    """Values of one tick, ages in ns, quality bits (0 good), counters.

    `rigctl.control.observer.Observer` alone assigns them, each in one place; the rest of the tick reads them. A group
    of findings is its detector's own, see `rigctl.control.findings`.
    """

    t_ns: int = 0
    tension_n: float = math.nan
    reading_n: float = math.nan  # tension before zero and scale are applied
    cell_age_ns: int = 1 << 62
    cell_heard: bool = False  # that age is not above safety.stale_ms
    cell_quality: int = 0
    inclination_age_ns: int = 1 << 62
    inclination_quality: int = 0
    tangential_rad: float = 0.0
    normal_rad: float = 0.0
    stroke_mm: float = math.nan
    travel_mm: float = 0.0  # since COMPENSATING began, less what the set-point has moved
    speed_mm_s: float = 0.0
    drive_age_ns: int = 1 << 62
    drive_heard: bool = False  # the same
    drive_enabled: bool = False
    drive_off: bool = False  # no power, brake closed or closing
    power: PowerSeen = field(default_factory=PowerSeen)  # state, times and brake of the drive
    still_ns: int = 0  # time the stroke has stood still, see rigctl.control.power.power_seen
    sinking: SinkingSeen = field(default_factory=SinkingSeen)
    drive_faulted: bool = False
    drive_warning: bool = False
    drive_local: bool = False  # statusword bit 9 is off: the drive takes no commands from the bus
    drive_limited: bool = False  # statusword bit 11: a limit inside the drive is active
    drive_ignores: bool = False  # enabled, but bit 12 is off: the drive does not follow the target velocity
    drive_powered: bool = False  # neither off nor in its fault state
    drive_not_requested: bool = False  # enabled again after it was off, without our command
    drive_off_pending: bool = False  # commanded to go off, and not seen off since
    drive_may_be_on: bool = False  # commanded or seen on since it was last seen without power
    drive_stops: bool = False  # in a state that ends without power by itself
    unseen_mm: float = 0.0  # most the stroke may have moved since the drive's newest sample
    heartbeats_t_ns: dict[int, int] = field(default_factory=dict)  # time of each node's newest heartbeat
    node_states: dict[int, int] = field(default_factory=dict)  # NMT state each node reported last
    drive_status: DriveStatusSeen = field(default_factory=DriveStatusSeen)
    e_stop: int = 0  # inputs that read as pressed, bits of EStop
    io_age_ns: int = 1 << 62  # of the I/O node's inputs, where one is fitted
    torque_off: bool = False  # the drive's STO feedback at the I/O node shows it without torque, by a fresh input
    enable_ignored: bool = False  # that feedback is not as the drive's hard-wired enable should have it
    warmth_age_ns: int = 1 << 62  # of the cell's temperature, where it comes from the cell
    force_gap_n: float = 0.0  # second force path less cell, low-passed; where one is fitted, as the next three
    second_age_ns: int = 1 << 62
    second_quality: int = 0
    second_known: bool = False  # its zero is on the ledger
    rail_age_ns: int = 1 << 62  # of the rail encoder's angle, where one is fitted
    bus_age_ns: int = 1 << 62
    sync_age_ns: int = 0  # of the newest sample that SYNC latches, while the bus is alive
    error_frames: int = 0  # in the last second
    skipped_in_window: int = 0
    lateness_ns: int = 0
    command_age_ns: int = 0  # since an operator gave the last one
    stroke_limited: bool = False
    drive_wanted: bool = False
    held_by: HeldBy = HeldBy.UNKNOWN  # as the tick before has left it
    power_off: int = 0  # the same; see rigctl.control.power.power_off
    load_at_rest: LoadAtRest = LoadAtRest.UNKNOWN  # the same; see rigctl.control.load.load_at_rest
    rope_lost: bool = False
    device_restarted: bool = False
    master_age_ns: int = 1 << 62  # since another controller was heard
    master_words: str = ""  # what that controller did
    stroke_unconfirmed: bool = False  # see rigctl.control.load.homed
    stroke_jump_mm: float = 0.0  # kept until the stroke is confirmed
    readback: ReadbackSeen = field(default_factory=ReadbackSeen)
    sensor_emergency: int = 0  # node << 16 | code of an emergency that is still active
    drive_emergency: int = 0
    signs: SignsSeen = field(default_factory=SignsSeen)
    rejects: int = 0
    slope_rejects: int = 0
    cell_nis: float = 0.0
    vertical_error_n: float = 0.0  # from the set-point on its ramp, 0 without a set-point
    disturbance_mm_s: float = 0.0
    plausibility: PlausibilitySeen = field(default_factory=PlausibilitySeen)
    stroke_hold: StrokeHoldSeen = field(default_factory=StrokeHoldSeen)
    held_tension: HeldTensionSeen = field(default_factory=HeldTensionSeen)
    probe: ProbeSeen = field(default_factory=ProbeSeen)
    take_up: TakeUpSeen = field(default_factory=TakeUpSeen)
    least_peak: float = 0.0  # measured sensitivity peak less its uncertainty, 0 without one


def reader(fields: Collection[str]) -> Callable[[Snapshot], tuple[Any, ...]]:
    """Function that reads all these fields off a snapshot, in one call; ``power.off_ns`` is a field of a group."""
    if len(fields) < 2:  # then attrgetter gives no tuple
        reads = [attrgetter(name) for name in fields]
        return lambda snapshot: tuple([read(snapshot) for read in reads])
    return attrgetter(*fields)


class FieldValue:
    """``factor`` times a field of the snapshot, or the ``magnitude`` of that."""

    def __init__(self, field: str, factor: float = 1.0, *, magnitude: bool = False) -> None:
        self.field, self._factor, self._magnitude = field, factor, magnitude
        self._read = attrgetter(field)

    def __call__(self, snapshot: Snapshot) -> float:
        """The value."""
        read: float = self._read(snapshot)
        value = abs(read) if self._magnitude else read
        if abs(self._factor) != 1.0:
            return value * self._factor
        return value if self._factor > 0.0 else -value

    def good_range(self, limit: float) -> tuple[float, float]:
        """Least and greatest field for which the value is surely not above ``limit``; beyond them it may be.

        A factor takes a little off the range, because the value is rounded. It is empty for a least magnitude.
        """
        if self._magnitude and self._factor < 0.0:
            return math.inf, -math.inf
        bound = limit if self._factor == 1.0 else limit / self._factor  # an int is compared with an int faster
        if abs(self._factor) != 1.0:
            bound -= math.copysign(abs(bound) * ROUNDING + sys.float_info.min, self._factor)  # below it, coarser
        if self._magnitude:
            return -bound, bound
        return (-math.inf, bound) if self._factor > 0.0 else (bound, math.inf)
