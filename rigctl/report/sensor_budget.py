"""The tension cell's systematic errors at the target, which no control law can detect: expanded uncertainties (k = 2).

`budget` is that of the cell's class; `compensated` puts in its place what this rig has measured and takes out: zero
from the tare, scale from a known weight, creep and drift by their models. What was not measured stays as it
is in the class.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import NamedTuple

from rigctl.commission.cell_uncertainty import (
    BIAS_OF_RANGE_PCT,
    CREEP_PCT,
    GAIN_PCT,
    GAIN_PCT_K,
    TEMPERATURE_N_H,
    WARMING_H,
)
from rigctl.config.settings import RigSettings
from rigctl.ipc.ledger import Standing, moment

WARMING_K_H = 1.0  # of a hall
SPAN_K = 5.0  # between the cell's temperature at its calibration and now
REPEATED_PCT = 0.01  # of the load, data sheets of class C3: a load that comes back
"""What is left of linearity and hysteresis where the scale is from a weight near the target, hung as the rope pulls."""


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


def compensated(
    rig: RigSettings, standing: Standing, target_n: float | None = None, at: datetime | None = None
) -> list[Error]:
    """What is left of the same errors after tare, calibration and compensation; ``at``: when, None for now."""
    target_n = rig.tension.target_n if target_n is None else target_n
    found = {error.name: error for error in budget(rig, target_n)}
    section = rig.compensation
    known_creep = section is not None and section.creep and bool(standing.creep) and standing.creep_u is not None
    creep_u = standing.creep_u if known_creep and standing.creep_u is not None else None
    zeroed = _hours_since_tare(standing, at or datetime.now(UTC))
    if standing.zero_u_n is not None and zeroed is not None and zeroed <= WARMING_H:
        found["bias"] = Error("bias", standing.zero_u_n, f"tare of {standing.tared}")
    followed = section is not None and section.temperature is not None and standing.zero_u_n_k is not None
    if followed and standing.zero_u_n_k is not None:
        drift_n = standing.zero_u_n_k * WARMING_K_H * WARMING_H
        per = f"{standing.zero_u_n_k:.2g} N/K left, {WARMING_H:g} h, from one tare to the next"
        found["drift"] = Error("drift", drift_n, per)
    if creep_u is not None:
        seen = "" if standing.creep_seen_s is None else f", recorded for {standing.creep_seen_s / 60:.0f} min"
        found["creep"] = Error("creep", target_n * creep_u, f"left of the model{seen}")
    if standing.scale_u is not None and rig.calibration is not None:
        warm = GAIN_PCT_K / 100 * SPAN_K
        gain_n = target_n * math.hypot(standing.scale_u, warm)
        found["gain"] = Error("gain", gain_n, f"known weight; {GAIN_PCT_K:g} % per K over {SPAN_K:g} K")
        apart = abs(target_n / rig.calibration.reference_n - 1.0)
        repeated_n = target_n * math.hypot(REPEATED_PCT, GAIN_PCT * min(1.0, apart)) / 100
        words = f"{REPEATED_PCT:g} % of the load; linearity from the weight to the target"
        found["repetition"] = Error("repetition", repeated_n, words)
    return list(found.values())


def _hours_since_tare(standing: Standing, at: datetime) -> float | None:
    return None if standing.tared is None else abs((at - moment(standing.tared)).total_seconds()) / 3600.0


def combined_n(errors: list[Error]) -> float:
    """Root of the sum of squares (JCGM 100: independent contributions)."""
    return math.sqrt(math.fsum(error.newtons**2 for error in errors))


def sum_n(errors: list[Error]) -> float:
    """All at once and of one sign."""
    return math.fsum(error.newtons for error in errors)
