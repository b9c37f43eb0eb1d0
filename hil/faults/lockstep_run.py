"""One row of the catalogue in simulated time: the same run with and without the fault."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.faults import stand
from hil.faults.expected import Around, InjectedFault, Reaction
from hil.faults.stand import Stand, Step
from hil.lockstep import Lockstep, lockstep
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.events import Kind
from rigctl.control.modes import Mode, Refusal, Verb
from rigctl.control.tension import Gains

Floats = npt.NDArray[np.float64]
SEED = "faults"


@dataclass(frozen=True)
class TripEvent:
    """A tripped row of the safety table, from its event."""

    t_s: float
    fault: int
    limit: float
    text: str  # of the row


@dataclass(frozen=True)
class Run:
    """The truth (one sample a millisecond, ``t_s`` from the fault's beginning) and the loop's records."""

    t_s: Floats
    tension_n: Floats
    stroke_mm: Floats
    enabled: npt.NDArray[np.bool_]  # whether the drive's motor is on
    records_t_s: Floats
    records: npt.NDArray[Any]
    before: Any  # the record before the first of them
    trips: tuple[TripEvent, ...]
    refusal: Refusal | None  # of the arm command at the end, where one was given


class _Watcher:
    """Samples the truth after every period of the rig."""

    def __init__(self, rig: Lockstep) -> None:
        self._rig = rig
        self._origin_ns = rig.clock.now()
        self.rows: list[tuple[float, float, float, bool]] = []

    def __call__(self) -> None:
        rig = self._rig.rig
        truth = rig.truth
        t_s = (truth.t_ns - self._origin_ns) * 1e-9
        self.rows.append((t_s, truth.tension_n, truth.stroke_mm, rig.drive.control.enabled))


class Bench:
    """Plays rows on a rig and keeps the runs without a fault."""

    def __init__(self, settings: RigSettings, gains: Gains) -> None:
        self.settings = settings
        self._gains = gains
        self._undisturbed = functools.lru_cache(maxsize=None)(self._play_undisturbed)

    def undisturbed(self, fault: InjectedFault, mode: Mode) -> Run:
        """Play a row without its fault."""
        return self._undisturbed(fault.around, mode, fault.seconds, fault.from_start)

    def play(self, fault: InjectedFault, mode: Mode) -> Run:
        """Play a row."""
        arms = fault.expected[mode] is Reaction.REFUSED
        return self._play(fault.around, mode, fault.seconds, fault.from_start, fault, arms=arms)

    def _play_undisturbed(self, around: Around, mode: Mode, seconds: float, from_start: bool) -> Run:
        return self._play(around, mode, seconds, from_start, None, arms=False)

    def _play(
        self, around: Around, mode: Mode, seconds: float, from_start: bool, fault: InjectedFault | None, *, arms: bool
    ) -> Run:
        with lockstep(changed(self.settings, dict(around.change)), self._gains) as rig:
            subject = Stand(rig, f"{SEED}:{fault.id if fault else ''}:{mode.name}")
            step: Step | None = None
            if from_start:
                stand.start(rig, mode, 0.0)
                step = fault.inject(subject) if fault else None
                _to_tensioning(rig)
            else:
                stand.start(rig, mode, around.preload_n)
                stand.enter(rig, mode)
            before = rig.run(1.0 / rig.settings.loop.rate_hz)[-1]
            rig.events.read()
            origin_ns = rig.clock.now()
            watcher = rig.on_advance = _Watcher(rig)
            if around.motion is not None:
                rig.rig.plant.start_motion(around.motion(), rig.rig.plant.t_ns)
            if fault is not None and not from_start:
                step = fault.inject(subject)
            records = _go_on(rig, seconds, step)
            rig.on_advance = None
            trips = _trips(rig, origin_ns)
            refusal = rig.command(Verb.ARM) if arms else None
        t_s, tension_n, stroke_mm, enabled = map(np.array, zip(*watcher.rows, strict=True))
        records_t_s = (records["t_ns"] - origin_ns) * 1e-9
        return Run(t_s, tension_n, stroke_mm, enabled, records_t_s, records, before, trips, refusal)


def _to_tensioning(rig: Lockstep) -> None:
    for verb in (Verb.ARM, Verb.TENSION):
        if rig.command(verb) is not Refusal.NONE:
            return  # a refusal is a result


def _go_on(rig: Lockstep, seconds: float, step: Step | None) -> npt.NDArray[Any]:
    start_ns, period_ns = rig.clock.now(), rig.settings.loop.period_ns
    end_ns = start_ns + round(seconds * 1e9)
    parts, ticks = [], 0
    while (now_ns := rig.clock.now()) < end_ns:
        if step is not None:
            step((now_ns - start_ns) * 1e-9)
        rig.clock.skip = min(rig.clock.skip, (end_ns - now_ns) // period_ns - 1)
        rig.loop.tick()
        ticks += 1
        if ticks % 1000 == 0:
            parts.append(rig.read_records())
    return np.concatenate([*parts, rig.read_records()])


def _trips(rig: Lockstep, origin_ns: int) -> tuple[TripEvent, ...]:
    return tuple(
        TripEvent(
            (int(event["t_ns"]) - origin_ns) * 1e-9, int(event["a"]), float(event["limit"]), event["text"].decode()
        )
        for event in rig.events.read()
        if event["kind"] == Kind.TRIP
    )
