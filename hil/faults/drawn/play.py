"""One block of draws: the run without a fault, and a branch of it at each draw's first fault."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.branching import BranchPoint
from hil.faults.drawn import courses, kinds
from hil.faults.drawn.courses import Course, Operator
from hil.faults.drawn.draw import Draw, PartFault
from hil.faults.drawn.watch import FrameWatch
from hil.faults.judging.statements import false_statements
from hil.faults.lockstep_run import RecordedTruth, kill
from hil.faults.stand import Stand, Step
from hil.lockstep import Lockstep, lockstep
from hil.nodes.power_stage import StagePhase
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.devices.remote_node import SilentError
from rigctl.model.events import Kind
from rigctl.model.faults import Fault
from rigctl.model.states import Flag, Mode

REST_S = 3.0
"""A load that has not moved for so long, with the drive off, its brake closed and no command to come, stays."""
REST_MM = 0.005
_LOOK_EVERY, _READ_EVERY = 100, 1000  # periods


@dataclass(frozen=True)
class Branch:
    """A run with a draw's faults."""

    rows: npt.NDArray[Any]
    """Since power-on, dtype `hil.faults.drawn.watch.ROW`."""
    killed_at: int | None
    """Row from which on the loop was dead; None where the drive was off by then."""
    trips: tuple[str, ...]
    error: str = ""
    false: tuple[str, ...] = ()
    """Statements of the records that the truth denies, from the first fault on."""


def play(
    settings: RigSettings, gains: Gains, course_name: str, draws: Sequence[Draw]
) -> tuple[list[Branch], npt.NDArray[Any]]:
    """Play draws of one course on one rig; returns their branches in order, and the run without a fault.

    Each draw is a forked process, so that what came before its first fault is played once.
    """
    with lockstep(settings, gains, log=True) as rig:
        run = CourseRun(rig, courses.BY_NAME[course_name])
        found: dict[int, Branch] = {draw.index: one for draw, one in branches(run, draws, branch)}
        most = max(len(branch.rows) for branch in found.values())
        while len(run.watch.rows) < most:
            run.tick()
        return [found[draw.index] for draw in draws], run.watch.array()


class CourseRun:
    """A rig, its operator and what is kept of it."""

    def __init__(self, rig: Lockstep, course: Course) -> None:
        self.rig, self._course = rig, course
        self._start_ns = rig.clock.now()
        self.operator = Operator(rig, course)
        tension_n = course.preload(rig.settings.tension.target_n)
        if tension_n > 0.0:
            rig.rig.plant.preload(tension_n)
        self.watch = FrameWatch(rig)
        rig.on_advance = self.watch
        self._moves = course.motion is not None
        self.steps: list[tuple[float, Step]] = []
        self.begun_row = 0  # of the last fault

    @property
    def t_s(self) -> float:
        """Since power-on."""
        return (self.rig.clock.now() - self._start_ns) * 1e-9

    def to(self, t_s: float) -> None:
        """Run until then."""
        while self.t_s < t_s:
            self.tick()

    def tick(self) -> None:
        """One period of the loop, with what is due before it."""
        t_s = self.t_s
        courses.silenced(self.rig, self._course, t_s)
        if self._moves and t_s >= self._course.motion_s:
            self._moves = False
            assert self._course.motion is not None
            self.rig.rig.plant.start_motion(self._course.motion(), self.rig.rig.plant.t_ns)
        self.operator.step(self.rig.clock.now())
        for begun_s, step in self.steps:
            step(t_s - begun_s)
        self.rig.tick()

    def begin(self, fault: PartFault, seed: str) -> None:
        """Put a fault in; a defect of the drive that is there already stays."""
        self.begun_row = len(self.watch.rows)
        drive = self.rig.rig.drive
        motor, rpdo = drive.defect, drive.rpdo_defect
        step = kinds.BY_NAME[fault.kind].inject(fault.size)(Stand(self.rig, seed))
        if step is not None:
            self.steps.append((self.t_s, step))
        if motor is not None and drive.defect is not motor:
            drive.defect = _after(motor, drive.defect)
        if rpdo is not None and drive.rpdo_defect is not rpdo:
            drive.rpdo_defect = _then(rpdo, drive.rpdo_defect)

    @property
    def rests(self) -> bool:
        """Drive off, brake closed, no command to come, and the stroke in place since the last fault, for `REST_S`."""
        rows, stage = self.watch.rows, self.rig.rig.drive.control.stage
        if stage.phase is not StagePhase.BRAKED or not self.operator.done:
            return False
        if self.rig.loop.machine.mode not in (Mode.DISARMED, Mode.HOLD, Mode.FAULT):
            return False
        count = round(REST_S * self.rig.settings.loop.rate_hz)
        return len(rows) > self.begun_row + count and all(
            abs(rows[-i][_STROKE] - rows[-1][_STROKE]) < REST_MM and not rows[-i][_POWERED]
            for i in range(1, count, _LOOK_EVERY)
        )


_STROKE, _POWERED = 2, 4


def _after(first: Callable[..., tuple[float, bool]], second: Any) -> Callable[..., tuple[float, bool]]:
    return lambda speed_mm_s, braked: second(*first(speed_mm_s, braked))


def _then(first: Callable[[bytes], bytes | None], second: Any) -> Callable[[bytes], bytes | None]:
    return lambda data: None if (taken := first(data)) is None else second(taken)


def branch(run: CourseRun, draw: Draw) -> Branch:
    """Go on with the draw's faults to its end, then kill the loop if the drive is still on."""
    rig = run.rig
    rig.events.read()
    stated = _Stated(run, draw)
    run.operator.afterwards(draw.then, draw.then_after_s)
    waiting = list(draw.faults)
    end_s = draw.faults[0].at_s + draw.seconds
    ticks = 0
    while (t_s := run.t_s) < end_s:
        while waiting and t_s >= waiting[0].at_s:
            run.begin(waiting.pop(0), f"{draw.seed}:{draw.index}:{len(waiting)}")
        try:
            run.tick()
        except SilentError:  # the daemon could not start anew: no loop from here on
            break
        ticks += 1
        if ticks % _READ_EVERY == 0:
            stated.read()
        if ticks % _LOOK_EVERY == 0 and not waiting and run.rests:
            break
    trips = tuple(
        f"{(int(event['t_ns']) - run._start_ns) * 1e-9:.3f} s {Fault(int(event['a'])).name}: {event['text'].decode()}"
        for event in rig.events.read()
        if event["kind"] == Kind.TRIP
    )
    false = stated.false()
    killed_at = len(run.watch.rows) if rig.rig.drive.control.stage.powered else None
    if killed_at is not None or run.t_s < end_s:
        kill(rig)
    return Branch(run.watch.array(), killed_at, trips, false=false)


class _Stated:
    """What the records of a branch say, from its first fault on."""

    def __init__(self, run: CourseRun, draw: Draw) -> None:
        rig = run.rig
        self._settings, self._watch, self._from_row = rig.settings, run.watch, len(run.watch.rows)
        self._origin_ns = rig.clock.now()
        self._late_s = sum(kinds.BY_NAME[fault.kind].shown_late_s(fault.size) for fault in draw.faults)
        self._before = rig.runtime.records.reader(from_start=True).read()[-1]
        self._reader = rig.runtime.records.reader()
        self._parts: list[npt.NDArray[Any]] = []

    def read(self) -> None:
        """Take the records until now: the ring holds the last seconds only."""
        self._parts.append(self._reader.read())

    def false(self) -> tuple[str, ...]:
        """The statements until now that the truth denies."""
        self.read()
        records, rows = np.concatenate(self._parts), self._watch.array(self._from_row)
        if not len(records):
            return ()
        truth = RecordedTruth(
            (rows["t_ns"] - self._origin_ns) * 1e-9, rows["tension_n"], rows["stroke_mm"], rows["enabled"],
            rows["powered"], rows["closed"], (records["t_ns"] - self._origin_ns) * 1e-9, records, self._before,
        )  # fmt: skip
        off_before = bool(self._before["flags"] & Flag.DRIVE_OFF)
        return tuple(false_statements(truth, self._settings, off_late_s=self._late_s, off_before=off_before))


def branches(
    run: CourseRun, draws: Sequence[Draw], play_it: Callable[[CourseRun, Draw], Any]
) -> Iterator[tuple[Draw, Any]]:
    """Each draw, the earliest first, with what ``play_it`` returns from a branch at its first fault; see `forked`."""
    for draw in sorted(draws, key=lambda one: one.faults[0].at_s):
        run.to(draw.faults[0].at_s)
        yield draw, forked(run, draw, play_it)


def forked(run: CourseRun, draw: Draw, play_it: Callable[[CourseRun, Draw], Any]) -> Any:
    """What ``play_it`` returns from a process of its own; an exception there gives a `Branch` with its words."""

    def go_on() -> Any:
        try:
            return play_it(run, draw)
        except BaseException:  # noqa: BLE001 - the caller reports it
            return Branch(run.watch.array(), None, (), traceback.format_exc(limit=3))

    return BranchPoint(run.rig.runtime.directory).branch(go_on)
