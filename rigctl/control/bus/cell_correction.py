"""From the cell's reading to tension, sample by sample: zero and its drift, scale, and creep with the load's history.

The cell's reading of a load F, after zero and scale, is (two terms)

    c = F + sum a_i y_i,    tau_i dy_i/dt = F - y_i

with the share a_i of the load and its time constant. Both are solved for F: between two samples F is taken as a
straight line, for which the discretisation is exact,

    y_i = k_i y_i' + p_i F' + q_i F,    k = exp(-x), q = 1 - (1 - k) / x, p = (1 - k) / x - k,    x = dt / tau_i
    F = (c - sum a_i (k_i y_i' + p_i F')) / (1 + sum a_i q_i)

with y' and F' of the sample before. That is the inverse itself, not a first-order approximation of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from rigctl.config.built_type import built
from rigctl.config.settings import RigSettings
from rigctl.ipc.correction import Correction, CreepTerm
from rigctl.ipc.ring import RingReader

_NS = 1e-9
TEMPERATURE_S = 10.0  # low-pass of the temperature: sensors have steps of up to 0.1 K
NO_CREEP = CreepTerm(0.0, 1.0)


@built
class CellHistory(NamedTuple):
    """The load's history as the creep has it: y_1 and y_2 in N, at a time."""

    t_ns: int
    crept: tuple[float, float]


def cell_history(records: RingReader) -> CellHistory | None:
    """The history in the newest record of the loop before, None without one."""
    newest = records.latest()
    if newest is None:
        return None
    first, second = float(newest["crept_1_n"]), float(newest["crept_2_n"])
    return CellHistory(int(newest["t_ns"]), (first, second)) if math.isfinite(first + second) else None


@dataclass
class _Creep:
    """One term's state and weights; ``doubt_n``: how far off y_i may have been when the history began."""

    share: float
    time_ns: float
    crept_n: float = 0.0
    doubt_n: float = 0.0
    keep: float = 1.0
    before: float = 0.0
    now: float = 0.0

    def weigh(self, elapsed_ns: int) -> None:
        """Weights of state, last load and present load over a step."""
        if elapsed_ns <= 0:
            self.keep, self.before, self.now = 1.0, 0.0, 0.0
            return
        x = elapsed_ns / self.time_ns
        reached = -math.expm1(-x)
        self.keep = 1.0 - reached
        self.now = 1.0 - reached / x
        self.before = reached / x - self.keep


class CellCorrection:
    """Zero, drift, scale and creep; without a ``compensation`` section zero and scale alone.

    ``zero_drift_n``: part of the zero beside the tare's, in N of the reading. ``creep_n``: creep taken out, in N of
    tension. ``temperature_c``: of the cell, low-passed; NaN before it is known.
    """

    def __init__(self, settings: RigSettings) -> None:
        section = settings.compensation
        self._creeps_on = section is not None and section.creep
        self._drifts_on = section is not None and section.temperature is not None
        self._zero_limit_n = settings.tare_limit_n
        self._largest_n = settings.tension.target_max_n
        self.correction = Correction()
        self.zero_drift_n = self.creep_n = 0.0
        self.temperature_c = math.nan
        self._temperature_t_ns = 0
        self.offset_n, self.scale = 0.0, 1.0
        self.creeps = False
        self._one, self._two = _Creep(0.0, 1.0), _Creep(0.0, 1.0)
        self._load_n, self._t_ns, self._elapsed_ns, self._begun = math.nan, 0, -1, False
        self._begun_ns = 0  # when the history began whose doubt is `doubt_n`
        self._inverse = 1.0
        self._held_s = math.nan
        self._history: CellHistory | None = None

    def put(self, correction: Correction, *, held_s: float = math.nan, history: CellHistory | None = None) -> None:
        """Put another correction in force.

        Other creep terms begin another history: with ``history`` that of the loop before, with ``held_s`` that of a
        load that came so long ago on a cell at rest, else that of a load that has always been there.
        """
        changed = correction.creep != self.correction.creep
        self.correction, self.scale = correction, correction.scale
        self._set_drift()
        self.creeps = self._creeps_on and bool(correction.creep)
        if changed:
            self._held_s, self._history = held_s, history
            first, second = correction.creep or (NO_CREEP, NO_CREEP)
            self._one, self._two = (_Creep(term.share, term.time_s / _NS) for term in (first, second))
            self._begun, self._elapsed_ns, self.creep_n = False, -1, 0.0

    def tension_n(self, reading_n: float, t_ns: int) -> float:
        """Tension in N of a good sample, which also goes into the load's history."""
        compared_n = (reading_n - self.offset_n) * self.scale
        if not self.creeps:
            return compared_n
        if not self._begun:
            return self._begin(compared_n, t_ns)
        one, two, last_n = self._one, self._two, self._load_n
        elapsed_ns = t_ns - self._t_ns
        if elapsed_ns != self._elapsed_ns:
            self._elapsed_ns = elapsed_ns
            one.weigh(elapsed_ns)
            two.weigh(elapsed_ns)
            self._inverse = 1.0 / (1.0 + one.share * one.now + two.share * two.now)
        first = one.keep * one.crept_n + one.before * last_n
        second = two.keep * two.crept_n + two.before * last_n
        load_n = (compared_n - one.share * first - two.share * second) * self._inverse
        one.crept_n = first + one.now * load_n
        two.crept_n = second + two.now * load_n
        self.creep_n = compared_n - load_n
        self._load_n, self._t_ns = load_n, t_ns
        return load_n

    def newest_n(self, reading_n: float) -> float:
        """Tension in N of a sample that has already gone into the history, by the zero and scale now in force."""
        compared_n = (reading_n - self.offset_n) * self.scale
        if not (self.creeps and self._begun):
            return compared_n
        self._load_n = compared_n - self.creep_n
        return self._load_n

    def _begin(self, compared_n: float, t_ns: int) -> float:
        self._begun = True
        terms = (self._one, self._two)
        shares = math.fsum(term.share for term in terms)
        self._t_ns = self._begun_ns = t_ns
        past, held_s = self._history, self._held_s
        for place, term in enumerate(terms):
            load_n = compared_n / (1.0 + shares)  # the creep of this estimate is second order
            if past is not None and t_ns >= past.t_ns:
                gap = math.exp(-(t_ns - past.t_ns) / term.time_ns)
                term.crept_n = load_n + (past.crept[place] - load_n) * gap
                term.doubt_n = max(self._largest_n, abs(load_n)) * (1.0 - gap)
            elif held_s >= 0.0:  # False for NaN
                term.crept_n = load_n * -math.expm1(-held_s / _NS / term.time_ns)
                term.doubt_n = 0.0
            else:
                term.crept_n, term.doubt_n = load_n, max(self._largest_n, abs(load_n))
        self.creep_n = math.fsum(term.share * term.crept_n for term in terms)
        self._load_n = compared_n - self.creep_n
        return self._load_n

    @property
    def doubt_n(self) -> float:
        """Largest error in N that may be left of not knowing the load before the history began; it decays."""
        if not (self.creeps and self._begun):
            return 0.0
        since_ns = self._t_ns - self._begun_ns
        terms = (self._one, self._two)
        return math.fsum(abs(term.share) * term.doubt_n * math.exp(-since_ns / term.time_ns) for term in terms)

    @property
    def crept(self) -> tuple[float, float]:
        """y_1 and y_2 in N: the load as each term of the creep has followed it; NaN without a creep or a sample."""
        if not (self.creeps and self._begun):
            return math.nan, math.nan
        return self._one.crept_n, self._two.crept_n

    # -- zero -------------------------------------------------------------------------------------------------------
    def feel(self, temperature_c: float, t_ns: int) -> None:
        """Take a temperature of the cell; one that is not finite is left out."""
        if not math.isfinite(temperature_c):
            return
        if math.isnan(self.temperature_c):
            self.temperature_c = temperature_c
        else:
            reached = -math.expm1(-max(0, t_ns - self._temperature_t_ns) * _NS / TEMPERATURE_S)
            self.temperature_c += (temperature_c - self.temperature_c) * reached
        self._temperature_t_ns = t_ns
        self._set_drift()

    def _set_drift(self) -> None:
        """The zero in force: with its drift it stays within the limit of a tare."""
        correction = self.correction
        drift_n = 0.0
        if self._drifts_on and correction.zero_c is not None and not math.isnan(self.temperature_c):
            drift_n = correction.zero_n_k * (self.temperature_c - correction.zero_c)
        if drift_n == 0.0:
            self.zero_drift_n, self.offset_n = 0.0, correction.zero_n
            return
        limit_n = self._zero_limit_n
        self.offset_n = max(-limit_n, min(limit_n, correction.zero_n + drift_n))
        self.zero_drift_n = drift_n
