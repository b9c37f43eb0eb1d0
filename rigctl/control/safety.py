"""The safety table: what is watched, when, for how long, and what is done about it.

Evaluated every tick on values the tick already has; a row trips once its condition has held for its persistence. The
built-in rows cannot be configured away; the rig file's ``limits`` come after them, see `rigctl.control.limits`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from rigctl.config import RigSettings
from rigctl.control.modes import Mode


class Action(IntEnum):
    """What a row asks for, the weakest first. All but LOG latch a fault."""

    LOG = 0  # say so
    RAMP_DOWN = 1  # lower the tension on its ramp until the rope is slack, then hold
    HOLD = 2  # hold the stroke under power
    QUICK_STOP = 3  # the drive stops on its own ramp, then power off with the brake closed
    POWER_OFF = 4  # the same, and the brake closes in any case once the drive has had its time to stop


class Fault(IntEnum):
    """What can trip the rig; the number is latched in every record until an operator resets it."""

    NONE = 0
    TENSION_HIGH = 1
    TENSION_LOW = 2
    CELL_STALE = 3
    CELL_INVALID = 4
    INCLINATION_STALE = 5
    INCLINATION_INVALID = 6
    DRIVE_STALE = 7
    DRIVE_FAULT = 8
    BUS_SILENT = 9
    OVERRUN = 10
    LOOP_EXCEPTION = 11
    STROKE_END = 12
    DRIVE_NOT_FOLLOWING = 13
    DEVICE_RESTARTED = 14
    INNOVATION = 15  # tension or drive speed went on contradicting what the filter expects
    SIGN_DRIVE = 16  # a positive command does not move the stroke up
    SIGN_CELL = 17  # a shorter rope does not pull harder, or far from what the plant says
    LIMIT = 18  # a row of the rig file's limits; the trip's event names it
    CELL_STUCK = 19  # the cell goes on sending the very same value
    DRIVE_CONTRADICTS = 20  # the drive's speed is not what its position does
    STROKE_MOVES = 21  # the stroke moves though the drive is off: the brake does not hold
    STRETCH_UNEXPLAINED = 22  # tension changed as no stroke explains, or did not where the stroke says it must
    E_STOP = 23  # the emergency stop is seen pressed


class Check(IntFlag):
    """Preflight checks an arm command must pass."""

    CELL_STALE = 1
    CELL_INVALID = 2
    INCLINATION_STALE = 4
    INCLINATION_INVALID = 8
    DRIVE_STALE = 16
    DRIVE_FAULT = 32
    TENSION_HIGH = 64
    STROKE_RANGE = 128
    DRIVE_SUPERVISION = 256  # the drive's own stop was not verified (0x1016, 0x6007, 0x605E, deadline)
    CALIBRATION = 512  # the cell's calibration is missing or overdue, and not waived
    E_STOP = 1024  # the emergency stop is pressed


@dataclass(slots=True)
class Sight:
    """What one tick sees: values, ages in ns, quality bits (0 good), counters."""

    t_ns: int = 0
    tension_n: float = math.nan
    reading_n: float = math.nan  # the same before zero and scale
    cell_age_ns: int = 1 << 62
    cell_quality: int = 0
    inclination_age_ns: int = 1 << 62
    inclination_quality: int = 0
    tangential_rad: float = 0.0
    normal_rad: float = 0.0
    stroke_mm: float = math.nan
    speed_mm_s: float = 0.0
    drive_age_ns: int = 1 << 62
    drive_enabled: bool = False
    drive_off: bool = False  # no power, brake closed or closing
    drive_faulted: bool = False
    drive_warning: bool = False
    drive_temperature_c: float = math.nan
    drive_current_a: float = math.nan
    e_stop: bool = False
    bus_age_ns: int = 1 << 62
    error_frames: int = 0  # in the last second
    skipped_in_window: int = 0
    lateness_ns: int = 0
    command_age_ns: int = 0  # since an operator gave the last one
    stroke_limited: bool = False
    drive_wanted: bool = False
    rope_lost: bool = False
    device_restarted: bool = False
    drive_reversed: bool = False  # see rigctl.control.signs
    cell_reversed: bool = False
    rejects: int = 0
    slope_rejects: int = 0
    cell_nis: float = 0.0
    calibration_overdue: bool = False
    vertical_error_n: float = 0.0  # from the set-point on its ramp, while there is one
    disturbance_mm_s: float = 0.0
    speed_error_mm_s: float = 0.0  # these six: see rigctl.control.plausibility
    stroke_error_mm: float = 0.0
    contradiction_mm: float = 0.0
    unexplained_mm: float = 0.0
    cell_repeats: int = 0
    tension_rate_n_s: float = 0.0


@dataclass(frozen=True)
class Row:
    """One line of the table: tripped when ``value(sight) > limit`` for ``persistence_ns``, in ``modes``.

    ``text``: for a row of the rig file, what is beyond its limit. ``sign``: -1 where the row watches a lower limit, so
    that found value and limit are shown as they are.
    """

    fault: Fault
    value: Callable[[Sight], float]
    limit: float
    persistence_ns: int
    modes: frozenset[Mode]
    unit: str
    action: Action = Action.HOLD
    text: str = ""
    sign: float = 1.0


_ARMED = frozenset({Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING, Mode.FAULT})
_ON = _ARMED - {Mode.FAULT}
_CLOSED = frozenset({Mode.TENSIONING, Mode.COMPENSATING})
_TENSIONING = frozenset({Mode.TENSIONING})
_MOVING = _CLOSED | {Mode.RELEASING}
_REGULATED = frozenset({Mode.COMPENSATING})
_OFF = frozenset({Mode.DISARMED})
_EVERY = frozenset(Mode)
_MS = 1_000_000
STROKE_END_NS = 200 * _MS
DRIVE_GRACE_NS = 20 * _MS  # the drive's answer to enable or disable may take this long
STROKE_SPARE_MM = 2.0
SPEED_ERROR_MM_S, SPEED_ERROR_NS = 2.5, 15 * _MS  # a lag half as long again as the plant's makes 1.5 mm/s of 10
STROKE_ERROR_MM = 0.5
CONTRADICTION_MM = 0.3
SLOPE_REJECTS = 10  # 100 ms of an inclinometer at 100 Hz; until then the filter goes on by itself
UNEXPLAINED_MM = 8.0  # the paper's move makes 0.1, a payload that rises at 6 mm/s makes 6 ...
UNEXPLAINED_NS = 15 * _MS  # ... and a single bad sample makes anything
BRAKE_SLIP_MM_S, BRAKE_SLIP_NS = 0.5, 200 * _MS  # a stop that has begun takes less


def _highest_n(sight: Sight) -> float:
    """A correction of the cell can bring this trip forward, never put it off."""
    return max(sight.tension_n, sight.reading_n)


def table(settings: RigSettings) -> tuple[Row, ...]:
    """The built-in rows, in the order in which the first to trip names the fault."""
    s = settings.safety
    stale, slope = s.stale_ms * _MS, s.inclination_stale_ms * _MS
    persist = s.persistence_ms * _MS
    stuck = s.stuck_samples - 1 if s.stuck_samples else math.inf
    lost = Action.POWER_OFF  # a drive that does not obey is not told to hold, but taken off power
    return (
        Row(Fault.E_STOP, lambda x: x.e_stop, 0, 0, _EVERY, "", Action.QUICK_STOP),
        Row(Fault.BUS_SILENT, lambda x: x.bus_age_ns, s.bus_silent_ms * _MS, 0, _ARMED, "ns"),
        Row(Fault.DRIVE_STALE, lambda x: x.drive_age_ns, stale, 0, _ARMED, "ns"),
        Row(Fault.CELL_STALE, lambda x: x.cell_age_ns, stale, 0, _ARMED, "ns"),
        Row(Fault.INCLINATION_STALE, lambda x: x.inclination_age_ns, slope, 0, _ARMED, "ns"),
        Row(Fault.DRIVE_FAULT, lambda x: x.drive_faulted, 0, 0, _ARMED, ""),
        Row(Fault.DRIVE_NOT_FOLLOWING, _dropped_out, 0, DRIVE_GRACE_NS, _ON, ""),
        Row(Fault.SIGN_DRIVE, lambda x: x.drive_reversed, 0, 0, _TENSIONING, ""),
        Row(Fault.SIGN_CELL, lambda x: x.cell_reversed, 0, 0, _TENSIONING, ""),
        Row(Fault.CELL_INVALID, lambda x: x.cell_quality, 0, 0, _ARMED, ""),
        Row(Fault.INCLINATION_INVALID, lambda x: x.inclination_quality, 0, 0, _ARMED, ""),
        Row(Fault.TENSION_HIGH, _highest_n, s.tension_high_n, persist, _EVERY, "N"),
        Row(Fault.TENSION_LOW, lambda x: -x.tension_n, -s.tension_low_n, persist, _REGULATED, "N", sign=-1.0),
        Row(Fault.TENSION_LOW, lambda x: x.rope_lost, 0, persist, _TENSIONING, ""),
        Row(Fault.CELL_STUCK, lambda x: x.cell_repeats, stuck, 0, _ARMED, "samples"),
        Row(Fault.DRIVE_NOT_FOLLOWING, lambda x: x.speed_error_mm_s, SPEED_ERROR_MM_S, SPEED_ERROR_NS, _ARMED, "mm/s",
            lost),
        Row(Fault.DRIVE_NOT_FOLLOWING, lambda x: abs(x.stroke_error_mm), STROKE_ERROR_MM, 0, _ARMED, "mm", lost),
        Row(Fault.DRIVE_CONTRADICTS, lambda x: abs(x.contradiction_mm), CONTRADICTION_MM, 0, _ARMED, "mm"),
        Row(Fault.STROKE_MOVES, _unbraked_mm_s, BRAKE_SLIP_MM_S, BRAKE_SLIP_NS, _OFF, "mm/s"),
        Row(Fault.INNOVATION, lambda x: x.rejects, settings.estimator.reject_limit - 1, 0, _MOVING, "samples"),
        Row(Fault.INNOVATION, lambda x: x.slope_rejects, SLOPE_REJECTS - 1, 0, _MOVING, "slopes"),
        Row(Fault.STRETCH_UNEXPLAINED, lambda x: abs(x.unexplained_mm), UNEXPLAINED_MM, UNEXPLAINED_NS, _ON, "mm"),
        Row(Fault.STROKE_END, lambda x: x.stroke_limited, 0, STROKE_END_NS, _MOVING, ""),
        Row(Fault.DEVICE_RESTARTED, lambda x: x.device_restarted, 0, 0, _ARMED, ""),
        Row(Fault.OVERRUN, lambda x: x.skipped_in_window, s.overrun_ticks - 1, 0, _ARMED, "ticks"),
    )  # fmt: skip


def _unbraked_mm_s(sight: Sight) -> float:
    return abs(sight.speed_mm_s) if sight.drive_off else 0.0


def _dropped_out(sight: Sight) -> float:
    return sight.drive_wanted and not sight.drive_enabled


@dataclass(frozen=True)
class Trip:
    """What tripped, with the value found, the limit allowed, and what is to be done."""

    fault: Fault
    value: float
    limit: float
    action: Action = Action.HOLD
    text: str = ""


class Watch:
    """The table with its clocks: since when each row has been bad."""

    def __init__(self, settings: RigSettings, limits: Sequence[Row] = ()) -> None:
        """``limits``: the rig file's rows."""
        self._rows = (*table(settings), *limits)
        self._since: list[int | None] = [None] * len(self._rows)
        self._logged = [False] * len(self._rows)
        self.crossed: list[tuple[Trip, bool]] = []  # LOG rows since last taken: True begins, False is over

    def trips(self, sight: Sight, mode: Mode, t_ns: int) -> Trip | None:
        """The strongest of the rows that have been bad for their persistence, among equals the first; or None."""
        strongest: Trip | None = None
        since = self._since
        for i, row in enumerate(self._rows):
            if mode not in row.modes or not (value := row.value(sight)) > row.limit:
                since[i] = None
                if self._logged[i]:
                    self._log(i, row.limit, begins=False)
                continue
            start = since[i]
            if start is None:
                start = since[i] = t_ns
            if t_ns - start < row.persistence_ns:
                continue
            if row.action is Action.LOG:
                if not self._logged[i]:
                    self._log(i, value, begins=True)
            elif strongest is None or row.action > strongest.action:
                strongest = _trip(row, value)
        return strongest

    def present(self, sight: Sight) -> Fault:
        """First cause that is there at this instant, whatever the mode; what keeps a fault from being reset.

        A fault of the drive itself is not one: the reset is what clears it. Nor is what only a mode can show.
        """
        for row in self._rows:
            if row.fault in _BLOCK_RESET and row.value(sight) > row.limit:
                return row.fault
        return Fault.NONE

    def _log(self, i: int, value: float, *, begins: bool) -> None:
        self._logged[i] = begins
        self.crossed.append((_trip(self._rows[i], value), begins))


def _trip(row: Row, value: float) -> Trip:
    return Trip(row.fault, row.sign * float(value), row.sign * float(row.limit), row.action, row.text)


_BLOCK_RESET = frozenset(
    {Fault.BUS_SILENT, Fault.DRIVE_STALE, Fault.CELL_STALE, Fault.CELL_INVALID, Fault.INCLINATION_STALE,
     Fault.INCLINATION_INVALID, Fault.TENSION_HIGH, Fault.OVERRUN, Fault.DEVICE_RESTARTED, Fault.CELL_STUCK,
     Fault.E_STOP}
)  # fmt: skip


def preflight(sight: Sight, settings: RigSettings, *, supervision_verified: bool) -> Check:
    """Checks that fail now; arming needs none to."""
    s = settings.safety
    cylinder = settings.cylinder
    low, high = cylinder.stroke_min_mm - STROKE_SPARE_MM, cylinder.stroke_max_mm + STROKE_SPARE_MM
    failing = {
        Check.CELL_STALE: sight.cell_age_ns > s.stale_ms * _MS,
        Check.CELL_INVALID: sight.cell_quality != 0,
        Check.INCLINATION_STALE: sight.inclination_age_ns > s.inclination_stale_ms * _MS,
        Check.INCLINATION_INVALID: sight.inclination_quality != 0,
        Check.DRIVE_STALE: sight.drive_age_ns > s.stale_ms * _MS,
        Check.DRIVE_FAULT: sight.drive_faulted,
        Check.TENSION_HIGH: not _highest_n(sight) <= s.tension_high_n,
        Check.STROKE_RANGE: not low <= sight.stroke_mm <= high,
        Check.DRIVE_SUPERVISION: not supervision_verified,
        Check.CALIBRATION: sight.calibration_overdue,
        Check.E_STOP: sight.e_stop,
    }
    result = Check(0)
    for check, fails in failing.items():
        if fails:
            result |= check
    return result
