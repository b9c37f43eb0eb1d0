"""How often the truth lies within the stated budget: one number per drawn cell, before and after compensation."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import NamedTuple

from hil.runs import runner
from hil.runs.runner import Work
from hil.scenario.play import Advance
from hil.studies.cell.bench import CellBench
from hil.studies.cell.commissioning import WEEK_C, Commissioned, commission
from hil.studies.cell.drawn_cell import SCATTER_N, DrawnCell, compensating, draw
from rigctl.commission.cell_uncertainty import WARMING_H
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.report import sensor_budget
from rigctl.report.sensor_budget import WARMING_K_H

STATED = 0.95  # of k = 2
LONGEST_S, SHORTEST_S = 1800.0, 10.0
"""Time under load at which the error is looked at, drawn evenly on a logarithmic scale."""
SEASON_K = 3.0  # of the cell's temperature from its calibration to the shift, at most
BATCH = 10
UNCORRECTED, CALIBRATED, COMPENSATED = "class", "calibrated", "compensated"
WAYS = {
    UNCORRECTED: "as it comes",
    CALIBRATED: "tared and calibrated",
    COMPENSATED: "compensated as well",
}


class Miss(NamedTuple):
    """One cell, one way: error of the tension (true less measured) and the stated expanded uncertainty, in N."""

    seed: int
    error_n: float
    stated_n: float

    @property
    def covered(self) -> bool:
        """The truth lies within the budget."""
        return abs(self.error_n) <= self.stated_n


class Coverage(NamedTuple):
    """One way over all cells; errors in N."""

    way: str
    title: str
    cells: int
    covered: int
    least: int
    """Fewer covered cells come less than once in a thousand studies at 95 %."""
    median_n: float
    p95_n: float
    largest_n: float
    stated_n: float

    @property
    def ok(self) -> bool:
        """The stated budget is not too small."""
        return self.covered >= self.least


def pieces(rig: RigSettings, seeds: int) -> dict[int, Work]:
    """The work, by first seed."""
    return {
        first: Work(misses, (rig, first, min(seeds, first + BATCH)), f"cells from {first}", min(BATCH, seeds - first))
        for first in range(0, seeds, BATCH)
    }


def study(rig: RigSettings, seeds: int, advance: Advance) -> list[Coverage]:
    """Every way over ``seeds`` cells."""
    found = [miss for part in runner.play(pieces(rig, seeds), advance).values() for miss in part]
    return [coverage(way, [misses[way] for misses in found]) for way in WAYS]


def coverage(way: str, found: Sequence[Miss]) -> Coverage:
    """The figures of one way."""
    errors = sorted(abs(miss.error_n) for miss in found)
    stated = sorted(miss.stated_n for miss in found)
    return Coverage(
        way, WAYS[way], len(found), sum(miss.covered for miss in found), least_covered(len(found)),
        errors[len(errors) // 2], errors[min(len(errors) - 1, math.ceil(0.95 * len(errors)) - 1)], errors[-1],
        stated[len(stated) // 2],
    )  # fmt: skip


def least_covered(cells: int, chance: float = 1e-3) -> int:
    """Number of covered cells below which a budget of 95 % falls by chance less often than this (binomial)."""
    total, term = 0.0, (1.0 - STATED) ** cells
    for covered in range(cells + 1):
        total += term
        if total > chance:
            return covered
        term *= (cells - covered) / (covered + 1) * STATED / (1.0 - STATED)
    return cells


def misses(rig: RigSettings, first: int, end: int) -> list[dict[str, Miss]]:
    """The cells of these seeds, each in every way."""
    return [cell(rig, draw(rig, seed)) for seed in range(first, end)]


def cell(rig: RigSettings, drawn: DrawnCell) -> dict[str, Miss]:
    """One cell: as it comes, and commissioned."""
    dice = random.Random(f"shift:{drawn.seed}")
    scatter = [dice.gauss(0.0, SCATTER_N) for _ in range(len(WEEK_C) + 2)]
    shift = Shift.of(dice)
    target_n = rig.tension.target_n
    bare = CellBench(drawn.settings(changed(rig, {"compensation": None})))
    bare.cell.put(bare.cell.correction)
    bare.wait(shift.hours * 3600.0, shift.warming_c_h)
    bare_error_n = _error_n(bare, target_n, shift.loaded_s)
    found = {UNCORRECTED: Miss(drawn.seed, bare_error_n, _class_n(rig))}
    made = drawn.settings(compensating(rig))
    for way, settings in ((CALIBRATED, made.model_copy(update={"compensation": None})), (COMPENSATED, made)):
        done = commission(drawn, CellBench(settings), scatter[:-1])
        found[way] = _work(done, shift, drawn.seed, scatter[-1])
    return found


class Shift(NamedTuple):
    """What happens between commissioning and the look: hours, temperature, time under load."""

    season_k: float
    warming_c_h: float
    hours: float
    loaded_s: float

    @staticmethod
    def of(dice: random.Random) -> Shift:
        """A shift at random."""
        loaded_s = math.exp(dice.uniform(math.log(SHORTEST_S), math.log(LONGEST_S)))
        return Shift(
            dice.uniform(-SEASON_K, SEASON_K), dice.uniform(-WARMING_K_H, WARMING_K_H),
            dice.uniform(0.0, WARMING_H), loaded_s,
        )  # fmt: skip


def _work(done: Commissioned, shift: Shift, seed: int, scattered_n: float) -> Miss:
    """A day later: tare, a move, hours, and the move that is looked at."""
    bench, target_n = done.bench, done.bench.settings.tension.target_n
    bench.wait(86_400.0)
    bench.celsius += shift.season_k
    bench.shift_zero(scattered_n)
    bench.wait(600.0)
    done.tare()
    bench.pull(target_n)
    bench.wait(shift.loaded_s)
    bench.pull(0.0)
    bench.wait(shift.hours * 3600.0, shift.warming_c_h)
    error_n = _error_n(bench, target_n, shift.loaded_s)
    at = datetime.fromtimestamp(bench.wall_ns / 1e9, UTC)
    stated = sensor_budget.compensated(bench.settings, done.standing, target_n, at)
    return Miss(seed, error_n, sensor_budget.combined_n(stated))


def _error_n(bench: CellBench, target_n: float, loaded_s: float) -> float:
    """True less measured tension, mean of a second, so long after the load came."""
    bench.pull(target_n)
    bench.wait(loaded_s)
    return target_n - bench.mean_n(1.0)


def _class_n(rig: RigSettings) -> float:
    return sensor_budget.combined_n(sensor_budget.budget(rig))
