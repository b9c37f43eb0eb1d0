"""The rig file's limits as rows of the safety table."""

from __future__ import annotations

import math
from collections.abc import Callable

from rigctl.config.limits_section import LimitSettings
from rigctl.config.settings import RigSettings
from rigctl.control.snapshot import FieldValue, Snapshot
from rigctl.control.watch.safety import ARMED, UNHEARD_NS, Row, status_stale_ns
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.signals import INCLINOMETER, STATUS, WATCHED, Reading
from rigctl.model.states import Mode

RATE_S = 0.02  # low-pass of a signal before its rate is taken
_GAP_NS = 100_000_000


def value_of(watch: Reading, sign: float = 1.0) -> FieldValue:
    """Reads a signal off a snapshot, times ``sign``."""
    return FieldValue(watch.snapshot, sign * watch.factor, magnitude=watch.magnitude)


class SignalRate:
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
    """A row per bound of each limit, in the rig file's order; then what is only logged or may be missing."""
    found = [row for limit in (*settings.limits, *_of_margins(settings)) for row in _rows_of(limit)]
    unseen = {(row.text, row.action, row.modes): row for limit in settings.limits for row in _unseen(limit, settings)}
    return (*found, *unseen.values(), _silent_bus(settings))


def _silent_bus(settings: RigSettings) -> Row:
    """While DISARMED a silent bus is no fault but put on record; a loop that has just started has no frame yet."""
    limit_ns = settings.safety.bus_silent_ms * 1_000_000
    return Row(
        Fault.BUS_SILENT, FieldValue("bus_age_ns"), limit_ns, UNHEARD_NS, frozenset({Mode.DISARMED}), "ns", Action.LOG
    )


def _of_margins(settings: RigSettings) -> list[LimitSettings]:
    """The limit of the ``margins`` section."""
    section = settings.margins
    if section is None:
        return []
    high, action = section.ms_max or settings.design.ms_max, section.action
    return [LimitSettings(signal="sensitivity_peak", high=high, action=action, modes=["COMPENSATING"])]


def _unseen(limit: LimitSettings, settings: RigSettings) -> list[Row]:
    """Rows that trip if the limit's signal is missing, because the limit itself could then never trip.

    In the armed modes the built-in rows watch cell, inclinometer and drive, and trip sooner.
    """
    watch = WATCHED[limit.signal]
    if not watch.age:
        return []
    age = FieldValue(watch.age)
    s, modes = settings.safety, frozenset(Mode[name] for name in limit.modes)
    oldest_ns = {INCLINOMETER: s.inclination_stale_ms * 1_000_000, STATUS: status_stale_ns(settings)}
    stale_ns = oldest_ns.get(watch.age, s.stale_ms * 1_000_000)
    # The action is HOLD, as for any loss, and not the limit's own action.
    text = f"{watch.words} ({watch.name})"
    watched = (
        (modes & ARMED if watch.age == STATUS else frozenset(), 0),
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
    watch = WATCHED[limit.signal]
    persistence_ns = limit.persistence_ms * 1_000_000
    modes = frozenset(Mode[name] for name in limit.modes)
    action = Action[limit.action.upper()]

    def row(read: Callable[[Snapshot], float], bound: float, words: str, sign: float = 1.0) -> Row:
        text = f"{limit.signal} {words}"
        return Row(Fault.LIMIT, read, sign * bound, persistence_ns, modes, watch.unit, action, text, sign)

    found = []
    if limit.high is not None:
        found.append(row(value_of(watch), limit.high, "above"))
    if limit.low is not None:
        found.append(row(value_of(watch, -1.0), limit.low, "below", -1.0))
    if limit.rate is not None:
        found.append(row(SignalRate(value_of(watch)), limit.rate, "changing by more per second than"))
    return found
