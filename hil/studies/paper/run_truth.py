"""The truth of a run of the study as arrays, and the figures calculated from them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.scenario.figures import first_peak
from hil.scenario.play import Played
from rigctl.metrics.tension_error import error_pct

Floats = npt.NDArray[np.float64]

PLATEAU_S = 10.0
"""The continuous following stage is evaluated from here to the end."""


class RunTruth(NamedTuple):
    """Truth of one run, 1 kHz from the start of the mechanism; each of shape (n,)."""

    t_s: Floats
    tension_n: Floats
    vertical_n: Floats
    tangential_deg: Floats
    normal_deg: Floats
    pulley_mm: Floats
    stroke_mm: Floats
    speed_mm_s: Floats

    @classmethod
    def of(cls, played: Played) -> RunTruth:
        """Of a run, from its start on."""
        begun = played.t_s >= 0.0
        log = played.truth[begun]
        return cls(
            played.t_s[begun],
            log["tension_n"],
            log["vertical_n"],
            np.degrees(log["tangential_rad"]),
            np.degrees(log["normal_rad"]),
            log["pulley_mm"] - log["pulley_mm"][0],
            log["stroke_mm"],
            log["speed_mm_s"],
        )

    def eta_pct(self, target_n: float) -> Floats:
        """Compensating error, equation (16), signed."""
        error: Floats = error_pct(self.vertical_n, target_n)
        return error

    def plateau(self, values: Floats) -> Floats:
        """The part of ``values`` that lies on the plateau."""
        return values[self.t_s >= PLATEAU_S]

    def first_peak_s(self) -> float:
        """When the vertical force first turns back: the end of the initial following stage; NaN if it never does."""
        at = first_peak(self.vertical_n)
        return math.nan if at is None else float(self.t_s[at])
