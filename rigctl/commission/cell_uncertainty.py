"""What tare and calibration leave unknown of the cell, as expanded uncertainties (k = 2, JCGM 100). Pure functions.

The figures of the cell's class stand in where nothing was measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from rigctl.config.settings import RigSettings
from rigctl.ipc import wall_clock
from rigctl.ipc.ledger import Entry, Standing, moment

COVERAGE = 2.0
BIAS_OF_RANGE_PCT = 0.03  # zero error between two tares, of a cell of class C3 in a hall
GAIN_PCT = 0.02  # OIML R 60 class C3: linearity and hysteresis of a calibrated cell
CREEP_PCT = 0.0245  # OIML R 60 class C3: of the load in 30 min
TEMPERATURE_N_H = 0.01  # as in the rig file: 0.02 % of 500 N per 10 K, 1 K an hour
GAIN_PCT_K = 0.001  # of the load per kelvin, data sheets of class C3: 0.01 % per 10 K
WARMING_H = 8.0  # a shift without a new tare
FLOOR_N = 0.0005  # least standard uncertainty of a mean: resolution, and noise that does not average out
FEWEST_TARES, LEAST_SPAN_K = 4, 3.0  # for a coefficient: less of either is scatter
NEWEST_TARES = 30


@dataclass(frozen=True)
class Drift:
    """Change of zero with temperature in N/K, and its expanded uncertainty; from how many tares over how many K."""

    zero_n_k: float
    zero_u_n_k: float
    tares: int
    span_k: float

    def __str__(self) -> str:
        """In words."""
        return (
            f"zero {self.zero_n_k:+z.4f} +- {self.zero_u_n_k:.4f} N/K, from {self.tares} tares over {self.span_k:.1f} K"
        )


def mean_u_n(rms_n: float, samples: float) -> float:
    """Of a mean reading."""
    return COVERAGE * math.hypot(rms_n / math.sqrt(max(1.0, samples)), FLOOR_N)


def zero_u_n(settings: RigSettings, now: Standing, rms_n: float, samples: float, doubt_n: float) -> float:
    """Of a tare: its mean, and what is left of the creep of a load that hung on the cell before.

    ``doubt_n``: what an unknown history of the load may make of it.
    """
    section = settings.compensation
    crept = now.creep_u if section is not None and section.creep and now.creep else None
    left = 0.0 if crept is None else crept * settings.tension.target_n
    return math.hypot(mean_u_n(rms_n, samples), left, doubt_n)


def drifted_u_n(settings: RigSettings, now: Standing, cell_c: float | None, when: datetime) -> float:
    """Of the zero since the tare: by the coefficient where the temperature is measured, else by the class and time."""
    section = settings.compensation
    followed = section is not None and section.temperature is not None and now.zero_u_n_k is not None
    if followed and now.zero_c is not None and cell_c is not None:
        return float(now.zero_u_n_k or 0.0) * abs(cell_c - now.zero_c)
    hours = WARMING_H
    if now.tared is not None:
        age = wall_clock.age(moment(now.tared), when)
        hours = WARMING_H if age is None else min(WARMING_H, max(0.0, age.total_seconds() / 3600.0))
    return TEMPERATURE_N_H * hours


def scale_u(
    settings: RigSettings, now: Standing, rms_n: float, samples: float, doubt_n: float, cell_c: float | None,
    when: datetime, reference_n: float,
) -> float | None:  # fmt: skip
    """Of the scale, as a share of the load; None where the rig file does not say how well the weight is known.

    The weight with local gravity and buoyancy, the mean reading, the zero below it, and the creep at that time.
    """
    section = settings.calibration
    if section is None or section.reference_u_n is None:
        return None
    weight_u = section.reference_u_n / section.reference_n
    zero = BIAS_OF_RANGE_PCT / 100.0 * settings.tension_cell.range_n if now.zero_u_n is None else now.zero_u_n
    compensation = settings.compensation
    crept = now.creep_u if compensation is not None and compensation.creep and now.creep else CREEP_PCT / 100.0
    in_n = (mean_u_n(rms_n, samples), zero, doubt_n, drifted_u_n(settings, now, cell_c, when))
    return math.hypot(weight_u, crept or 0.0, *(each / reference_n for each in in_n))


def drift(entries: Sequence[Entry]) -> Drift | None:
    """The zero's change with temperature over the newest tares; None where they do not tell it.

    A straight line by least squares; the scatter of the tares about it gives the uncertainty.
    """
    withdrawn = {item.figures.get("withdraws") for item in entries if item.what == "tare withdrawn"}
    tares = [item for item in entries if item.what == "tare" and item.when not in withdrawn]
    known = [(item.after.get("zero_c"), item.after.get("zero_n")) for item in tares[-NEWEST_TARES:]]
    points = [(celsius, zero_n) for celsius, zero_n in known if celsius is not None and zero_n is not None]
    if len(points) < FEWEST_TARES:
        return None
    celsius, zeros = np.array(points).T
    span_k = float(np.ptp(celsius))
    if span_k < LEAST_SPAN_K:
        return None
    about = celsius - celsius.mean()
    slope = float(about @ zeros / (about @ about))
    left = zeros - zeros.mean() - slope * about
    spread_n = math.hypot(math.sqrt(float(left @ left) / (len(points) - 2)), FLOOR_N)
    error = student(len(points) - 2) * spread_n / math.sqrt(float(about @ about))
    return Drift(slope, error, len(points), span_k)


def student(freedom: int) -> float:
    """Two-sided 95 % point of Student's t, from a table."""
    table = {1: 12.706, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 6: 2.447, 7: 2.365, 8: 2.306, 9: 2.262, 10: 2.228}
    z = 1.959964
    return table.get(freedom) or z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
