"""The motor takes a load from the brake on drawn drives: how far the load moves, and when the stroke moves again.

A loaded rope is armed, the load is parked on the brake again, and TENSION takes it back.
"""

from __future__ import annotations

import math
import random
from typing import Any, NamedTuple

from hil.lockstep import Lockstep, lockstep
from hil.runs.runner import Work, play
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.control.law.tension import Gains
from rigctl.model.states import Mode
from rigctl.model.verbs import Refusal, Verb

SEED, DRAWS = 34, 60
LIMIT_MM = 0.1
"""Largest roll-back with a preload."""
AGAIN_S = 1.0
"""From TENSION to the first motion, beside the time that the drive waits for its brake."""
MOVED_KG = 50.0
RATED_FORCE_N = 1500.0
SPRING_N_MM, LOAD_N, TORQUE_MS, OPENS_MS = (6.0, 34.0), (50.0, 350.0), (5.0, 20.0), (30, 150)
ERROR_PCT, LOOP_HZ = 10.0, (25.0, 100.0)
_WAITS_MS = 10
"""How much longer than its brake takes to open a drive is set to wait."""
_SETTLE_S, _TAKEN_S, _PARKED_S = 0.6, 0.4, 1.5


class Takeover(NamedTuple):
    """One drawn rig: spring, load, and the drive; ``preload``: the daemon gives the motor one, with this error."""

    spring_n_mm: float
    load_n: float
    error_pct: float
    torque_ms: float
    brake_open_ms: int
    speed_loop_hz: float
    preload: bool

    @property
    def waits_ms(self) -> int:
        """Time that the drive waits for its brake."""
        return self.brake_open_ms + _WAITS_MS

    @property
    def expected_mm(self) -> float:
        """Roll-back by the closed form, 4 F / (m w2), of the force F that the motor lacks at first."""
        lacks_n = self.load_n * (self.error_pct * 1e-2 if self.preload else 1.0)
        return 4.0 * lacks_n / (MOVED_KG * 1e-3 * (2.0 * math.pi * self.speed_loop_hz) ** 2)


class TakenOver(NamedTuple):
    """What the plant's truth shows; ``again_s`` is NaN where the motor did not hold the load, which ``ended`` names."""

    rolled_mm: float
    again_s: float
    ended: str


def draw(count: int = DRAWS, seed: int = SEED) -> list[Takeover]:
    """Drawn rigs, each with a preload; the same for a seed, and the first ones are the same for any ``count``."""
    random_ = random.Random(f"takeover:{seed}")
    return [
        Takeover(
            round(random_.uniform(*SPRING_N_MM), 2), round(random_.uniform(*LOAD_N), 1),
            round(random_.uniform(-ERROR_PCT, ERROR_PCT), 2), round(random_.uniform(*TORQUE_MS), 2),
            random_.randint(*OPENS_MS), round(random_.uniform(*LOOP_HZ), 1), True,
        )
        for _ in range(count)
    ]  # fmt: skip


def study(rig: RigSettings, gains: Gains, drawn: list[Takeover], advance: Any) -> dict[Takeover, TakenOver]:
    """Play drawn rigs. ``gains``: of the law, which holds no tension here."""
    pieces = {case: Work(taken_over, (rig, gains, case), str(case)) for case in drawn}
    return play(pieces, advance, pieces_per_worker=4)


def settings_of(rig: RigSettings, case: Takeover) -> RigSettings:
    """The rig with this spring and drive; HOLD parks as soon as a rig file may have it."""
    return changed(
        rig,
        {
            "plant.spring_n_mm": case.spring_n_mm, "hold.park_s": 0.5, "cylinder.brake_test": False,
            "cylinder.brake_delay_ms": max(case.waits_ms, rig.cylinder.brake_delay_ms),
            "cylinder.rated_force_n": RATED_FORCE_N if case.preload else None,
            "safety.waiver": "a study of drawn springs: no load hangs on it",
            "simulation.drive.brake_ms": case.waits_ms, "simulation.drive.brake_open_ms": case.brake_open_ms,
            "simulation.drive.brake_close_ms": 20, "simulation.drive.speed_loop_hz": case.speed_loop_hz,
            "simulation.drive.moved_kg": MOVED_KG, "simulation.drive.torque_ms": case.torque_ms,
            "simulation.drive.preload_error_pct": case.error_pct,
        },
    )  # fmt: skip


def taken_over(rig: RigSettings, gains: Gains, case: Takeover) -> TakenOver:
    """Arm, park, and take the load back."""
    strokes: list[float] = []
    with lockstep(settings_of(rig, case), gains) as bench:
        bench.on_advance = lambda: strokes.append(bench.rig.truth.stroke_mm)
        bench.rig.plant.preload(case.load_n)
        bench.run(_SETTLE_S)
        rolled_mm = _rolls(bench, strokes, Verb.ARM)
        if _ended(bench) != "HOLD":
            return TakenOver(rolled_mm, math.nan, _ended(bench))
        bench.run(_PARKED_S)
        if not bench.rig.drive.control.stage.braked:
            return TakenOver(rolled_mm, math.nan, "not parked")
        since_ns, before_mm = bench.clock.now(), bench.rig.truth.stroke_mm
        strokes.clear()
        bench.give(Verb.TENSION)
        while bench.clock.now() - since_ns < 5_000_000_000:
            bench.tick()
            moves = bench.loop.machine.mode is Mode.TENSIONING and bench.loop.law.command_mm_s != 0.0
            if moves and abs(strokes[-1] - strokes[-2]) > 0.0:
                again_s = (bench.clock.now() - since_ns) * 1e-9
                return TakenOver(max(rolled_mm, _most(strokes, before_mm)), again_s, _ended(bench))
        return TakenOver(rolled_mm, math.nan, f"does not move: {_ended(bench)}")


def _rolls(bench: Lockstep, strokes: list[float], verb: Verb) -> float:
    before_mm = bench.rig.truth.stroke_mm
    strokes.clear()
    if bench.command(verb) is Refusal.NONE:
        bench.run(_TAKEN_S)
    return _most(strokes, before_mm)


def _most(strokes: list[float], before_mm: float) -> float:
    return max(abs(stroke_mm - before_mm) for stroke_mm in strokes)


def _ended(bench: Lockstep) -> str:
    mode, fault = bench.loop.machine.mode, bench.loop.machine.fault
    return mode.name if mode is not Mode.FAULT else f"FAULT {fault.name}"
