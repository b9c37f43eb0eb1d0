"""From the cell's reading to tension: zero, scale, creep and drift, all bounded and on record in the ledger."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from rigctl.config.settings import RigSettings

SCALE_BOUND = 0.02  # a cell with a larger error needs repair, not a factor
CREEP_BOUND = 1e-3  # of the load: OIML R 60 allows class C3 0.000245, class C1 0.000735 in 30 min
CREEP_FASTEST_S, CREEP_SLOWEST_S = 1.0, 36_000.0  # time constants: filter and swing below, drift above
SECOND_SCALE_BOUND = 0.1  # of a spring: its maker's tolerance
DRIFT_OF_RANGE_K = 1e-3  # of the range per kelvin: OIML R 60 allows class C3 0.00007
CREEP_TERMS = 2


class CreepTerm(NamedTuple):
    """A part of the creep: its share of the load once it has run its course, and its time constant."""

    share: float
    time_s: float


@dataclass(frozen=True)
class Correction:
    """``tension = (reading - zero_n - zero_n_k (temperature - zero_c)) * scale - creep``.

    ``overdue``: no valid calibration and no waiver, which bars arming. ``zero_c``: the cell's temperature at the tare,
    None where it is not known. For the creep see `rigctl.control.bus.cell_correction`. ``second_zero_n`` and
    ``second_scale``: of the second force path, in N of its reading; None before a tare.
    """

    zero_n: float = 0.0
    scale: float = 1.0
    overdue: bool = False
    creep: tuple[CreepTerm, ...] = ()
    zero_c: float | None = None
    zero_n_k: float = 0.0
    second_zero_n: float | None = None
    second_scale: float = 1.0

    def applied(self, reading_n: float) -> float:
        """Tension in N by zero and scale alone."""
        return (reading_n - self.zero_n) * self.scale

    def fits(self, settings: RigSettings) -> bool:
        """Within the bounds: a correction may shift the tension a little, never hide a load or a lost rope."""
        limit = settings.tare_limit_n
        return (
            math.isfinite(self.zero_n + self.scale)
            and abs(self.zero_n) <= limit
            and abs(self.scale - 1.0) <= SCALE_BOUND
            and creep_fits(self.creep)
            and abs(self.zero_n_k) <= DRIFT_OF_RANGE_K * settings.tension_cell.range_n
            and (self.zero_c is None or math.isfinite(self.zero_c))
            and self._second_fits(settings)
        )

    def _second_fits(self, settings: RigSettings) -> bool:
        """A second cell as the first; an encoder may count from anywhere."""
        section, zero_n = settings.second_force, self.second_zero_n
        if section is None or zero_n is None:
            return math.isfinite(self.second_scale)
        if section.kind == "cell":
            return abs(zero_n) <= settings.tare_limit_n and abs(self.second_scale - 1.0) <= SCALE_BOUND
        return math.isfinite(zero_n) and abs(self.second_scale - 1.0) <= SECOND_SCALE_BOUND


def creep_fits(creep: tuple[CreepTerm, ...]) -> bool:
    """Two terms or none, together within `CREEP_BOUND`, with time constants that a creep can have."""
    if not creep:
        return True
    shares = math.fsum(abs(term.share) for term in creep)
    times = [term.time_s for term in creep]
    return (
        len(creep) == CREEP_TERMS
        and shares <= CREEP_BOUND  # False for NaN
        and all(CREEP_FASTEST_S <= time_s <= CREEP_SLOWEST_S for time_s in times)
    )


def creep_text(creep: tuple[CreepTerm, ...]) -> str:
    """Shares and time constants in s, as the loop's event has them; empty without a creep."""
    return " ".join(f"{share:.6g} {time_s:.6g}" for share, time_s in creep)


def creep_share(creep: tuple[CreepTerm, ...]) -> float:
    """Share of the load that the whole creep is in the end."""
    return math.fsum(term.share for term in creep)
