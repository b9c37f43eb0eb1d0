"""The tension cell's systematic errors at the full size of the sensor budget, and the same cell commissioned."""

from __future__ import annotations

from typing import NamedTuple

from hil.studies.cell.bench import CellBench
from hil.studies.cell.commissioning import WEEK_C, commission
from hil.studies.cell.drawn_cell import SCATTER_N, DrawnCell, compensating, worst
from rigctl.commission.cell_uncertainty import CREEP_PCT, GAIN_PCT, WARMING_H
from rigctl.config.changed_settings import changed
from rigctl.config.settings import RigSettings
from rigctl.ipc.correction import Correction
from rigctl.report.sensor_budget import WARMING_K_H, budget

QUICKENED = 30.0
"""A run of a minute sees the creep of half an hour."""


class CommissionedCell(NamedTuple):
    """A rig whose cell has every error, and what its ledger says of the cell."""

    rig: RigSettings
    correction: Correction


def with_errors(rig: RigSettings) -> RigSettings:
    """The same rig with every error of the budget at its full size and of one sign, the worst case."""
    size = {error.name: error.newtons for error in budget(rig)}
    errors = {
        "bias_n": size["bias"] + size["drift"],
        "gain_pct": GAIN_PCT,
        "creep_pct": CREEP_PCT,
        "creep_s": 0.1,  # the creep has run its course
    }
    return changed(rig, {f"simulation.cell.{key}": value for key, value in errors.items()})


def commissioned(rig: RigSettings) -> CommissionedCell:
    """The rig with a cell whose errors are all at two standard deviations, tared, calibrated and its creep taken out.

    Commissioned as an operator does, then a shift's warming later; of the two signs that all errors can have, the one
    that leaves more.
    """
    return max((_commissioned(rig, worst(rig, sign)) for sign in (1.0, -1.0)), key=lambda found: found[0])[1]


def _commissioned(rig: RigSettings, drawn: DrawnCell) -> tuple[float, CommissionedCell]:
    made = drawn.quickened(QUICKENED).settings(compensating(rig))
    sign = 1.0 if drawn.bias_n > 0.0 else -1.0
    scatter = [sign * SCATTER_N * celsius / max(WEEK_C) for celsius in WEEK_C]
    done = commission(drawn, CellBench(made), [*scatter, -2.0 * sign * SCATTER_N], quickened=QUICKENED)
    bench, correction = done.bench, done.standing.correction
    assert made.simulation is not None  # the comparison refuses a rig without it
    simulated, warmer_k = made.simulation.cell, WARMING_K_H * WARMING_H
    warmed = {
        "bias_n": simulated.bias_n + drawn.zero_n_k * warmer_k,
        "gain_pct": simulated.gain_pct + drawn.gain_pct_k * warmer_k,
        "temperature_c": simulated.temperature_c + warmer_k,
    }
    bench.celsius += warmer_k
    bench.wait(600.0)
    target_n = rig.tension.target_n
    bench.pull(target_n)
    left_n = abs(target_n - bench.mean_n(1.0))
    warm = changed(made, {f"simulation.cell.{key}": value for key, value in warmed.items()})
    return left_n, CommissionedCell(warm, correction)
