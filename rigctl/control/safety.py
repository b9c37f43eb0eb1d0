"""The safety table: what is watched, when, for how long. Every reaction is hold, latched.

Evaluated every tick on values the tick already has; a row trips once its condition has held for its persistence.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from rigctl.config import RigSettings
from rigctl.control.modes import Mode


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


@dataclass(slots=True)
class Sight:
    """What one tick sees: values, ages in ns, quality bits (0 good), counters."""

    tension_n: float = math.nan
    reading_n: float = math.nan  # the same before zero and scale
    cell_age_ns: int = 1 << 62
    cell_quality: int = 0
    inclination_age_ns: int = 1 << 62
    inclination_quality: int = 0
    stroke_mm: float = math.nan
    drive_age_ns: int = 1 << 62
    drive_enabled: bool = False
    drive_faulted: bool = False
    bus_age_ns: int = 1 << 62
    skipped_in_window: int = 0
    stroke_limited: bool = False
    drive_wanted: bool = False
    speed_error_mm_s: float = 0.0
    rope_lost: bool = False
    device_restarted: bool = False
    drive_reversed: bool = False  # see rigctl.control.signs
    cell_reversed: bool = False
    rejects: int = 0
    calibration_overdue: bool = False


@dataclass(frozen=True)
class Row:
    """One line of the table: tripped when ``value(sight) > limit`` for ``persistence_ns``, in ``modes``."""

    fault: Fault
    value: Callable[[Sight], float]
    limit: float
    persistence_ns: int
    modes: frozenset[Mode]
    unit: str


_ARMED = frozenset({Mode.HOLD, Mode.TENSIONING, Mode.COMPENSATING, Mode.RELEASING, Mode.FAULT})
_CLOSED = frozenset({Mode.TENSIONING, Mode.COMPENSATING})
_TENSIONING = frozenset({Mode.TENSIONING})
_MOVING = _CLOSED | {Mode.RELEASING}
_REGULATED = frozenset({Mode.COMPENSATING})
_EVERY = frozenset(Mode)
_MS = 1_000_000
STROKE_END_NS = 200 * _MS
DRIVE_GRACE_NS = 20 * _MS  # the drive's answer to enable or disable may take this long
STROKE_SPARE_MM = 2.0
SPEED_ERROR_MM_S = 2.0  # drive against command; the lag passes it, but not for as long as this:
SPEED_ERROR_NS = 100 * _MS


def _highest_n(sight: Sight) -> float:
    """A correction of the cell can bring this trip forward, never put it off."""
    return max(sight.tension_n, sight.reading_n)


def table(settings: RigSettings) -> tuple[Row, ...]:
    """The rows, in the order in which the first to trip names the fault."""
    s = settings.safety
    stale, slope = s.stale_ms * _MS, s.inclination_stale_ms * _MS
    persist = s.persistence_ms * _MS
    return (
        Row(Fault.BUS_SILENT, lambda x: x.bus_age_ns, s.bus_silent_ms * _MS, 0, _ARMED, "ns"),
        Row(Fault.DRIVE_STALE, lambda x: x.drive_age_ns, stale, 0, _ARMED, "ns"),
        Row(Fault.CELL_STALE, lambda x: x.cell_age_ns, stale, 0, _ARMED, "ns"),
        Row(Fault.INCLINATION_STALE, lambda x: x.inclination_age_ns, slope, 0, _ARMED, "ns"),
        Row(Fault.DRIVE_FAULT, lambda x: x.drive_faulted, 0, 0, _ARMED, ""),
        Row(
            Fault.DRIVE_NOT_FOLLOWING,
            lambda x: x.drive_wanted and not x.drive_enabled,
            0,
            DRIVE_GRACE_NS,
            _ARMED - {Mode.FAULT},
            "",
        ),
        Row(Fault.SIGN_DRIVE, lambda x: x.drive_reversed, 0, 0, _TENSIONING, ""),
        Row(Fault.SIGN_CELL, lambda x: x.cell_reversed, 0, 0, _TENSIONING, ""),
        Row(Fault.CELL_INVALID, lambda x: x.cell_quality, 0, 0, _ARMED, ""),
        Row(Fault.INCLINATION_INVALID, lambda x: x.inclination_quality, 0, 0, _ARMED, ""),
        Row(Fault.TENSION_HIGH, _highest_n, s.tension_high_n, persist, _EVERY, "N"),
        Row(Fault.TENSION_LOW, lambda x: -x.tension_n, -s.tension_low_n, persist, _REGULATED, "N"),
        Row(Fault.TENSION_LOW, lambda x: x.rope_lost, 0, persist, frozenset({Mode.TENSIONING}), ""),
        Row(Fault.INNOVATION, lambda x: x.rejects, settings.estimator.reject_limit - 1, 0, _MOVING, "samples"),
        Row(Fault.STROKE_END, lambda x: x.stroke_limited, 0, STROKE_END_NS, _MOVING, ""),
        Row(Fault.DEVICE_RESTARTED, lambda x: x.device_restarted, 0, 0, _ARMED, ""),
        Row(
            Fault.DRIVE_NOT_FOLLOWING,
            lambda x: x.speed_error_mm_s,
            SPEED_ERROR_MM_S,
            SPEED_ERROR_NS,
            _ARMED - {Mode.FAULT},
            "mm/s",
        ),
        Row(Fault.OVERRUN, lambda x: x.skipped_in_window, s.overrun_ticks - 1, 0, _ARMED, "ticks"),
    )


@dataclass(frozen=True)
class Trip:
    """What tripped, with the value found and the limit allowed."""

    fault: Fault
    value: float
    limit: float


class Watch:
    """The table with its clocks: since when each row has been bad."""

    def __init__(self, settings: RigSettings) -> None:
        self._rows = table(settings)
        self._since: list[int | None] = [None] * len(self._rows)

    def trips(self, sight: Sight, mode: Mode, t_ns: int) -> Trip | None:
        """First row that has been bad for its persistence, or None."""
        first: Trip | None = None
        since = self._since
        for i, row in enumerate(self._rows):
            if mode not in row.modes or not (value := row.value(sight)) > row.limit:
                since[i] = None
                continue
            start = since[i]
            if start is None:
                start = since[i] = t_ns
            if first is None and t_ns - start >= row.persistence_ns:
                first = Trip(row.fault, float(value), float(row.limit))
        return first

    def present(self, sight: Sight) -> Fault:
        """First cause that is there at this instant, whatever the mode; what keeps a fault from being reset.

        A fault of the drive itself is not one: the reset is what clears it. Nor is what only a mode can show.
        """
        for row in self._rows:
            if row.fault in _BLOCK_RESET and row.value(sight) > row.limit:
                return row.fault
        return Fault.NONE


_BLOCK_RESET = frozenset(
    {Fault.BUS_SILENT, Fault.DRIVE_STALE, Fault.CELL_STALE, Fault.CELL_INVALID, Fault.INCLINATION_STALE,
     Fault.INCLINATION_INVALID, Fault.TENSION_HIGH, Fault.OVERRUN, Fault.DEVICE_RESTARTED}
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
    }
    result = Check(0)
    for check, fails in failing.items():
        if fails:
            result |= check
    return result
