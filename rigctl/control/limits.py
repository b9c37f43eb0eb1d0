"""The rig file's limits as rows of the safety table."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter

from rigctl.config.limits_section import SIGNALS, LimitSettings
from rigctl.config.settings import RigSettings
from rigctl.control.faults import Fault
from rigctl.control.modes import Mode
from rigctl.control.safety import ARMED, Action, Row, status_stale_ns
from rigctl.control.snapshot import Snapshot

RATE_S = 0.02  # low-pass of a signal before its rate is taken
_GAP_NS = 100_000_000

VALUES: dict[str, Callable[[Snapshot], float]] = {
    "tension_n": lambda x: x.tension_n,
    "tension_rate_n_s": lambda x: abs(x.tension_rate_n_s),
    "vertical_error_n": lambda x: abs(x.vertical_error_n),
    "tangential_deg": lambda x: math.degrees(x.tangential_rad),
    "normal_deg": lambda x: math.degrees(x.normal_rad),
    "stroke_mm": lambda x: x.stroke_mm,
    "travel_mm": lambda x: abs(x.travel_mm),
    "speed_mm_s": lambda x: x.speed_mm_s,
    "disturbance_mm_s": lambda x: abs(x.disturbance_mm_s),
    "drive_temperature_c": lambda x: x.drive_temperature_c,
    "drive_current_a": lambda x: abs(x.drive_current_a),
    "drive_warning": lambda x: float(x.drive_warning),
    "cell_age_ms": lambda x: x.cell_age_ns * 1e-6,
    "inclination_age_ms": lambda x: x.inclination_age_ns * 1e-6,
    "drive_age_ms": lambda x: x.drive_age_ns * 1e-6,
    "rejects": lambda x: float(x.rejects),
    "cell_nis": lambda x: x.cell_nis,
    "lateness_us": lambda x: x.lateness_ns * 1e-3,
    "skipped_ticks": lambda x: float(x.skipped_in_window),
    "error_frames": lambda x: float(x.error_frames),
    "command_age_s": lambda x: x.command_age_ns * 1e-9,
}
"""Value in the snapshot of each signal of `rigctl.config.limits_section.SIGNALS`."""

Age = Callable[[Snapshot], float]
_CELL: Age = attrgetter("cell_age_ns")
_SLOPE: Age = attrgetter("inclination_age_ns")
_DRIVE: Age = attrgetter("drive_age_ns")
_STATUS: Age = attrgetter("status_age_ns")
MEASURED: dict[str, tuple[str, Age]] = {
    "tension_n": ("tension", _CELL),
    "tension_rate_n_s": ("tension rate", _CELL),
    "vertical_error_n": ("vertical error", _CELL),
    "disturbance_mm_s": ("disturbance speed", _CELL),
    "tangential_deg": ("tangential inclination", _SLOPE),
    "normal_deg": ("normal inclination", _SLOPE),
    "stroke_mm": ("stroke", _DRIVE),
    "travel_mm": ("travel", _DRIVE),
    "speed_mm_s": ("cylinder speed", _DRIVE),
    "drive_warning": ("drive warning", _DRIVE),
    "drive_temperature_c": ("drive temperature", _STATUS),
    "drive_current_a": ("motor current", _STATUS),
}
"""Signals sent by a device: words and the age of the newest sample."""


class Rate:
    """Rate of change of a signal, per second, absolute; it starts again after a pause."""

    def __init__(self, value: Callable[[Snapshot], float]) -> None:
        self._value = value
        self._smooth = math.nan
        self._t_ns = 0

    def __call__(self, snapshot: Snapshot) -> float:
        """The rate now; call it every tick."""
        value, passed_ns = self._value(snapshot), snapshot.t_ns - self._t_ns
        self._t_ns = snapshot.t_ns
        if not math.isfinite(value):
            return math.nan
        if not math.isfinite(self._smooth) or not 0 <= passed_ns <= _GAP_NS:
            self._smooth = value
        rate = abs(value - self._smooth) / RATE_S
        self._smooth += (value - self._smooth) * (1.0 - math.exp(-passed_ns * 1e-9 / RATE_S))
        return rate


def rows(settings: RigSettings) -> tuple[Row, ...]:
    """A row per bound of each limit, in the rig file's order; then a row for each signal that may be missing."""
    found = [row for limit in settings.limits for row in _rows_of(limit)]
    unseen = {(row.text, row.action, row.modes): row for limit in settings.limits for row in _unseen(limit, settings)}
    return (*found, *unseen.values())


def _unseen(limit: LimitSettings, settings: RigSettings) -> list[Row]:
    """Rows that trip if the limit's signal is missing, because the limit itself could then never trip.

    In the armed modes the built-in rows watch cell, inclinometer and drive, and trip sooner.
    """
    if limit.signal not in MEASURED:
        return []
    words, age = MEASURED[limit.signal]
    s, modes = settings.safety, frozenset(Mode[name] for name in limit.modes)
    oldest_ns = {_SLOPE: s.inclination_stale_ms * 1_000_000, _STATUS: status_stale_ns(settings)}
    stale_ns = oldest_ns.get(age, s.stale_ms * 1_000_000)
    # The action is HOLD, as for any loss, and not the limit's own action.
    text = f"{words} ({limit.signal})"
    watched = (
        (modes & ARMED if age is _STATUS else frozenset(), 0),
        (modes - ARMED, stale_ns),  # a loop that has just started has no samples yet
    )
    if limit.action == "log":  # a logged limit reports its begin and its end
        old = f"age in ms of {text} above"
        return [
            Row(Fault.LIMIT, lambda x: age(x) / 1e6, stale_ns / 1e6, ns, where, "ms", Action.LOG, old)
            for where, ns in watched
            if where
        ]
    return [Row(Fault.LIMIT_UNSEEN, age, stale_ns, ns, where, "ns", text=text) for where, ns in watched if where]


def _rows_of(limit: LimitSettings) -> list[Row]:
    value, unit = VALUES[limit.signal], SIGNALS[limit.signal].unit
    persistence_ns = limit.persistence_ms * 1_000_000
    modes = frozenset(Mode[name] for name in limit.modes)
    action = Action[limit.action.upper()]

    def row(read: Callable[[Snapshot], float], bound: float, words: str, sign: float = 1.0) -> Row:
        text = f"{limit.signal} {words}"
        return Row(Fault.LIMIT, read, sign * bound, persistence_ns, modes, unit, action, text, sign)

    found = []
    if limit.high is not None:
        found.append(row(value, limit.high, "above"))
    if limit.low is not None:
        found.append(row(lambda x: -value(x), limit.low, "below", -1.0))
    if limit.rate is not None:
        found.append(row(Rate(value), limit.rate, "changing by more per second than"))
    return found
