"""The observations of a run, compared with what the catalogue expects."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil.faults.expected import InjectedFault, Reaction
from hil.faults.judging.known_misses import beyond_known
from hil.faults.judging.statements import false_statements
from hil.faults.lockstep_run import Floats, Run, TripEvent
from rigctl.config.settings import RigSettings
from rigctl.control.watch import limits, safety
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.reactions import Action
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

STANDS_MM = 0.1
"""A held stroke moves less than this once it has come to rest ..."""
REST_S = 0.15
"""... this long after the reaction at the latest: ramp, lag and brake."""
CARRIED = 0.5
"""Share of the tension without the fault above which the load still hangs on the rope."""
TRIP_TEXT = 80
"""Characters of a row's text that fit into an event."""
DRIVE_STOPS_MS = 100.0
"""Time in which a drive without commands stands still."""
MOVES_MM_S, LAST_S, DEAD_REST_MM = 0.1, 1.0, 0.02
"""A load moves: faster than the first over the last second of a row; it rests: less than the third in half a second."""
DEATH = "the death of the loop stopped it"
SEEN_MM = 2.0
"""By stiffness: a load that sinks on its brake is seen by then."""
_LOAD_MOVES = [Fault.STROKE_MOVES, Fault.LOAD_SINKS, Fault.BRAKE_SLIPS]
WORSE_THAN_CUT = 1.1
KEPT_IN = frozenset({Mode.DISARMED, Mode.HOLD, Mode.FAULT})
"""Modes that keep the stroke in place."""
_WHAT_WILL_DO = {
    Reaction.HELD: {Reaction.HELD, Reaction.DRIVE_OFF},
    Reaction.EITHER: {Reaction.HELD, Reaction.DRIVE_OFF, Reaction.LATCHED, Reaction.RIDDEN, Reaction.REFUSED},
    Reaction.REFUSED: {Reaction.REFUSED, Reaction.LATCHED},
    Reaction.DRIVE_STOPS: {Reaction.DRIVE_OFF},
}
"""Reactions that satisfy an expectation beside the expected one."""


@dataclass(frozen=True)
class FaultResult:
    """One line of the catalogue's result."""

    id: str
    mode: str
    expected: str
    reaction: str
    detection_ms: float | None  # from the fault to the first sample beyond a limit
    latency_ms: float | None  # from there to the safe command, or to the drive's own stop
    tension_min_n: float
    tension_max_n: float
    tension_error_n: float  # largest distance of the true tension from its expected value
    stroke_mm: float  # motion from the reaction on, or against the run without the fault if there is no reaction
    load_carried: bool
    fault: str  # latched fault
    findings: tuple[str, ...]  # deviations from the expectation

    @classmethod
    def unreached(cls, id_: str, mode: Mode, expected: Reaction, why: str) -> FaultResult:
        """A row that could not be played counts as failed; the other rows are still played."""
        nan = math.nan
        return cls(
            id_, mode.name, str(expected), "not reached", None, None, nan, nan, nan, nan, False, "", (why,)
        )  # fmt: skip

    @property
    def ok(self) -> bool:
        """Whether the row is as expected."""
        return not self.findings

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        unknown = {
            name: None for name, value in values.items() if isinstance(value, float) and not math.isfinite(value)
        }
        return {**values, **unknown, "ok": self.ok}


def judge(
    fault: InjectedFault, mode: Mode, run: Run, undisturbed: Run, settings: RigSettings, cut: Run | None = None
) -> FaultResult:
    """Compare a run with the catalogue's expectation.

    ``cut``: the same with the motor's power cut at the first tick that shows the fault, for a row held against it.
    """
    expected = fault.expected[mode]
    run, dead = _parted(run)
    at = _last_fault_at(run) if fault.ends_elsewhere else _reaction_at(run, expected, mode)
    reaction = _reaction(fault, run, undisturbed, mode, at)
    detection_ms, latency_ms = _times(run, expected, at, settings)
    error_n = _error_n(run, undisturbed, at)
    stroke_mm = _moved_mm(run, undisturbed, at)
    without_n = _until(run, undisturbed, undisturbed.tension_n, at)[-1]
    released = without_n < settings.tension.slack_n
    carried = bool(released or run.tension_n[-1] > CARRIED * without_n)
    findings = []
    if reaction not in _WHAT_WILL_DO.get(expected, {expected}):
        findings.append(f"{reaction}")
    band_n = fault.band_n if cut is None else _band_by_cut_n(cut, undisturbed, expected, mode)
    if not math.isfinite(error_n) or error_n > band_n:
        findings.append(f"tension {error_n:.1f} N off, expected at most {band_n:.3g}")
    if mode in KEPT_IN and (moved_mm := _moved_mm(run, undisturbed, None)) > fault.held_mm:
        findings.append(f"stroke moved {moved_mm:.2f} mm, expected at most {fault.held_mm:g}")
    if fault.carried and not carried:
        findings.append("load not carried")
    findings += _late(fault, mode, expected, detection_ms, latency_ms)
    findings += _uncounted(fault, run, undisturbed)
    findings += _unseen(run, undisturbed, expected, settings.plant.stiffness_n_mm)
    findings += _stopped_by_death(run, dead, undisturbed, at, settings.plant.stiffness_n_mm)
    if run.command is Verb.RELEASE and run.refusal is Refusal.PREFLIGHT:
        findings.append("a check bars the release of the load")
    off_late_s, off_before = fault.shown_late_ms * 1e-3, fault.around.parked
    findings += false_statements(run, settings, off_late_s=off_late_s, off_before=off_before)
    return FaultResult(
        fault.id,
        mode.name + ("_PARKED" if fault.around.parked else ""),
        str(expected),
        str(reaction),
        detection_ms,
        latency_ms,
        float(run.tension_n.min()),
        float(run.tension_n.max()),
        error_n,
        stroke_mm,
        carried,
        Fault(int(run.records["fault"][-1])).name,
        tuple(beyond_known(findings, fault.id, mode)),
    )


def _band_by_cut_n(cut: Run, undisturbed: Run, expected: Reaction, mode: Mode) -> float:
    cut, _ = _parted(cut)
    return WORSE_THAN_CUT * _error_n(cut, undisturbed, _reaction_at(cut, expected, mode))


def _parted(run: Run) -> tuple[Run, Floats]:
    """The run up to the death of its loop, and the stroke from then on."""
    end = len(run.t_s) if run.dead_from is None else run.dead_from
    alive = {
        name: getattr(run, name)[:end] for name in ("t_s", "tension_n", "stroke_mm", "enabled", "powered", "closed")
    }
    return replace(run, **alive), run.stroke_mm[end:]


def _stopped_by_death(run: Run, dead: Floats, undisturbed: Run, at: float | None, stiffness_n_mm: float) -> list[str]:
    """A load that moves until the loop is killed, and no longer: the rig lacked a reaction.

    Its motion is that of the tension against the run without the fault, or against the reaction's.
    """
    since_s = max(run.t_s[-1] - LAST_S, REST_S if at is None else at + REST_S)
    last = run.t_s >= since_s
    last_s = run.t_s[-1] - since_s
    if not len(dead) or last_s < REST_S or np.ptp(dead[-len(dead) // 3 :]) > DEAD_REST_MM:
        return []
    off_n = (run.tension_n - _until(run, undisturbed, undisturbed.tension_n, at))[last]
    # While a law regulates, what leads back to the run without the fault is its work; else nothing may move the load.
    regulated = Mode(int(run.records["mode"][-1])) not in KEPT_IN
    moved_n = away_n(off_n[-1:], off_n[0])[0] if regulated else abs(off_n[-1] - off_n[0])
    speed_mm_s = float(moved_n) / stiffness_n_mm / last_s
    return [f"the load moved at {speed_mm_s:.2f} mm/s until {DEATH}"] if speed_mm_s > MOVES_MM_S else []


def _unseen(run: Run, undisturbed: Run, expected: Reaction, stiffness_n_mm: float) -> list[str]:
    """Of a load that moves on, since nothing but an operator's command may stop it: how far until a fault says so."""
    if expected is not Reaction.MOVES:
        return []
    events = run.events
    shown_ns = events["t_ns"][np.isin(events["kind"], (Kind.TRIP, Kind.CAUSE)) & np.isin(events["a"], _LOAD_MOVES)]
    if not len(shown_ns):
        return ["no fault shows that the load moves"]
    shown_s = (int(shown_ns[0]) - int(run.records["t_ns"][0])) * 1e-9 + run.records_t_s[0]
    off_n = (run.tension_n - _until(run, undisturbed, undisturbed.tension_n, None))[run.t_s <= shown_s]
    moved_mm = float(np.max(np.abs(off_n), initial=0.0)) / stiffness_n_mm
    return [f"the load moved {moved_mm:.2f} mm before a fault showed it"] if moved_mm > SEEN_MM else []


def away_n(off_n: Floats, from_n: float) -> Floats:
    """How far each value is beyond the first, seen from 0; on the other side of 0, all of it."""
    other = np.sign(off_n) * np.sign(from_n) < 0.0
    return np.where(other, np.abs(off_n), np.maximum(np.abs(off_n) - abs(from_n), 0.0))


def _reaction_at(run: Run, expected: Reaction, mode: Mode) -> float | None:
    """Time at which FAULT was entered (or the drive switched off, where that is expected); None if it was not."""
    if expected in (Reaction.DRIVE_STOPS, Reaction.DRIVE_OFF):
        off = np.flatnonzero(~run.enabled)
        return float(run.t_s[off[0]]) if len(off) else None
    if mode is Mode.FAULT:
        return None
    tripped = np.flatnonzero(run.records["mode"] == Mode.FAULT)
    return float(run.records_t_s[tripped[0]]) if len(tripped) else None


def _last_fault_at(run: Run) -> float | None:
    """Time of the last entry into FAULT: an operator's commands come before it."""
    entered = np.flatnonzero(np.diff((run.records["mode"] == Mode.FAULT).astype(int), prepend=0) > 0)
    return float(run.records_t_s[entered[-1]]) if len(entered) else None


def _reaction(fault: InjectedFault, run: Run, undisturbed: Run, mode: Mode, at: float | None) -> Reaction:
    last = Mode(run.records["mode"][-1])
    expected = fault.expected[mode]
    if last is Mode.FAULT:
        if not _stands(run, at):
            return Reaction.MOVES
        if mode is Mode.FAULT:
            same = run.records["fault"][-1] == undisturbed.records["fault"][-1]
            if expected in (Reaction.DRIVE_OFF, Reaction.DRIVE_STOPS) and not run.enabled[-1]:
                return Reaction.DRIVE_OFF
            return Reaction.KEPT if same and np.all(run.records["mode"] == Mode.FAULT) else Reaction.LEFT
        if mode is Mode.DISARMED:
            return Reaction.LATCHED
        return Reaction.HELD if run.enabled[-1] else Reaction.DRIVE_OFF
    if fault.ends_elsewhere:
        return Reaction.RIDDEN
    if run.command is Verb.ARM:
        return Reaction.ARMED if run.refusal is Refusal.NONE else Reaction.REFUSED
    if np.any(run.records["mode"] == Mode.FAULT):
        return Reaction.LEFT
    if fault.around.phase and last is Mode.DISARMED:
        return Reaction.REFUSED
    return Reaction.RIDDEN if last == undisturbed.records["mode"][-1] else Reaction.LEFT


def _stands(run: Run, at: float | None) -> bool:
    since = 0.0 if at is None else at + REST_S
    held = run.stroke_mm[run.t_s >= min(since, run.t_s[-1] - REST_S)]
    return bool(np.ptp(held) <= STANDS_MM)


def _times(run: Run, expected: Reaction, at: float | None, settings: RigSettings) -> tuple[float | None, float | None]:
    if expected is Reaction.DRIVE_STOPS:
        return (None, None) if at is None else (0.0, 1e3 * max(at, _stands_from(run)))
    if not run.trips:
        return None, None if at is None else 1e3 * at
    first = run.trips[0]
    bad_s = first.t_s - _persistence_s(first, settings)
    return 1e3 * bad_s, 1e3 * ((at if at is not None else first.t_s) - bad_s)


def _stands_from(run: Run) -> float:
    """Time from which the stroke stayed in place."""
    moving = run.t_s[np.abs(run.stroke_mm - run.stroke_mm[-1]) > STANDS_MM]
    return float(moving[-1]) if len(moving) else 0.0


def _persistence_s(trip: TripEvent, settings: RigSettings) -> float:
    """Persistence of the tripped row of the safety table; 0 without such a row."""
    rows = (*safety.table(settings), *limits.rows(settings))
    same = [
        r
        for r in rows
        if (r.fault, r.text[:TRIP_TEXT]) == (trip.fault, trip.text)
        and r.action is not Action.LOG
        and math.isclose(r.sign * r.limit, trip.limit, abs_tol=1e-9)
    ]
    return max((row.persistence_ns * 1e-9 for row in same), default=0.0)


def _until(run: Run, undisturbed: Run, values: Floats, at: float | None) -> Floats:
    """Values of the undisturbed run at the times of the other, constant from the reaction on."""
    return np.interp(run.t_s if at is None else np.minimum(run.t_s, at), undisturbed.t_s, values)


def _error_n(run: Run, undisturbed: Run, at: float | None) -> float:
    """Largest tension error against the run without the fault; from a reaction on, against that run's value there."""
    return float(np.max(np.abs(run.tension_n - _until(run, undisturbed, undisturbed.tension_n, at))))


def _moved_mm(run: Run, undisturbed: Run, at: float | None) -> float:
    if at is None:
        return float(np.max(np.abs(run.stroke_mm - _until(run, undisturbed, undisturbed.stroke_mm, None))))
    after = run.stroke_mm[run.t_s >= at]
    return float(np.max(np.abs(after - after[0]))) if len(after) else 0.0


_UNTIMED = frozenset({Reaction.RIDDEN, Reaction.REFUSED, Reaction.KEPT, Reaction.EITHER})


def _late(
    fault: InjectedFault, mode: Mode, expected: Reaction, detection_ms: float | None, latency_ms: float | None
) -> list[str]:
    if expected in _UNTIMED or latency_ms is None:
        return []
    limit_ms = DRIVE_STOPS_MS if expected is Reaction.DRIVE_STOPS else fault.latency_ms
    findings = []
    if mode is not Mode.FAULT and latency_ms > limit_ms + 1e-6:
        findings.append(f"reacts after {latency_ms:.0f} ms, expected at most {limit_ms:g}")
    total_ms = latency_ms + (detection_ms or 0.0)
    if total_ms > fault.within_ms:
        findings.append(f"reacts {total_ms:.0f} ms after the fault, expected at most {fault.within_ms:g}")
    return findings


def _uncounted(fault: InjectedFault, run: Run, undisturbed: Run) -> list[str]:
    if not fault.counter:
        return []
    grown, usual = (_growth(which, fault.counter) for which in (run, undisturbed))
    return [] if grown > usual else [f"{fault.counter} did not count it"]


def _growth(run: Run, counter: str) -> int:
    return int(run.records[counter].max()) - int(run.before[counter])
