"""The tension cell's systematic errors at the target, which no control law can detect."""

from __future__ import annotations

import math
from typing import NamedTuple

from rigctl.config.settings import RigSettings

BIAS_OF_RANGE_PCT = 0.03  # zero error between two tares, of a cell of class C3 in a hall
GAIN_PCT = 0.02  # OIML R 60 class C3: linearity and hysteresis of a calibrated cell
CREEP_PCT = 0.0245  # OIML R 60 class C3: of the load in 30 min
WARMING_H = 8.0  # a shift without a new tare
TEMPERATURE_N_H = 0.01  # as in the rig file: 0.02 % of 500 N per 10 K, 1 K an hour


class Error(NamedTuple):
    """One line of the sensor budget."""

    name: str
    newtons: float
    """Error at the target."""
    source: str


def budget(rig: RigSettings, target_n: float | None = None) -> list[Error]:
    """The cell's possible errors at the target (None: the rig file's), one by one."""
    range_n = rig.tension_cell.range_n
    target_n = rig.tension.target_n if target_n is None else target_n
    return [
        Error("bias", range_n * BIAS_OF_RANGE_PCT / 100, f"{BIAS_OF_RANGE_PCT:g} % of {range_n:g} N"),
        Error("gain", target_n * GAIN_PCT / 100, f"{GAIN_PCT:g} % of the load, class C3"),
        Error("creep", target_n * CREEP_PCT / 100, f"{CREEP_PCT:g} % of the load in 30 min, class C3"),
        Error("drift", TEMPERATURE_N_H * WARMING_H, f"{TEMPERATURE_N_H:g} N/h for {WARMING_H:g} h without a tare"),
    ]


def combined_n(errors: list[Error]) -> float:
    """Root of the sum of squares (JCGM 100: independent contributions)."""
    return math.sqrt(math.fsum(error.newtons**2 for error in errors))
