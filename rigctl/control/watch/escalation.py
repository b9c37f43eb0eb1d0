"""Escalation of a reaction that has not helped, as a table: ramp down, hold, quick stop, power off, silence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rigctl.config.settings import RigSettings
from rigctl.control.load.stroke_hold import AUTHORITY_MM_S
from rigctl.control.power.machine import SUPERVISED_NS
from rigctl.control.snapshot import Snapshot
from rigctl.control.watch.safety import BRAKE_SLIP_MM_S, Trip
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action, Symptom

_MS = 1_000_000
RISE_MM = 0.5  # of stretch: a held stroke adds none
FAST_MM_S = 2.0 * AUTHORITY_MM_S  # no correction of HOLD is as fast
MOVED_MM = 0.2
STOP_TAIL_LAGS = 5.0  # of the drive, beyond its ramp: 10 mm/s decay to below 0.1 mm/s
BRAKE_NS = 200 * _MS  # for the brake to close; servo holding brakes take 20 to 60 ms
OFF_NS = 1_000 * _MS  # for a drive at standstill to close its brake and go off
ANSWER_NS = 30 * _MS  # for a drive to show by its state that it has taken a command; most need 5 ms
BLIND_MM = 0.2  # with two answers and the stop itself, a drive that is not heard moves less than 1 mm
RAMP_SPARE_S = 5.0
UNSEEN_S = 0.1  # an unseen stroke may creep; a burst of lost frames is over sooner


@dataclass
class Since:
    """Time and tension at the start of the reaction; stroke and tension where it should have come to rest.

    ``commanded_ns``: when the drive was first commanded to stop by itself, for a weaker reaction as ``t_ns``.
    """

    t_ns: int = 0
    commanded_ns: int = 0
    tension_n: float = 0.0
    stroke_mm: float | None = None
    rest_n: float = 0.0


class Bounds:
    """Limits of the table that follow from the rig file; ``stop_ns``: time in which a drive that obeys stops."""

    def __init__(self, settings: RigSettings, stop_ns: int) -> None:
        plant = settings.plant
        self.rise_n = RISE_MM * plant.stiffness_n_mm
        self.high_n = settings.safety.tension_high_n
        self.ramp_n_s = settings.tension.ramp_n_s
        self.stale_ns = settings.safety.stale_ms * _MS
        self.rest_ns = stop_ns + round(STOP_TAIL_LAGS * plant.cylinder_lag_s * 1e9)


@dataclass(frozen=True)
class Step:
    """``value`` above ``limit`` for ``persistence_ns``, later than ``wait_ns``, leads to ``after``.

    ``wait_ns`` counts from when a drive that obeys stands still; for a ramp down from its start; where ``at_once``,
    from the first command to stop. ``after`` is None where nothing stronger would help. ``shows`` and ``why`` are for
    docs/modes.md.
    """

    symptom: Symptom
    action: Action
    value: Callable[[Snapshot, Since, Bounds], float]
    limit: float | None  # None: Bounds.rise_n
    wait_ns: int
    persistence_ns: int
    after: Action | None
    shows: str
    why: str
    at_once: bool = False

    def bound(self, bounds: Bounds) -> float:
        """The limit on this rig."""
        return bounds.rise_n if self.limit is None else self.limit

    def waits_ns(self, bounds: Bounds) -> int:
        """The wait in ns from the start of the reaction."""
        return self.wait_ns + (0 if self.at_once or self.action is Action.RAMP_DOWN else bounds.rest_ns)


def _rise_n(snapshot: Snapshot, since: Since, _bounds: Bounds) -> float:
    return snapshot.tension_n - since.tension_n


def _rise_beyond_n(snapshot: Snapshot, since: Since, bounds: Bounds) -> float:
    return snapshot.tension_n - since.tension_n if snapshot.tension_n > bounds.high_n else 0.0


def _late_s(snapshot: Snapshot, since: Since, bounds: Bounds) -> float:
    return (snapshot.t_ns - since.t_ns) * 1e-9 - 2.0 * max(0.0, since.tension_n) / bounds.ramp_n_s


def _speed_mm_s(snapshot: Snapshot, _since: Since, _bounds: Bounds) -> float:
    return abs(snapshot.speed_mm_s) if snapshot.drive_heard else 0.0


def _unseen_s(snapshot: Snapshot, _since: Since, bounds: Bounds) -> float:
    return max(0, snapshot.drive_age_ns - bounds.stale_ns) * 1e-9 if snapshot.drive_may_be_on else 0.0


def _unseen_mm(snapshot: Snapshot, _since: Since, _bounds: Bounds) -> float:
    return 0.0 if snapshot.drive_heard else snapshot.unseen_mm


def _unanswered(snapshot: Snapshot, _since: Since, _bounds: Bounds) -> float:
    return snapshot.drive_may_be_on and not snapshot.drive_stops


def _changed_n(snapshot: Snapshot, since: Since, _bounds: Bounds) -> float:
    return abs(snapshot.tension_n - since.rest_n)


def _drift_mm(snapshot: Snapshot, since: Since, _bounds: Bounds) -> float:
    return abs(snapshot.stroke_mm - since.stroke_mm) if since.stroke_mm is not None else 0.0


def _stays_on(snapshot: Snapshot, _since: Since, _bounds: Bounds) -> float:
    return snapshot.drive_may_be_on


_FROM_REST = (_drift_mm, _changed_n)
"""Values that begin where the stroke should have come to rest."""

STEPS = (
    Step(Symptom.RAMP_RISES, Action.RAMP_DOWN, _rise_n, None, 500 * _MS, 100 * _MS, Action.HOLD,
         f"tension risen by {RISE_MM:g} mm of stretch", "the law winds up, or something pulls"),
    Step(Symptom.RAMP_LATE, Action.RAMP_DOWN, _late_s, RAMP_SPARE_S, 0, 0, Action.HOLD,
         f"rope not slack {RAMP_SPARE_S:g} s after twice the ramp's time", "the ramp does not do what it should"),
    Step(Symptom.HOLD_RISES, Action.HOLD, _rise_beyond_n, None, 0, 50 * _MS, Action.QUICK_STOP,
         f"tension above its limit, and risen by {RISE_MM:g} mm of stretch", "a stroke that is held adds none"),
    Step(Symptom.HOLD_MOVES, Action.HOLD, _speed_mm_s, FAST_MM_S, 0, 500 * _MS, Action.QUICK_STOP,
         f"stroke faster than {FAST_MM_S:g} mm/s", "no correction of HOLD is as fast"),
    Step(Symptom.STOP_MOVES, Action.QUICK_STOP, _speed_mm_s, BRAKE_SLIP_MM_S, 0, 20 * _MS, Action.POWER_OFF,
         f"stroke faster than {BRAKE_SLIP_MM_S:g} mm/s", "the drive does not stop by itself"),
    Step(Symptom.STOP_DRIFTS, Action.QUICK_STOP, _drift_mm, MOVED_MM, 0, 0, Action.POWER_OFF,
         f"stroke {MOVED_MM:g} mm from where it should have stopped", "the same, too slow for its speed to tell"),
    Step(Symptom.STOP_STAYS_ON, Action.QUICK_STOP, _stays_on, 0.0, OFF_NS, 0, Action.POWER_OFF,
         f"drive not off {OFF_NS * 1e-9:g} s later", "it has not closed its brake by itself"),
    Step(Symptom.OFF_DRIFTS, Action.POWER_OFF, _drift_mm, MOVED_MM, BRAKE_NS, 0, None,
         f"stroke {MOVED_MM:g} mm from where it was when the brake had closed",
         "the drive is off and the brake does not hold: silence would stop nothing"),
    Step(Symptom.HOLD_UNSEEN, Action.HOLD, _unseen_s, UNSEEN_S, 0, 0, Action.QUICK_STOP,
         f"nothing heard of the drive for {UNSEEN_S:g} s", "a stroke that is not seen is not held"),
    Step(Symptom.HOLD_BLIND, Action.HOLD, _unseen_mm, BLIND_MM, 0, 0, Action.QUICK_STOP,
         f"nothing heard of the drive, which may have moved {BLIND_MM:g} mm since", "the same, in motion",
         at_once=True),
    Step(Symptom.STOP_UNANSWERED, Action.QUICK_STOP, _unanswered, 0.0, ANSWER_NS, 0, Action.SILENCE,
         f"no state of the drive that shows a stop, {ANSWER_NS // _MS} ms later", "it does not take commands",
         at_once=True),
    Step(Symptom.OFF_UNANSWERED, Action.POWER_OFF, _unanswered, 0.0, ANSWER_NS, 0, Action.SILENCE,
         f"no state of the drive that shows a stop, {ANSWER_NS // _MS} ms later", "it does not take commands",
         at_once=True),
    Step(Symptom.OFF_STAYS_ON, Action.POWER_OFF, _stays_on, 0.0, ANSWER_NS, 0, Action.SILENCE,
         f"drive not off {ANSWER_NS // _MS} ms after its power was cut", "it does not take commands"),
    Step(Symptom.SILENCE_MOVES, Action.SILENCE, _changed_n, None, SUPERVISED_NS, 500 * _MS, None,
         f"tension changed by {RISE_MM:g} mm of stretch", "the drive does not stop by itself, or the payload moves"),
)  # fmt: skip
"""For each action: the symptoms that it did not help, and the next action."""


@dataclass(frozen=True)
class Escalation:
    """A reaction that did not help: its fault, the symptom, and the next action (None: there is none)."""

    fault: Fault
    symptom: Symptom
    value: float
    limit: float
    after: Action | None

    @property
    def trip(self) -> Trip | None:
        """The trip for the machine, None without a next action."""
        return None if self.after is None else Trip(self.fault, self.value, self.limit, self.after)


class Escalator:
    """The table with its timers, which restart with every latched fault and every stronger action."""

    def __init__(self, settings: RigSettings, stop_ns: int) -> None:
        """``stop_ns``: see `Bounds`."""
        self._bounds = Bounds(settings, stop_ns)
        self._steps = {action: [step for step in STEPS if step.action is action] for action in Action}
        self._latched: tuple[Fault, Action] | None = None
        self._since = Since()
        self._bad_ns: dict[Symptom, int] = {}
        self._said: set[Symptom] = set()

    def look(self, fault: Fault, action: Action, snapshot: Snapshot, t_ns: int) -> Escalation | None:
        """One tick with ``fault`` latched and ``action`` taken; returns each symptom once."""
        if fault is Fault.NONE:
            self._latched = None
            return None
        since, bounds = self._since, self._bounds
        if self._latched != (fault, action):
            stops = self._latched is not None and self._latched[1] >= Action.QUICK_STOP
            self._latched = fault, action
            self._since = since = Since(t_ns, since.commanded_ns if stops else t_ns, snapshot.tension_n)
            self._bad_ns.clear()
            self._said.clear()
        for step in self._steps[action]:
            if t_ns - (since.commanded_ns if step.at_once else since.t_ns) < step.waits_ns(bounds):
                continue
            if since.stroke_mm is None and step.value in _FROM_REST:
                since.stroke_mm, since.rest_n = snapshot.stroke_mm, snapshot.tension_n
            symptom = step.symptom
            limit = step.bound(bounds)
            if not (value := step.value(snapshot, since, bounds)) > limit:
                self._bad_ns.pop(symptom, None)
                continue
            if t_ns - self._bad_ns.setdefault(symptom, t_ns) < step.persistence_ns or symptom in self._said:
                continue
            self._said.add(symptom)
            return Escalation(fault, symptom, float(value), limit, step.after)
        return None
