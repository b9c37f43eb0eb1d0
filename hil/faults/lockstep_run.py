"""One row of the catalogue in simulated time: the same run with and without the fault."""

from __future__ import annotations

import contextlib
import functools
import math
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.branching import BranchPoint, Found
from hil.faults import stand
from hil.faults.expected import Around, InjectedFault, Reaction
from hil.faults.judging.first_sign import cut_at_first_sign
from hil.faults.rows import arming_phases
from hil.faults.stand import Stand, Step
from hil.lockstep import Lockstep, lockstep
from hil.operated_rig import CommandRefusedError
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.clock import SimulatedClock
from rigctl.control.law.tension import Gains
from rigctl.model.events import Kind
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

Floats = npt.NDArray[np.float64]
SEED = "faults"
LEAD_RECORDS = 2500
"""Records before the fault that are kept with a run: a diagnosis takes the healthy rig from them."""
_KEPT = 8
"""Rigs at the start of rows that are kept, 50 MB each."""
KILLED_S = 1.5
"""The rig is watched for so long after its loop has been killed: the drive has stopped by then."""


class Start(NamedTuple):
    """All that a row's run depends on before its fault comes."""

    change: tuple[tuple[str, Any], ...]
    preload_n: float | None
    phase: str
    parked: bool
    mode: Mode
    from_start: bool


def start_of(around: Around, mode: Mode, from_start: bool) -> Start:
    """The start of a row."""
    return Start(around.change, around.preload_n, around.phase, around.parked, mode, from_start)


def by_start(rows: Iterable[tuple[InjectedFault, Mode]]) -> list[tuple[InjectedFault, Mode]]:
    """Rows in an order in which those with the same start follow one another, so that it is played once."""
    return sorted(rows, key=lambda row: repr(start_of(row[0].around, row[1], row[0].from_start)))


@dataclass(frozen=True)
class TripEvent:
    """A tripped row of the safety table, from its event."""

    t_s: float
    fault: int
    limit: float
    text: str  # of the row


@dataclass(frozen=True)
class RecordedTruth:
    """The truth (one sample a millisecond, ``t_s`` from the fault's beginning) and the loop's records."""

    t_s: Floats
    tension_n: Floats
    stroke_mm: Floats
    enabled: npt.NDArray[np.bool_]  # whether the drive's motor is on, or will be as soon as the brake is open
    powered: npt.NDArray[np.bool_]  # whether the motor has current, whatever the drive reports
    closed: npt.NDArray[np.bool_]  # whether the brake's armature is pressed on; it may slip
    records_t_s: Floats
    records: npt.NDArray[Any]
    before: Any  # the record before the first of them


@dataclass(frozen=True)
class Run(RecordedTruth):
    """A row that has been played."""

    trips: tuple[TripEvent, ...]
    command: Verb | None  # given at the end
    refusal: Refusal | None  # of that command
    events: npt.NDArray[Any]  # of the loop, from the fault's beginning on
    lead: npt.NDArray[Any]  # records of the seconds before it
    dead_from: int | None  # sample from which on the loop was dead: killed at the end where the motor was on; else None
    replies: npt.NDArray[Any]  # of the loop, from the fault's beginning on
    frames: list[tuple[int, bytes]]  # on the wire with their time, where the bench keeps them


class _Watcher:
    """Samples the truth after every period of the rig."""

    def __init__(self, rig: Lockstep) -> None:
        self._rig = rig
        self._origin_ns = rig.clock.now()
        self.rows: list[tuple[float, float, float, bool, bool, bool]] = []

    def __call__(self) -> None:
        rig = self._rig.rig
        truth = rig.truth
        t_s = (truth.t_ns - self._origin_ns) * 1e-9
        control = rig.drive.control
        stage = control.stage
        self.rows.append((t_s, truth.tension_n, truth.stroke_mm, control.enabled, stage.powered, stage.braked))


@dataclass(frozen=True)
class _Prepared:
    """A rig in the mode, and the state around, in which faults come."""

    rig: Lockstep
    branch_point: BranchPoint
    before: Any  # the last record
    lead: npt.NDArray[Any]  # records of the seconds before


class Bench:
    """Plays rows on a rig and keeps the runs without a fault."""

    def __init__(
        self, settings: RigSettings, gains: Gains, *, most_after_s: float = math.inf, keeps_frames: bool = False
    ) -> None:
        """``most_after_s``: longest time that a row is watched after its own seconds."""
        self.settings, self._keeps_frames = settings, keeps_frames
        self._gains, self._most_after_s = gains, most_after_s
        self._undisturbed = functools.lru_cache(maxsize=None)(self._play_undisturbed)
        self._prepared: OrderedDict[Start, tuple[_Prepared, contextlib.ExitStack]] = OrderedDict()
        weakref.finalize(self, _close, self._prepared)

    def undisturbed(self, fault: InjectedFault, mode: Mode) -> Run:
        """Play a row without its fault."""
        return self._undisturbed(fault.around, mode, self._seconds(fault), fault.from_start)

    def play(self, fault: InjectedFault, mode: Mode) -> Run:
        """Play a row."""
        command = _last_command(fault, mode)
        return self._play(fault.around, mode, self._seconds(fault), fault.from_start, fault, command=command)

    def play_cut(self, fault: InjectedFault, mode: Mode) -> Run:
        """Play a row, and cut the motor's power at the first tick that shows the fault."""
        return self._play(fault.around, mode, self._seconds(fault), fault.from_start, fault, cuts=True)

    def branch(self, fault: InjectedFault, mode: Mode, go_on: Callable[[Stand], Found]) -> Found:
        """What ``go_on`` finds from the start of a row on, where its fault is not in yet; in a process of its own."""
        prepared = self._prepare(start_of(fault.around, mode, fault.from_start))
        return prepared.branch_point.branch(lambda: go_on(Stand(prepared.rig, _seed(fault, mode))))

    def _seconds(self, fault: InjectedFault) -> float:
        return fault.seconds + min(fault.after_s, self._most_after_s)

    def _play_undisturbed(self, around: Around, mode: Mode, seconds: float, from_start: bool) -> Run:
        return self._play(around, mode, seconds, from_start, None)

    def _play(
        self, around: Around, mode: Mode, seconds: float, from_start: bool, fault: InjectedFault | None, *,
        command: Verb | None = None, cuts: bool = False,
    ) -> Run:  # fmt: skip
        prepared = self._prepare(start_of(around, mode, from_start))
        seed = _seed(fault, mode)
        return prepared.branch_point.branch(
            lambda: _branch(prepared, around, seconds, from_start, fault, seed, command=command, cuts=cuts)
        )

    def _prepare(self, start: Start) -> _Prepared:
        """The rig at a start, which is played once for the rows that follow one another."""
        if start in self._prepared:
            self._prepared.move_to_end(start)
            return self._prepared[start][0]
        if len(self._prepared) >= _KEPT:
            self._prepared.popitem(last=False)[1][1].close()
        with contextlib.ExitStack() as opened:
            rig = opened.enter_context(
                lockstep(changed(self.settings, dict(start.change)), self._gains, log=self._keeps_frames)
            )
            stand.start(rig, start.mode, 0.0 if start.from_start else start.preload_n)
            if not start.from_start:
                stand.enter(rig, start.mode)
                if start.parked:
                    stand.park(rig)
                if start.phase:
                    arming_phases.arm_until(rig, start.phase)
            before = None if start.from_start else rig.run(1.0 / rig.settings.loop.rate_hz)[-1]
            lead = _lead(rig)
            prepared = _Prepared(rig, BranchPoint(rig.runtime.directory), before, lead)
            self._prepared[start] = prepared, opened.pop_all()
        return prepared


def _seed(fault: InjectedFault | None, mode: Mode) -> str:
    return f"{SEED}:{fault.id if fault else ''}:{mode.name}"


def _close(prepared: OrderedDict[Start, tuple[_Prepared, contextlib.ExitStack]]) -> None:
    for _, opened in prepared.values():
        opened.close()


def _lead(rig: Lockstep) -> npt.NDArray[Any]:
    return rig.runtime.records.reader(from_start=True).read()[-LEAD_RECORDS:]


def _branch(
    prepared: _Prepared,
    around: Around,
    seconds: float,
    from_start: bool,
    fault: InjectedFault | None,
    seed: str,
    *,
    command: Verb | None,
    cuts: bool,
) -> Run:
    rig, before, lead = prepared.rig, prepared.before, prepared.lead
    rig.frames.clear()
    replies = rig.runtime.replies.reader()
    subject = Stand(rig, seed)
    step: Step | None = None
    if from_start:
        step = fault.inject(subject) if fault else None
        to_tensioning(rig)
        before, lead = rig.run(1.0 / rig.settings.loop.rate_hz)[-1], _lead(rig)
    rig.events.read()
    origin_ns = rig.clock.now()
    watcher = rig.on_advance = _Watcher(rig)
    if around.motion is not None:
        rig.rig.plant.start_motion(around.motion(), rig.rig.plant.t_ns)
    if fault is not None and not from_start:
        step = fault.inject(subject)
    elif fault is None and around.course is not None:
        step = around.course(subject)
    if cuts:
        step = cut_at_first_sign(subject, step)
    records = _go_on(rig, seconds, step)
    rig.on_advance = None
    events = rig.events.read()
    trips = _trips(events, origin_ns)
    refusal = None if command is None else rig.command(command)
    control = rig.rig.drive.control
    dead_from = len(watcher.rows) if (control.enabled or control.stage.powered) and command is None else None
    if dead_from is not None:
        rig.on_advance = watcher
        kill(rig)
    t_s, tension_n, stroke_mm, enabled, powered, closed = map(np.array, zip(*watcher.rows, strict=True))
    records_t_s = (records["t_ns"] - origin_ns) * 1e-9
    return Run(
        t_s, tension_n, stroke_mm, enabled, powered, closed, records_t_s, records, before, trips, command, refusal,
        events, lead, dead_from, replies.read(), rig.frames,
    )  # fmt: skip


def _last_command(fault: InjectedFault, mode: Mode) -> Verb | None:
    """The command that a row ends with: ARM where it is to be refused, RELEASE where a parked rig goes on as it was."""
    expected = fault.expected[mode]
    if expected is Reaction.REFUSED:
        return Verb.ARM
    return Verb.RELEASE if fault.around.parked and mode is Mode.HOLD and expected is Reaction.RIDDEN else None


def kill(rig: Lockstep) -> None:
    """The loop is dead from now on: neither RPDO nor heartbeat; the rig goes on for a while."""
    for _ in range(round(KILLED_S * rig.settings.loop.rate_hz)):
        SimulatedClock.next_tick(rig.clock)


def to_tensioning(rig: Lockstep) -> None:
    """Arm and tension a rig whose fault has been there since power-on."""
    with contextlib.suppress(CommandRefusedError):  # a refusal is a result
        rig.do(Verb.ARM)
        rig.do(Verb.TENSION)


def _go_on(rig: Lockstep, seconds: float, step: Step | None) -> npt.NDArray[Any]:
    start_ns, period_ns = rig.clock.now(), rig.settings.loop.period_ns
    end_ns = start_ns + round(seconds * 1e9)
    parts, ticks = [], 0
    while (now_ns := rig.clock.now()) < end_ns:
        if step is not None:
            step((now_ns - start_ns) * 1e-9)
        rig.clock.skip = min(rig.clock.skip, (end_ns - now_ns) // period_ns - 1)
        rig.tick()
        ticks += 1
        if ticks % 1000 == 0:
            parts.append(rig.read_records())
    return np.concatenate([*parts, rig.read_records()])


def _trips(events: npt.NDArray[Any], origin_ns: int) -> tuple[TripEvent, ...]:
    return tuple(
        TripEvent(
            (int(event["t_ns"]) - origin_ns) * 1e-9, int(event["a"]), float(event["limit"]), event["text"].decode()
        )
        for event in events
        if event["kind"] == Kind.TRIP
    )
