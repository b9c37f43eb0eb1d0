"""Cells drawn at random: each error from a normal distribution whose two standard deviations are its class's size."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace

from rigctl.commission.cell_uncertainty import (
    BIAS_OF_RANGE_PCT,
    COVERAGE,
    CREEP_PCT,
    GAIN_PCT,
    GAIN_PCT_K,
    TEMPERATURE_N_H,
)
from rigctl.config.changed_settings import changed
from rigctl.config.compensation_section import CompensationSettings
from rigctl.config.settings import RigSettings
from rigctl.report.sensor_budget import WARMING_K_H

FAST_S, SLOW_S = (10.0, 60.0), (300.0, 1500.0)
"""Time constants of the two creeps, drawn evenly on a logarithmic scale."""
SCATTER_N = 0.003  # of the zero from tare to tare beside temperature, one standard deviation
LINEARITY_PCT, HYSTERESIS_PCT = 0.01, 0.01  # of the range, two standard deviations
WEIGHT_U_N = 0.02
"""Of 294.2 N: class M1 (0.015 N at 30 kg), local gravity to 5e-5 m/s2 and buoyancy to a tenth."""


@dataclass(frozen=True)
class DrawnCell:
    """Errors of one cell, and of the weight it is calibrated with."""

    seed: int
    bias_n: float
    gain_pct: float
    creep_pct: float
    creep_s: float
    creep2_pct: float
    creep2_s: float
    zero_n_k: float
    gain_pct_k: float
    linearity_pct: float
    hysteresis_pct: float
    weight_error_n: float

    def quickened(self, times: float) -> DrawnCell:
        """The same cell with a creep that many times as fast, for a short run of the whole rig."""
        return replace(self, creep_s=self.creep_s / times, creep2_s=self.creep2_s / times)

    def settings(self, rig: RigSettings) -> RigSettings:
        """The rig with this cell."""
        names = (
            "bias_n", "gain_pct", "creep_pct", "creep_s", "creep2_pct", "creep2_s", "zero_n_k", "gain_pct_k",
            "linearity_pct", "hysteresis_pct",
        )  # fmt: skip
        values = {f"simulation.cell.{name}": getattr(self, name) for name in names}
        return changed(rig, {**values, "simulation.cell.drift_n_h": 0.0, "simulation.seed": self.seed})


def draw(rig: RigSettings, seed: int) -> DrawnCell:
    """The cell of a seed."""
    dice = random.Random(f"cell:{seed}")

    def normal(two_deviations: float) -> float:
        return dice.gauss(0.0, two_deviations / COVERAGE)

    def even(low: float, high: float) -> float:
        return math.exp(dice.uniform(math.log(low), math.log(high)))

    range_n = rig.tension_cell.range_n
    creep, share = normal(CREEP_PCT), dice.uniform(0.2, 0.8)
    return DrawnCell(
        seed,
        bias_n=normal(BIAS_OF_RANGE_PCT / 100 * range_n),
        gain_pct=normal(GAIN_PCT),
        creep_pct=share * creep,
        creep_s=even(*FAST_S),
        creep2_pct=(1.0 - share) * creep,
        creep2_s=even(*SLOW_S),
        zero_n_k=normal(TEMPERATURE_N_H / WARMING_K_H),
        gain_pct_k=normal(GAIN_PCT_K),
        linearity_pct=normal(LINEARITY_PCT),
        hysteresis_pct=abs(normal(HYSTERESIS_PCT)),
        weight_error_n=normal(WEIGHT_U_N),
    )


def worst(rig: RigSettings, sign: float) -> DrawnCell:
    """A cell with every error at two standard deviations and of one sign, its times in the middle of what they are."""
    seed = rig.simulation.seed if rig.simulation is not None else 0
    return DrawnCell(
        seed,
        bias_n=sign * BIAS_OF_RANGE_PCT / 100 * rig.tension_cell.range_n,
        gain_pct=sign * GAIN_PCT,
        creep_pct=sign * CREEP_PCT / 2,
        creep_s=FAST_S[1],
        creep2_pct=sign * CREEP_PCT / 2,
        creep2_s=math.sqrt(SLOW_S[0] * SLOW_S[1]),
        zero_n_k=sign * TEMPERATURE_N_H / WARMING_K_H,
        gain_pct_k=sign * GAIN_PCT_K,
        linearity_pct=sign * LINEARITY_PCT,
        hysteresis_pct=HYSTERESIS_PCT,
        weight_error_n=-sign * WEIGHT_U_N,
    )


def compensating(rig: RigSettings) -> RigSettings:
    """The rig with everything that this release takes out of the cell's reading."""
    assert rig.calibration is not None  # the command refuses a rig without it
    weight = rig.calibration.model_copy(update={"reference_u_n": WEIGHT_U_N, "waiver": None})
    section = CompensationSettings(temperature="cell")
    return rig.model_copy(update={"calibration": weight, "compensation": section})
