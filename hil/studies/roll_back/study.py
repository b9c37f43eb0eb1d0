"""A load that motor and brake take from each other, through the real loop, judged by the plant's truth."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from hil.lockstep import Lockstep, lockstep
from hil.runs.runner import Work, play
from rigctl.config import rig_file, strict_yaml
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.device_states import DriveState
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

SET = "sets/yielding_motor.yaml"
"""Parameters of motor and brake, laid over the rig file."""
SPRINGS_N_MM = (6.0, 13.0, 20.0, 27.0, 34.0)
LOADS_N = (50.0, 150.0, 250.0, 350.0)
ERROR_PCT = 10.0
"""Errors of the preload are drawn evenly up to this: twice the tolerance of a torque constant."""
LIMIT_MM = 0.1
"""Largest roll-back with a preload."""
_SETTLE_S, _TAKEN_S, _BRAKED_S = 0.6, 0.5, 1.0


class RollBackCase(NamedTuple):
    """One load on one spring; ``error_pct``: of the preload, None: the daemon gives none."""

    spring_n_mm: float
    load_n: float
    error_pct: float | None


class Moved(NamedTuple):
    """True way of the load, mm: most that it sank and rose until the motor had it, and then until the brake had it."""

    sank_mm: float
    rose_mm: float
    braked_mm: float
    ended: str
    """Mode after the motor took the load, with the fault that ended it, if any."""

    @property
    def most_mm(self) -> float:
        """Largest way when the motor takes over."""
        return max(self.sank_mm, self.rose_mm)


def cases(draws: int, seed: int) -> list[RollBackCase]:
    """Every load on every spring, once without a preload and ``draws`` times with one of a drawn error."""
    draw = random.Random(f"roll-back:{seed}")
    pairs = [(spring, load) for spring in SPRINGS_N_MM for load in LOADS_N]
    return [RollBackCase(*pair, None) for pair in pairs] + [
        RollBackCase(*pair, round(draw.uniform(-ERROR_PCT, ERROR_PCT), 2)) for _ in range(draws) for pair in pairs
    ]


def study(rig: RigSettings, gains: Gains, draws: int, seed: int, advance: Any) -> dict[RollBackCase, Moved]:
    """Play every case. ``gains``: of the law, which holds no tension here."""
    pieces = {case: Work(taken_over, (rig, gains, case), _title(case)) for case in cases(draws, seed)}
    return play(pieces, advance, pieces_per_worker=4)


def taken_over(rig: RigSettings, gains: Gains, case: RollBackCase) -> Moved:
    """Arm a loaded rope, so that the motor takes it from the brake, and disarm."""
    with _watched(settings_of(rig, case), gains) as (bench, strokes):
        bench.rig.plant.preload(case.load_n)
        bench.run(_SETTLE_S)
        before_mm = bench.rig.truth.stroke_mm
        strokes.clear()
        if bench.command(Verb.ARM) is not Refusal.NONE:
            return Moved(0.0, 0.0, 0.0, f"not armed: {Refusal(int(bench.reply['reason'])).name}")
        enabled = bench.rig.drive.control.state is DriveState.OPERATION_ENABLED
        bench.run(_TAKEN_S)
        sank_mm, rose_mm = before_mm - min(strokes), max(strokes) - before_mm
        mode, fault = bench.loop.machine.mode, bench.loop.machine.fault
        ended = mode.name if mode is not Mode.FAULT else f"FAULT {fault.name}"
        if not enabled:
            ended += ", drive off"
        strokes.clear()
        after_mm = bench.rig.truth.stroke_mm
        bench.command(Verb.DISARM)
        bench.run(_BRAKED_S)
        braked_mm = max(abs(stroke - after_mm) for stroke in strokes)
    return Moved(sank_mm, rose_mm, braked_mm, ended)


def settings_of(rig: RigSettings, case: RollBackCase) -> RigSettings:
    """The rig with this spring, a motor that needs time for its torque, and the preload of the case."""
    given = strict_yaml.read(rig_file.shipped(SET)).data
    settings = changed(rig, {**dict(_flat(given)), "plant.spring_n_mm": case.spring_n_mm})
    if case.error_pct is None:
        return changed(settings, {"cylinder.rated_force_n": None})
    return changed(settings, {"simulation.drive.preload_error_pct": case.error_pct})


@contextmanager
def _watched(settings: RigSettings, gains: Gains) -> Iterator[tuple[Lockstep, list[float]]]:
    strokes: list[float] = []
    with lockstep(settings, gains) as bench:
        bench.on_advance = lambda: strokes.append(bench.rig.truth.stroke_mm)
        yield bench, strokes


def _flat(values: Mapping[str, Any], above: Sequence[str] = ()) -> Iterator[tuple[str, object]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, (*above, key))
        else:
            yield ".".join((*above, key)), value


def _title(case: RollBackCase) -> str:
    preload = "no preload" if case.error_pct is None else f"preload {case.error_pct:+.1f} %"
    return f"{case.load_n:g} N on {case.spring_n_mm:g} N/mm, {preload}"
